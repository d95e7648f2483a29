"""The compiled scan of candump text: when it is taken, what it refuses."""

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.native.loader import VARIABLE, extension
from bstm_daemon.native.sources import digest

NAME = "bstm_daemon.native._bus"


def test_the_environment_keeps_to_python(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    made = SimpleNamespace(SOURCES=digest("native._bus"))
    monkeypatch.setitem(sys.modules, NAME, made)
    assert extension() is made

    monkeypatch.setenv(VARIABLE, "reference")

    assert extension() is None


def test_python_does_where_the_scan_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, NAME, None)

    assert extension() is None


def test_a_scan_of_other_sources_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setitem(sys.modules, NAME, SimpleNamespace(SOURCES="other"))

    with pytest.raises(UsageError, match="_bus was built from other sources"):
        extension()


def scan_arguments(text: bytes, **changes: Any) -> list[Any]:
    """Return what the compiled scan takes for *text*."""
    rows = changes.pop("rows", 4)
    arguments: dict[str, Any] = {
        "text": bytearray(text),
        "end": len(text),
        "names": b"can0\n",
        "keys": np.zeros((8, 3), np.int64),
        "state": np.zeros(8, np.int64),
        "time_us": np.zeros(rows, np.int64),
        "line": np.zeros(rows, np.int64),
        "channel": np.zeros(rows, np.int16),
        "can_id": np.zeros(rows, np.uint32),
        "extended": np.zeros(rows, np.bool_),
        "length": np.zeros(rows, np.uint8),
        "data": np.zeros((rows, 8), np.uint8),
        "pending": np.zeros((rows, 3), np.int64),
    }
    return list((arguments | changes).values())


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        (b"(1.5) can0 100#11", {}),
        (b"", {}),
        (b"\n", {"end": 2}),
        (b"\n", {"end": -1}),
        (b"\n", {"keys": np.zeros((7, 3), np.int64)}),
        (b"\n", {"keys": np.zeros((0, 3), np.int64)}),
        (b"\n", {"keys": np.zeros(25, np.int64)}),
        (b"\n", {"state": np.zeros(7, np.int64)}),
        (b"\n", {"state": np.array([-1] + [0] * 7)}),
        (b"\n", {"state": np.array([2] + [0] * 7)}),
        (b"\n", {"state": np.array([0, 0, -1] + [0] * 5)}),
        (b"\n", {"state": np.array([0, 0, 0, -1] + [0] * 4)}),
        (b"\n", {"line": np.zeros(3, np.int64)}),
        (b"\n", {"channel": np.zeros(3, np.int16)}),
        (b"\n", {"can_id": np.zeros(3, np.uint32)}),
        (b"\n", {"extended": np.zeros(3, np.bool_)}),
        (b"\n", {"length": np.zeros(3, np.uint8)}),
        (b"\n", {"data": np.zeros((4, 7), np.uint8)}),
        (b"\n", {"channel": np.zeros(4, np.int32)}),
    ],
)
def test_the_compiled_scan_refuses_what_would_lead_outside(
    text: bytes, changes: dict[str, Any]
) -> None:
    compiled = extension()
    if compiled is None:
        pytest.skip("the compiled scan is not installed")

    with pytest.raises(ValueError, match=r"length|newline|outside|neg|items"):
        compiled.scan(*scan_arguments(text, **changes))
