"""The compiled kernel, where it is installed.

``BSTM_KERNEL=compiled`` makes its absence an error, ``BSTM_KERNEL=reference``
keeps to the pure-Python form; otherwise the compiled one is taken if there.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from bstm_daemon.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

VARIABLE: Final = "BSTM_KERNEL"


class Kernel(Protocol):
    """The functions of the extension module; both take flat buffers."""

    march: Callable[..., None]
    sample_pass: Callable[..., tuple[int, int, int]]


def load_kernel(choice: str | None = None) -> Kernel | None:
    """Return the compiled kernel, or None for the pure-Python form.

    Args:
        choice: ``compiled``, ``reference`` or None for what the environment
            variable ``BSTM_KERNEL`` says.

    Raises:
        UsageError: ``compiled`` was asked for and is not installed, or the
            variable holds another word.
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
    try:
        module: Any = import_module("bstm_daemon._kernel")
    except ImportError as error:
        if choice == "compiled":
            msg = (
                f"{VARIABLE}=compiled, but the compiled kernel is not "
                f"installed ({error}); reinstall where a C compiler is"
            )
            raise UsageError(msg) from error
        return None
    return cast("Kernel", module)
