"""Wear: thickness of the linings and the disc from the friction energy."""
