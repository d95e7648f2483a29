"""The step of the build that compiles, as ``pyproject.toml`` asks for it."""

import tomllib
from pathlib import Path

import pytest

from bstm_daemon.native.sources import PACKAGE, SOURCES, digest

pytest.importorskip("setuptools", reason="nothing is built without it")

from setuptools import Distribution, Extension

from bstm_daemon.native import building

PROJECT = PACKAGE.parent / "pyproject.toml"


def test_every_module_with_sources_is_built() -> None:
    if not PROJECT.exists():
        pytest.skip("installed without it")
    told = tomllib.loads(PROJECT.read_text("utf-8"))["tool"]["setuptools"]

    names = [one["name"] for one in told["ext-modules"]]
    assert sorted(names) == sorted(f"bstm_daemon.{one}" for one in SOURCES)
    step = f"{building.__name__}.{building.BuildExt.__name__}"
    assert told["cmdclass"] == {"build_ext": step}


@pytest.mark.parametrize("module", SOURCES)
def test_a_module_is_built_from_its_sources(
    module: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It carries their hash; a compiler that fails stops no installation."""
    monkeypatch.chdir(tmp_path)
    extension = Extension(f"bstm_daemon.{module}", [])
    step = building.BuildExt(Distribution({"ext_modules": [extension]}))

    step.ensure_finalized()

    assert extension.sources == [f"bstm_daemon/{c}" for c in SOURCES[module]]
    assert extension.define_macros == [
        ("Py_LIMITED_API", "0x030B0000"),
        ("BSTM_SOURCES", f'"{digest(module)}"'),
    ]
    assert "-ffp-contract=off" in extension.extra_compile_args
    assert extension.optional
    assert extension.py_limited_api
