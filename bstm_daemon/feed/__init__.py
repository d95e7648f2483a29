"""Estimates for readers beside the bus: local feed, live page, MQTT bridge."""
