"""Build of the compiled forms; all else of the package is in pyproject.toml.

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

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent

# the packages as they lie here, without what they look up once installed
sys.path.insert(0, str(ROOT))
for name in ("bstm_daemon", "bstm_daemon.simulation"):
    package = ModuleType(name)
    package.__path__ = [str(ROOT / name.replace(".", "/"))]
    sys.modules[name] = package
sources = import_module("bstm_daemon.native.sources")
HEADERS = {
    "generated.h": "bstm_daemon.model.compiled",
    "reality.h": "bstm_daemon.simulation.header",
}


class BuildExt(build_ext):
    """Writes the headers first, and compiles always: C depends on Python."""

    def run(self) -> None:
        """Build all modules."""
        folder = Path(self.build_temp)
        folder.mkdir(parents=True, exist_ok=True)
        for name, module in HEADERS.items():
            text = import_module(module).generated_header()
            (folder / name).write_text(text, encoding="utf-8")
        self.include_dirs.append(str(folder))
        self.force = True
        super().run()


setup(
    cmdclass={"build_ext": BuildExt},
    ext_modules=[
        Extension(
            f"bstm_daemon.{module}",
            [f"bstm_daemon/{name}" for name in names],
            define_macros=[
                ("Py_LIMITED_API", "0x030B0000"),
                ("BSTM_SOURCES", f'"{sources.digest(module)}"'),
            ],
            extra_compile_args=["-O3", "-ffp-contract=off", "-g0"],
            libraries=["m"],
            optional=True,
            py_limited_api=True,
        )
        for module, names in sources.SOURCES.items()
    ],
)
