"""Compile an exported model and pack it as an FMU (FMI 2.0 or 3.0).

The sources are those of the compiled kernel, with ``exchange/wrapper`` and a
generated header of the car's numbers; none of them knows Python. They are
packed besides the binaries.
"""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from platform import machine
from tempfile import TemporaryDirectory
from typing import Final
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from bstm_daemon.errors import UsageError
from bstm_daemon.exchange.fmu_description import build_description, description
from bstm_daemon.exchange.fmu_model import FmuModel
from bstm_daemon.exchange.fmu_network import network_header
from bstm_daemon.files import replacing
from bstm_daemon.model.compiled import c_sources

FLAGS: Final = ("-std=gnu99", "-O3", "-ffp-contract=off", "-shared")
"""``-ffp-contract=off``: every platform rounds like the Python form."""


@dataclass(frozen=True, slots=True)
class Platform:
    """A platform: its folders in FMI 2.0 and 3.0, ending, compilers."""

    folders: tuple[str, str]
    ending: str
    compilers: tuple[str, ...]
    flags: tuple[str, ...] = ("-fPIC", "-fvisibility=hidden")


PLATFORMS: Final = {
    "linux64": Platform(
        ("linux64", "x86_64-linux"), ".so", ("x86_64-linux-gnu-gcc",)
    ),
    # FMI 2.0 has no name of its own for it
    "aarch64-linux": Platform(
        ("aarch64-linux", "aarch64-linux"), ".so", ("aarch64-linux-gnu-gcc",)
    ),
    "win64": Platform(
        ("win64", "x86_64-windows"),
        ".dll",
        ("x86_64-w64-mingw32-gcc",),
        ("-static-libgcc",),
    ),
    "darwin64": Platform(
        ("darwin64", "x86_64-darwin"), ".dylib", ("o64-clang",)
    ),
}

HOSTS: Final = {
    ("linux", "x86_64"): "linux64",
    ("linux", "aarch64"): "aarch64-linux",
    ("darwin", "x86_64"): "darwin64",
}


def this_platform() -> str:
    """Return the platform of this machine, "" where it has no name."""
    return HOSTS.get((sys.platform, machine()), "")


def compiler_of(name: str) -> str:
    """Return the C compiler for the platform *name*.

    Raises:
        UsageError: it is unknown or has no compiler here.
    """
    if name not in PLATFORMS:
        msg = f"--platform {name}: allowed are {', '.join(PLATFORMS)}"
        raise UsageError(msg)
    compilers = PLATFORMS[name].compilers
    if name == this_platform():
        compilers = (*compilers, "cc")
    for one in compilers:
        if shutil.which(one):
            return one
    msg = f"--platform {name}: needs the C compiler {compilers[0]}"
    raise UsageError(msg)


def write_fmu(
    model: FmuModel, path: Path, fmi: int, platforms: Sequence[str]
) -> None:
    """Write *model* to *path*, with a binary for each of *platforms*.

    The same model and compilers give the same bytes.

    Raises:
        UsageError: a compiler is missing or fails.
        FileAccessError: *path* can not be written.
    """
    compilers = {name: compiler_of(name) for name in platforms}
    header, token = network_header(model)
    other = "fmi3.c" if fmi == 2 else "fmi2.c"
    files = c_sources(heat=model.plan is not None) | {
        file.name: file.read_bytes()
        for file in Path(__file__).with_name("wrapper").glob("*.[ch]")
        if file.name != other
    }
    compiled = sorted(name for name in files if name.endswith(".c"))
    files["network.h"] = header.encode()
    packed = {"modelDescription.xml": description(model, token, fmi, compiled)}
    if fmi == 3:
        files["buildDescription.xml"] = build_description(model.name, compiled)
    with TemporaryDirectory() as away:
        for name, content in files.items():
            Path(away, name).write_bytes(content)
            packed[f"sources/{name}"] = content
        for name, compiler in compilers.items():
            platform = PLATFORMS[name]
            binary = f"{model.name}{platform.ending}"
            _compile(compiler, [*platform.flags], away, binary, compiled)
            folder = f"binaries/{platform.folders[fmi - 2]}"
            packed[f"{folder}/{binary}"] = Path(away, binary).read_bytes()
    with replacing(path) as temporary, ZipFile(temporary, "w") as archive:
        for name, content in sorted(packed.items()):
            # the date of ZipInfo is a fixed one
            entry = ZipInfo(name)
            entry.compress_type = ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)


def _compile(
    compiler: str,
    flags: Sequence[str],
    folder: str,
    binary: str,
    sources: Sequence[str],
) -> None:
    done = subprocess.run(  # noqa: S603  (a compiler, by its fixed name)
        [compiler, *FLAGS, *flags, *sources, "-lm", "-o", binary],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        msg = f"{compiler} failed: {done.stderr.strip()}"
        raise UsageError(msg)
