"""Which sources each compiled module is built from, and their hash.

``building.py`` goes by this table and writes the hash into the module; the
loader compares it with that of the sources beside it. It needs nothing but
the standard library.
"""

from hashlib import sha256
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).resolve().parents[1]

TABLES: Final = {
    "native._kernel": (
        "channels",
        "roles",
        "units",
        "model.heat.check_rules",
        "model.heat.friction_law",
        "model.heat.fusion",
        "model.heat.inputs",
        "model.heat.learned",
        "model.heat.memory",
        "model.heat.observer",
        "model.heat.observer_faults",
        "model.heat.observer_rules",
        "model.heat.readings",
        "model.heat.sample_pass",
        "model.heat.sample_plan",
        "model.thermal.program",
        "model.thermal.reference",
        "native.header",
        "native.layout",
    ),
    "simulation._reality": (
        "native.header",
        "native.layout",
        "simulation.header",
        "simulation.parameters",
        "simulation.sizes",
        "units",
    ),
}
"""Python modules that a generated header is written from, by module."""

SOURCES: Final = {
    "native._kernel": (
        "native/heat/checks.c",
        "native/heat/fusion.c",
        "native/heat/inputs.c",
        "native/heat/learned.c",
        "native/heat/motion_checks.c",
        "native/heat/observer.c",
        "native/heat/observer_faults.c",
        "native/heat/pressure_checks.c",
        "native/heat/sample_pass.c",
        "native/python/kernel.c",
        "native/risk/vaporisation.c",
        "native/thermal/march.c",
    ),
    "native._bus": (
        "native/bus/candump.c",
        "native/bus/extract.c",
        "native/bus/receive.c",
        "native/bus/records.c",
    ),
    "simulation._reality": ("simulation/_reality.c",),
}
"""C files by module. Their hash takes in all headers of their folders."""


def digest(module: str) -> str:
    """Return the hash of the sources of *module*, a key of SOURCES.

    Raises:
        FileNotFoundError: they are not here: the package is installed
            without them.
    """
    paths = [PACKAGE / source for source in SOURCES[module]]
    folders = {path.parent for path in paths}
    paths += [path for folder in folders for path in folder.glob("*.h")]
    tables = TABLES.get(module, ())
    paths += [PACKAGE / f"{t.replace('.', '/')}.py" for t in tables]
    found = sha256()
    for path in sorted(paths):
        found.update(path.read_bytes())
    return found.hexdigest()[:16]
