"""The missing effect: locate the gap, name what is missing, adopt it, show."""
