"""Physical effects beyond the baseline, each a named edit of the model."""
