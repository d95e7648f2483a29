"""Advice to the driver and requests to other controllers; never actuation."""
