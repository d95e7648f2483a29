"""The C form of log reading, where the extension could be built."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from bstm_daemon.native import VARIABLE

if TYPE_CHECKING:
    from collections.abc import Callable

_NAME: Final = "bstm_daemon.bus._log"
_LAYOUT: Final = 2


class LogExtension(Protocol):
    """The functions of the extension module; all take flat buffers."""

    scan: Callable[..., int]
    place: Callable[..., int]
    extract: Callable[..., None]


def extension() -> LogExtension | None:
    """Return the compiled form, None where NumPy has to do.

    That is where it is not built, or from other sources than these, and with
    ``BSTM_KERNEL=reference``. Results are the same, bit for bit.
    """
    if os.environ.get(VARIABLE) == "reference":
        return None
    try:
        found: Any = import_module(_NAME)
    except ImportError:
        return None
    return cast("LogExtension", found) if found.LAYOUT == _LAYOUT else None
