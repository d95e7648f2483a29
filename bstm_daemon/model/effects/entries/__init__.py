"""The catalogue's entries: one effect a file, the file named as the effect."""
