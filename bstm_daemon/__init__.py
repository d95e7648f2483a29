"""Brake system temperature monitor on a CAN bus.

CAN frames become samples, samples become brake power, brake power marches a
thermal network, the network's temperatures become frames.

Programs use ``from bstm_daemon import load_config, replay, simulate, match,
find_gap`` (``docs/python.md``).
"""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bstm_daemon.api import find_gap, load_config, match, replay, simulate

__version__ = version("bstm-daemon")

__all__ = [
    "__version__",
    "find_gap",
    "load_config",
    "match",
    "replay",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Load a function when it is asked for: the service needs none."""
    if name not in __all__:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(importlib.import_module("bstm_daemon.api"), name)
