"""Brake system temperature monitor on a CAN bus.

CAN frames become samples, samples become brake power, brake power marches a
thermal network, the network's temperatures become frames.
"""

from importlib.metadata import version

__version__ = version("bstm-daemon")
