"""Recorded logs through the same estimator as the live service."""
