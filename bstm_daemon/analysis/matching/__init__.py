"""The model matched to measured temperatures, and verified on drives."""
