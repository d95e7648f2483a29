"""Recorded logs through the same estimator as the live service.

Calling the room itself is :func:`bstm_daemon.api.replay`: ``from bstm_daemon
import replay`` gives this module once anything has imported it.
"""

import importlib
import sys
from types import ModuleType
from typing import Any


class _CallableRoom(ModuleType):
    """The room of modules and the function of its name in one."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Call :func:`bstm_daemon.api.replay`."""
        api = importlib.import_module("bstm_daemon.api")
        return api.replay(*args, **options)


sys.modules[__name__].__class__ = _CallableRoom
