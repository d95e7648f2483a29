"""A copy of the tree in which mutants are built and tested.

The compiled modules are built here too, from the copy's sources and tables and
with the hash that the loader checks: a mutant of a table that C shares reaches
both forms, and none is refused for its hash alone.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Final

from coverage import CoverageData

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT: Final = Path(__file__).resolve().parents[2]
PACKAGE: Final = "bstm_daemon"

COMPILE: Final = (
    *("gcc", "-c", "-O2", "-fPIC", "-fwrapv", "-ffp-contract=off", "-w"),
    "-Werror=implicit-function-declaration",
    "-DPy_LIMITED_API=0x030B0000",
    f"-I{sysconfig.get_path('include')}",
)
SHARED: Final = """
import json
import sys
from bstm_daemon.model import compiled
from bstm_daemon.native.sources import SOURCES, digest
from bstm_daemon.simulation import header
hashes = {module: digest(module) for module in SOURCES}
headers = {"generated.h": compiled, "reality.h": header}
texts = {name: made.generated_header() for name, made in headers.items()}
files = [module.__file__ for module in [*sys.modules.values()]
         if module.__name__.startswith("bstm_daemon")]
print(json.dumps([texts, SOURCES, hashes, files]))
"""
PYTEST: Final = (
    *("-m", "pytest", "-q", "-p", "no:cacheprovider"),
    *("-m", "not full and not vcan and not systemd"),
    *("--hypothesis-profile", "mutants"),
)
LONGEST_S: Final = 4.0
"""A test that takes more without a mutant is asked about none."""
MEMORY: Final = 8 << 30
"""In bytes. A mutant may ask for all of it, or for all of the time."""
PATIENCE: Final = 10.0
"""Time on the clock over processor time: a busy machine stops no mutant."""
DURATION: Final = re.compile(
    r"^ *([\d.]+)s (?:setup|call|teardown) +(.+)$", re.MULTILINE
)


class BuildError(Exception):
    """A mutant that does not compile or import."""


class Clean:
    """What tests take and which lines they execute without a mutant."""

    def __init__(self, output: str, coverage: Path) -> None:
        """Read pytest's durations and the contexts of *coverage*."""
        self._seconds: Counter[str] = Counter()
        for seconds, test in DURATION.findall(output):
            self._seconds[test] += float(seconds)
        for test, seconds in [*self._seconds.items()]:
            if seconds > LONGEST_S:
                del self._seconds[test]
        self._executed = CoverageData(str(coverage))
        self._executed.read()

    def tests(self, path: Path, line: int) -> list[str]:
        """Return the tests that execute *line*, those of quick files first.

        Of a file, where one of its fixtures does; all, where it is executed
        on import, by no test, or is not Python.
        """
        found = set()
        if path.suffix == ".py":
            begin, end = _statement(path, line)
            contexts = self._executed.contexts_by_lineno(str(path))
            for number in range(begin, end + 1):
                found.update(contexts.get(number, ()))
        ran = [context.rpartition("|") for context in found]
        # "" is what runs on import, in no test
        known = {test for test, _, _ in ran if test in {"", *self._seconds}}
        # a fixture is set up once, and all tests of its file may need it
        shared = {
            test.partition("::")[0] for test, _, when in ran if when == "setup"
        }
        known |= {
            test for test in self._seconds if test.partition("::")[0] in shared
        }
        chosen = known if known and "" not in known else set(self._seconds)
        files: Counter[str] = Counter()
        for test in chosen:
            files[test.partition("::")[0]] += self._seconds[test]
        return sorted(chosen, key=lambda t: (files[t.partition("::")[0]], t))

    def runs(
        self, path: Path, line: int, often: Sequence[str]
    ) -> list[tuple[list[str], float]]:
        """Return :meth:`tests` in parts, each with its processor time [s].

        Those of *often* come first. A part that takes more is endless.
        """
        tests = self.tests(path, line)
        parts = [test for test in often if test in tests], tests
        return [
            (part, 10.0 + 2.0 * sum(self._seconds[test] for test in part))
            for part in parts
            if part
        ]


