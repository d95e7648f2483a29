"""Results for people: text on screen, HTML pages and JSON files."""
