"""Boiling of the brake fluid: limits, margin and what follows from it."""
