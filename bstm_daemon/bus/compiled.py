"""The C forms of reading logs and live frames, where they could be built."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from bstm_daemon.native import VARIABLE

if TYPE_CHECKING:
    from collections.abc import Callable

_NAME: Final = "bstm_daemon.bus._log"
_LAYOUT: Final = 2
_LIVE_NAME: Final = "bstm_daemon.bus._live"
_LIVE_LAYOUT: Final = 1


class LogExtension(Protocol):
    """The functions of the extension module; all take flat buffers."""

    scan: Callable[..., int]
    place: Callable[..., int]
    extract: Callable[..., None]


class LiveExtension(Protocol):
    """The functions of the other module; their buffers are flat, too."""

    receive: Callable[..., tuple[int, int, int, int, int]]
    place_in_time: Callable[..., tuple[int, int]]
    sort: Callable[..., int]
    take: Callable[..., tuple[int, int, int]]


def extension() -> LogExtension | None:
    """Return the compiled form, None where NumPy has to do.

    That is where it is not built, or from other sources than these, and with
    ``BSTM_KERNEL=reference``. Results are the same, bit for bit.
    """
    return cast("LogExtension | None", _found(_NAME, _LAYOUT))


def live_extension() -> LiveExtension | None:
    """Return the compiled form of live reading, None as :func:`extension`.

    Only Linux has the system call that it needs.
    """
    found = _found(_LIVE_NAME, _LIVE_LAYOUT)
    if found is None or not hasattr(found, "receive"):
        return None
    return cast("LiveExtension", found)


def _found(name: str, layout: int) -> Any:
    if os.environ.get(VARIABLE) == "reference":
        return None
    try:
        module: Any = import_module(name)
    except ImportError:
        return None
    return module if layout == module.LAYOUT else None
