"""Everything that knows CAN: logs, DBC files, the signal map, frames.

What the live daemon needs (``signal_map``, ``decoder``) imports no NumPy;
what reads logs (``candump``, ``columns``, ``logs``) is loaded by the commands
that read logs.
"""
