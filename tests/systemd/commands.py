"""Running commands in the box, and waiting for what they lead to."""

from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .conftest import Unit

DEADLINE_S: Final = 60.0


def run(
    *command: str | Path, check: bool = True, **changes: Any
) -> subprocess.CompletedProcess[str]:
    """Run *command*, its output captured; *changes* go to subprocess."""
    return subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        check=check,
        timeout=DEADLINE_S,
        **changes,
    )


def until(condition: Callable[[], bool], unit: Unit) -> None:
    """Return once *condition* holds; fail if it never does."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > deadline_s:
            pytest.fail(unit.journal())
        time.sleep(0.05)
