"""What a replay gave, for people: a table on screen and an HTML page."""
