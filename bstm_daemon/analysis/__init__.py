"""Analysis of recordings: judge, identify, match, explain."""
