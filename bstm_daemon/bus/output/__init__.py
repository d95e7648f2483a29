"""The frames that the monitor publishes."""
