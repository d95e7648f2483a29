"""The live service: clock, loop, state file and reports."""
