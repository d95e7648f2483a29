"""The compiled forms of the inner loops, where they could be built.

``BSTM_KERNEL=compiled`` makes the kernel's absence an error,
``BSTM_KERNEL=reference`` keeps to the Python forms; otherwise the compiled
ones are taken if there. Results are the same, bit for bit. A module that was
built from other sources than those beside it is refused.
"""

import os
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, Final, Protocol, cast

from bstm_daemon.errors import UsageError
from bstm_daemon.native.sources import digest

VARIABLE: Final = "BSTM_KERNEL"
REBUILD: Final = "pip install -e ."


class Kernel(Protocol):
    """The functions of the extension module; all take flat buffers."""

    march: Callable[..., None]
    mean_probability: Callable[..., float]
    sample_pass: Callable[..., tuple[int, int, int]]


class BusExtension(Protocol):
    """Reading of logs and of live frames; all functions take flat buffers."""

    scan: Callable[..., int]
    extract: Callable[..., tuple[int, int]]
    receive: Callable[..., tuple[int, int, int, int, int]]
    place_in_time: Callable[..., tuple[int, int]]
    sort: Callable[..., int]
    take: Callable[..., tuple[int, int]]


def load_kernel(choice: str | None = None) -> Kernel | None:
    """Return the compiled kernel, or None for the pure-Python form.

    Args:
        choice: ``compiled``, ``reference`` or None for what the environment
            variable ``BSTM_KERNEL`` says.

    Raises:
        UsageError: ``compiled`` was asked for and is not installed, the
            variable holds another word, or the kernel is not of these
            sources.
    """
    choice = choice or os.environ.get(VARIABLE) or "any"
    if choice not in {"any", "compiled", "reference"}:
        msg = (
            f"{VARIABLE}={choice}: allowed are 'compiled' (must be there) and "
            f"'reference' (pure Python)"
        )
        raise UsageError(msg)
    if choice == "reference":
        return None
    module = load_module("native._kernel")
    if module is None and choice == "compiled":
        msg = (
            f"{VARIABLE}=compiled, but the compiled kernel is not installed; "
            "reinstall where a C compiler is"
        )
        raise UsageError(msg)
    return cast("Kernel | None", module)


def extension() -> BusExtension | None:
    """Return the compiled reading of frames, None for the Python form.

    Raises:
        UsageError: it is not of these sources.
    """
    if os.environ.get(VARIABLE) == "reference":
        return None
    return cast("BusExtension | None", load_module("native._bus"))


def live_extension() -> BusExtension | None:
    """Return the compiled reading of live frames, None as :func:`extension`.

    Only Linux has the system call that it needs.
    """
    module = extension()
    return module if hasattr(module, "receive") else None


def load_module(name: str) -> Any:
    """Return the compiled module *name* of the package, None if not there.

    Args:
        name: a key of :data:`~bstm_daemon.native.sources.SOURCES`.

    Raises:
        UsageError: it was built from other sources than those beside it.
    """
    try:
        module = import_module(f"bstm_daemon.{name}")
    except ImportError:
        return None
    expected = expected_sources(name)
    if expected is not None and expected != module.SOURCES:
        msg = (
            f"bstm_daemon.{name} was built from other sources than those "
            f"here; rebuild it: {REBUILD}"
        )
        raise UsageError(msg)
    return module


@cache
def expected_sources(name: str) -> str | None:
    """Return the hash of the sources here; None where there are none."""
    try:
        return digest(name)
    except FileNotFoundError:
        return None
