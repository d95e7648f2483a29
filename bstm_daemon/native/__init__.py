"""The compiled forms of the inner loops, and their loader."""
