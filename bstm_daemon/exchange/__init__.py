"""The model for other tools: as an FMU, as a readable graph."""
