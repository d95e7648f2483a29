"""The live service: clock, loop, state and what it tells the world."""
