"""The model for other tools, as an FMU."""
