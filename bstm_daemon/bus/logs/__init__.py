"""Readers of CAN logs, one module a format."""