class Tree:
    """A copy of all files that git knows or would add; built and clean."""

    def __init__(self, folder: Path) -> None:
        """Copy the tree into *folder* and build it."""
        self.path = folder / "tree"
        self._objects = folder / "objects"
        self._objects.mkdir()
        listed = _call(
            ("git", "ls-files", "--cached", "--others", "--exclude-standard")
        )
        for name in listed.splitlines():
            if (ROOT / name).is_file():
                (self.path / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.path / name)
        self.instructions = self.build()

    def build(self) -> list[str]:
        """Build the compiled modules; return the hashes of their objects.

        Raises:
            BuildError: they do not compile, or the tables do not import.
        """
        code, text = self.python("-c", SHARED)
        if code:
            raise BuildError(text)
        headers, modules, hashes, self.tables = json.loads(text)
        package = self.path / PACKAGE
        shared = sha256()
        for name, header in headers.items():
            (self._objects / name).write_text(header, "utf-8")
            shared.update(header.encode())
        for path in sorted(package.rglob("*.h")):
            shared.update(path.read_bytes())
        found = []
        for module, sources in modules.items():
            objects = []
            for source in sources:
                path = package / source
                own = "BSTM_SOURCES" in path.read_text("utf-8")
                # without the hash of the sources, for the comparison
                same = self._object(path, shared.hexdigest(), "")
                found.append(sha256(same.read_bytes()).hexdigest())
                objects.append(
                    self._object(path, shared.hexdigest(), hashes[module])
                    if own
                    else same
                )
            library = package / f"{module.replace('.', '/')}.abi3.so"
            library.unlink(missing_ok=True)
            _call(("gcc", "-shared", "-o", library, *objects, "-lm"))
        return found

    def compiles(self, source: Path) -> bool:
        """Whether *source* of C does, much sooner than it is built."""
        macro, include = '-DBSTM_SOURCES=""', f"-I{self._objects}"
        check = (*COMPILE, "-fsyntax-only", macro, include, source)
        done = subprocess.run(check, check=False, capture_output=True)
        return done.returncode == 0

    def _object(self, source: Path, headers: str, hashed: str) -> Path:
        text = source.read_bytes()
        key = sha256(f"{source}{headers}{hashed}".encode() + text).hexdigest()
        made = self._objects / f"{key}.o"
        if not made.exists():
            macro = f'-DBSTM_SOURCES="{hashed}"'
            include = f"-I{self._objects}"
            _call((*COMPILE, macro, include, source, "-o", made))
        return made

    def python(
        self, *arguments: str, seconds: float = 3600.0, **variables: str
    ) -> tuple[int, str]:
        """Return exit code and output of Python in the copy.

        Args:
            arguments: of Python.
            seconds: processor time after which it is stopped.
            variables: of its environment.
        """
        limits = f"--as={MEMORY}", f"--cpu={seconds:.0f}"
        clock = "--kill-after=5", f"{PATIENCE * seconds:.0f}"
        done = subprocess.run(
            (
                *("prlimit", *limits, "timeout", *clock),
                *(sys.executable, *arguments),
            ),
            cwd=self.path,
            env=os.environ
            | {
                "BSTM_KERNEL": "compiled",
                "CI": "1",
                "PYTHONDONTWRITEBYTECODE": "1",
                "PYTHONPATH": str(self.path),
            }
            | variables,
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        return done.returncode, done.stdout

    def clean(self, tests: Sequence[str], sources: Sequence[str]) -> Clean:
        """Run *tests* without a mutant; see which lines of *sources* they do.

        Raises:
            RuntimeError: one fails.
        """
        coverage = self.path / f"coverage-of-{'-'.join(tests)}".replace(
            "/", "-"
        )
        folders = {
            f"--cov={PACKAGE}/{source.partition('*')[0].rpartition('/')[0]}"
            for source in sources
            if source.endswith(".py")
        }
        code, text = self.python(
            *(*PYTEST, "-vv", "--durations=0", "--durations-min=0"),
            *(*sorted(folders), "--cov-context=test", "--cov-report="),
            *("--cov-fail-under=0", *tests),
            COVERAGE_FILE=str(coverage),
            PYTHONDONTWRITEBYTECODE="",
        )
        if code:
            msg = f"tests fail without a mutant:\n{text}"
            raise RuntimeError(msg)
        return Clean(text, coverage)


def _statement(path: Path, line: int) -> tuple[int, int]:
    """Return first and last line of the statement, or its head, at *line*."""
    found = line, line
    for node in ast.walk(ast.parse(path.read_bytes())):  # inner ones later
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or 0
            if node.lineno <= line <= last:
                found = node.lineno, last
    return found


def _call(command: Sequence[str | Path]) -> str:
    done = subprocess.run(
        command, cwd=ROOT, check=False, capture_output=True, text=True
    )
    if done.returncode:
        raise BuildError(done.stderr)
    return done.stdout
