"""The estimator: heat and temperature coupled, its state and validity."""
