"""Which form of the kernel is taken."""

import sys
from typing import Any

import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.native.loader import VARIABLE, Kernel, load_kernel


def test_reference_on_demand(monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable keeps to pure Python."""
    monkeypatch.setenv(VARIABLE, "reference")
    assert load_kernel() is None


def test_argument_goes_before_the_variable(
    monkeypatch: pytest.MonkeyPatch, compiled: Kernel
) -> None:
    """An explicit choice does not ask the environment."""
    monkeypatch.setenv(VARIABLE, "reference")
    assert load_kernel("compiled") is compiled


def test_compiled_is_taken_where_it_is(
    monkeypatch: pytest.MonkeyPatch, compiled: Kernel
) -> None:
    """Without a word the compiled form runs."""
    monkeypatch.delenv(VARIABLE, raising=False)
    assert load_kernel() is compiled
    assert callable(compiled.march)
    assert callable(compiled.sample_pass)


def test_unknown_word(monkeypatch: pytest.MonkeyPatch) -> None:
    """A typing error is not silently the default."""
    monkeypatch.setenv(VARIABLE, "fast")
    with pytest.raises(UsageError, match=r"BSTM_KERNEL=fast.*compiled"):
        load_kernel()


class _Absent:
    """An import system without the extension."""

    def find_spec(self, name: str, *_: Any) -> None:
        """Refuse the extension module."""
        if name == "bstm_daemon.native._kernel":
            raise ModuleNotFoundError(name)


def test_without_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pure Python takes over; asking for the compiled form is an error."""
    monkeypatch.delitem(
        sys.modules, "bstm_daemon.native._kernel", raising=False
    )
    monkeypatch.setattr(sys, "meta_path", [_Absent(), *sys.meta_path])
    monkeypatch.delenv(VARIABLE, raising=False)
    assert load_kernel() is None
    with pytest.raises(UsageError, match="not installed"):
        load_kernel("compiled")
