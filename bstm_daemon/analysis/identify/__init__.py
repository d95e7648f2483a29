"""Identification of the car from drives: resistances, friction, cooling."""
