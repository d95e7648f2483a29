"""Samples into brake power: Feed-Forward and Feed-Back, per corner."""
