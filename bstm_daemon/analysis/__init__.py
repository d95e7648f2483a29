"""What a person does with recordings: judge, identify, match, explain."""
