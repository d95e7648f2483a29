"""Links to live buses."""
