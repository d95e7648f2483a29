"""The terminal view of a car, fed by the frames the daemon publishes."""
