"""The step of the build that compiles; ``pyproject.toml`` names it.

What C shares with Python is written into a header here, out of the Python
tables. All modules are optional: where no compiler is, the pure-Python forms
take over. ``-ffp-contract=off``: the compiled step must round like the Python
one. ``-g0``: debugging information has the folder of the build in it, and two
builds would differ.
"""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parents[2]
HEADERS = {
    "generated.h": "bstm_daemon.model.compiled",
    "reality.h": "bstm_daemon.simulation.header",
}
ARGUMENTS = ["-O3", "-ffp-contract=off", "-g0"]


def in_place(module: str) -> ModuleType:
    """Return *module* of the package that is built, not of one installed.

    As it lies here: without what its packages look up once installed.
    """
    for name in ("bstm_daemon", "bstm_daemon.simulation"):
        if name not in sys.modules:
            package = ModuleType(name)
            package.__path__ = [str(ROOT / name.replace(".", "/"))]
            sys.modules[name] = package
    return import_module(module)


class BuildExt(build_ext):
    """Writes the headers first, and compiles always: C depends on Python."""

    def finalize_options(self) -> None:
        """Give each module of ``pyproject.toml`` what it is built from."""
        super().finalize_options()
        sources = in_place("bstm_daemon.native.sources")
        for one in self.extensions:
            module = one.name.removeprefix("bstm_daemon.")
            one.sources = [f"bstm_daemon/{c}" for c in sources.SOURCES[module]]
            one.define_macros = [
                ("Py_LIMITED_API", "0x030B0000"),
                ("BSTM_SOURCES", f'"{sources.digest(module)}"'),
            ]
            one.extra_compile_args = ARGUMENTS
            one.libraries = ["m"]
            one.optional = one.py_limited_api = True

    def run(self) -> None:
        """Build all modules."""
        folder = Path(self.build_temp)
        folder.mkdir(parents=True, exist_ok=True)
        for name, module in HEADERS.items():
            text = in_place(module).generated_header()
            (folder / name).write_text(text, encoding="utf-8")
        self.include_dirs.append(str(folder))
        self.force = True
        super().run()
