"""Mutation testing: how many small defects the tests of a room find.

``mutants.py [ROOM ...] [--count N]``. universalmutator changes one line, and
the quick tests of the room run in a copy of the tree. Verdicts are kept in
``.ci/cache`` until the file or the tests change, so a run goes on where the
last one ended. ``mutants.toml`` names survivors with the reason of each: those
that no test can find do not count, of the others it says why none does.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import sys
import tempfile
import tomllib
from collections import Counter, defaultdict
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Final
from warnings import catch_warnings

from mutant_tree import (
    PACKAGE,
    PYTEST,
    ROOT,
    BuildError,
    Tree,
)
from run import show
from side_by_side import Goal, Outcome, Table
from universalmutator.mutator import mutants_regexp

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

STORE: Final = ROOT / ".ci" / "cache" / "mutants.jsonl"
ACCEPTED: Final = Path(__file__).with_suffix(".toml")
FULL, SAMPLE = 300, 5
"""Mutants of a room."""
IGNORED: Final = ["^@dataclass", "@abstractmethod", '^"[^"]*"[);,]*$']
"""Lines that are left as they are: what they promise, mypy holds, or they are
a text of C."""
FIRST: Final = 12
"""Tests that found most mutants of a room so far; they run before others."""
SCORE: Final = 0.9
SEED: Final = "1"
NOT_FOUND: Final = 4
"""Pytest's exit code where a test that was named is not there."""
UNTIMED_S: Final = 150.0
"""Processor time of tests that no clean run timed [s]."""
FAILED: Final = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
RULES: Final = {
    ".py": ["universal.rules", "python.rules"],
    ".c": ["universal.rules", "c_like.rules", "c.rules"],
    ".h": ["universal.rules", "c_like.rules", "c.rules"],
}


@dataclass(frozen=True, slots=True)
class Room:
    """What is mutated, below the package, and its tests, below ``tests``.

    Those of *beside* run where the room's own find nothing.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    beside: tuple[str, ...] = ()


def _mirrored(*names: str, beside: tuple[str, ...] = ()) -> dict[str, Room]:
    return {
        name: Room((f"{name}/**/*.py",), (name,), beside) for name in names
    }


GOLDEN: Final = ("golden",)
ROOMS: Final = {
    **_mirrored("bus/output", "bus/signals", "model/risk"),
    **_mirrored("model/wear", "model/effects"),
    **_mirrored("forecast", "model/heat", "model/thermal", beside=GOLDEN),
    **_mirrored(
        "estimator",
        beside=("model/wear", "model/effects/test_inputs.py", *GOLDEN),
    ),
    **_mirrored("analysis/gap", "analysis/matching"),
    "service state": Room(
        ("service/state_*.py", "service/persistence.py"),
        tuple(
            f"service/test_{name}.py"
            for name in ("state_file", "persistence", "persistence_values")
        ),
        ("service",),
    ),
    "native/heat": Room(("native/heat/*.[ch]",), ("model/heat",), GOLDEN),
    "native/thermal": Room(
        ("native/thermal/*.[ch]", "native/risk/*.[ch]", "native/python/*.c"),
        (
            *("model/thermal", "model/risk/test_vaporisation.py"),
            "model/heat/test_sample_time.py",
        ),
        GOLDEN,
    ),
    "native/bus": Room(
        ("native/bus/*.[ch]",), ("bus/signals", "bus/logs", "bus/live")
    ),
}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One line of *file*, below the package, changed; lines count from 1.

    It is the *nth* of its text in the file.
    """

    file: str
    line: int
    before: str
    after: str
    nth: int = 1


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a mutant, as long as the files ``on`` hash to ``hashed``.

    ``result`` is killed, survived, or none where nothing was changed that
    could be compiled; ``by`` is the test that failed, or what else did.
    """

    key: str
    result: str
    by: str
    on: list[str]
    hashed: str


def main(arguments: list[str] | None = None) -> int:
    """Print scores and survivors; 1 where a score is too low."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM")
    parser.add_argument("--count", type=int, default=FULL, metavar="N")
    args = parser.parse_args(arguments)
    for room in args.rooms:
        if room not in ROOMS:
            parser.error(f"no room {room!r}; there are {', '.join(ROOMS)}")
    outcome = examined(args.rooms or list(ROOMS), args.count)
    show(outcome)
    return int(not all(goal.reached for goal in outcome.goals))


def run(*, full: bool) -> Outcome:
    """Judge the mutants of all rooms, or a few of each."""
    return examined(list(ROOMS), FULL if full else SAMPLE)


def examined(rooms: Sequence[str], count: int) -> Outcome:
    """Judge *count* mutants of each of *rooms*."""
    accepted, unfound = reasons("equivalent"), reasons("survivor")
    known = {}
    STORE.parent.mkdir(parents=True, exist_ok=True)
    (STORE.parent / ".gitignore").write_text("*\n", "utf-8")
    if STORE.exists():
        for line in STORE.read_text("utf-8").splitlines():
            kept = Verdict(**json.loads(line))
            known[kept.key] = kept
    outcome = Outcome(
        "Mutation testing",
        f"{count} mutants a room, one changed line each, drawn with a seed "
        "over all lines, against the room's quick tests. Equivalent: "
        "survivors that no test can find, with the reason in "
        "`tests/benchmarks/mutants.toml`; they do not count.",
    )
    scores, open_ones = [], []
    with tempfile.TemporaryDirectory() as folder:
        tree = Tree(Path(folder))
        for name in rooms:
            found = judged(tree, ROOMS[name], count, known)
            killed = sum(v.result == "killed" for v in found.values())
            survivors = [m for m, v in found.items() if v.result != "killed"]
            left = [m for m in survivors if not said(m, accepted)]
            for mutant in found.keys() - set(survivors):
                if said(mutant, accepted | unfound):
                    msg = f"{ACCEPTED.name}: a test finds {edit(mutant)}"
                    raise ValueError(msg)
            score = killed / max(killed + len(left), 1)
            outcome.goals.append(Goal(name, score, SCORE, 0.0))
            equivalent = len(survivors) - len(left)
            numbers = (len(found), killed, equivalent, len(left))
            scores.append((name, *map(str, numbers), f"{score:.1%}"))
            open_ones += [(*_row(m), said(m, unfound)) for m in left]
    header = ("room", "mutants", "killed", "equivalent", "survivors", "score")
    outcome.tables = [
        Table("Scores", header, tuple(scores)),
        Table("Survivors", ("line", "is", "was", "why"), tuple(open_ones)),
    ]
    return outcome


def _row(mutant: Mutant) -> tuple[str, str, str]:
    is_, was = (
        f"`{' '.join(text.split()) or ' '}`".replace("|", r"\|")
        for text in (mutant.after, mutant.before)
    )
    return f"{mutant.file}:{mutant.line}", is_, was


def edit(mutant: Mutant) -> tuple[str, str, str]:
    """Return what names *mutant* in ``mutants.toml``, wherever its line is."""
    return mutant.file, mutant.before.strip(), mutant.after.strip()


def said(mutant: Mutant, of: Mapping[tuple[str | int, ...], str]) -> str:
    """Return the reason of *mutant*, nothing where :func:`reasons` has none.

    One that is of no certain line is of each that reads so.
    """
    nths = (mutant.nth, 0)
    found = (of[*edit(mutant), n] for n in nths if (*edit(mutant), n) in of)
    return next(found, "")


def reasons(kind: str) -> dict[tuple[str | int, ...], str]:
    """Return why survivors of *kind* are: ``equivalent`` or ``survivor``.

    Raises:
        ValueError: the line of one is no longer in its file.
    """
    found = {}
    for entry in tomllib.loads(ACCEPTED.read_text("utf-8")).get(kind, ()):
        text = (ROOT / PACKAGE / entry["file"]).read_text("utf-8")
        if entry["before"] not in map(str.strip, text.splitlines()):
            msg = f"{ACCEPTED.name}: {entry['file']} lacks {entry['before']}"
            raise ValueError(msg)
        place = entry["file"], entry["before"], entry["after"]
        found[*place, entry.get("nth", 0)] = entry["reason"]
    return found


def judged(
    tree: Tree, room: Room, count: int, known: dict[str, Verdict]
) -> dict[Mutant, Verdict]:
    """Return *count* mutants of *room* with what became of them."""
    own, beside = (
        [f"tests/{test}" for test in tests]
        for tests in (room.tests, room.beside)
    )
    found: dict[Mutant, Verdict] = {}
    killed_by: Counter[str] = Counter()
    clean = None
    for mutant in mutants(room):
        if len(found) == count:
            break
        path = ROOT / PACKAGE / mutant.file
        original = path.read_text("utf-8")
        lines = original.splitlines(keepends=True)
        lines[mutant.line - 1] = mutant.after
        text = "".join(lines)
        if path.suffix == ".py" and not _differs(original, text):
            continue
        key = sha256(f"{mutant.file}\n{text}".encode()).hexdigest()
        verdict = known.get(key)
        if verdict is None or hashed(verdict.on) != verdict.hashed:
            result, by = "survived", ""
            if (
                verdict
                and "::" in verdict.by
                and (ROOT / verdict.on[0]).is_file()
            ):  # the same test finds it quickly
                runs = [([verdict.by], UNTIMED_S)]
                result, by = judge(tree, mutant, text, runs)
            if result == "survived":
                clean = clean or tree.clean(own, room.sources)
                place = tree.path / PACKAGE / mutant.file
                often = [test for test, _ in killed_by.most_common(FIRST)]
                runs = clean.runs(place, mutant.line, often)
                if beside:
                    runs.append((beside, UNTIMED_S))
                result, by = judge(tree, mutant, text, runs)
            # what one test finds is found while that test stands
            on = [PACKAGE, *own, *beside] if result == "survived" else []
            if "::" in by:
                on = [by.partition("::")[0]]
            verdict = known[key] = Verdict(key, result, by, on, hashed(on))
            with STORE.open("a", encoding="utf-8") as store:
                store.write(json.dumps(asdict(verdict)) + "\n")
        if verdict.result != "none":
            found[mutant] = verdict
        killed_by[verdict.by] += 1
    return found


def judge(
    tree: Tree,
    mutant: Mutant,
    text: str,
    runs: Sequence[tuple[Sequence[str], float]],
) -> tuple[str, str]:
    """Return a verdict's ``result`` and ``by``.

    *runs* are tests with their processor time [s], until one finds *mutant*.
    """
    path = tree.path / PACKAGE / mutant.file
    compiled = path.suffix != ".py"
    built = compiled or str(path) in tree.tables
    original = path.read_bytes()
    times = path.stat()
    path.write_text(text, "utf-8")
    code, output = 0, ""
    try:
        if path.suffix == ".c" and not tree.compiles(path):
            built = False
            return "none", "the build"
        if built and tree.build() == tree.instructions and compiled:
            return "none", "the same instructions"
        for tests, seconds in runs:
            code, output = _tested(tree, tests, seconds)
            if code:
                break
    except BuildError:
        return ("none" if compiled else "killed"), "the build"
    finally:
        path.write_bytes(original)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        if built:
            tree.build()
    if code == 0:
        return "survived", ""
    failed = FAILED.search(output)
    return "killed", failed[1] if failed else f"exit code {code}"


def _tested(
    tree: Tree, tests: Sequence[str], seconds: float
) -> tuple[int, str]:
    """Return exit code and output of *tests* up to the first that fails."""
    code, output = tree.python(*PYTEST, "-x", *tests, seconds=seconds)
    if code == NOT_FOUND:  # names of tests come from what is mutated
        files = dict.fromkeys(test.partition("::")[0] for test in tests)
        code, output = tree.python(*PYTEST, "-x", *files, seconds=seconds)
    return code, output


def mutants(room: Room) -> Iterator[Mutant]:
    """Return all mutants of *room* as its sample takes them.

    First one for each line, then a second one. Their order depends on the
    lines' text, so that a change elsewhere leaves the sample as it is.
    """
    places = []
    for pattern in room.sources:
        for path in sorted((ROOT / PACKAGE).glob(pattern)):
            file = path.relative_to(ROOT / PACKAGE).as_posix()
            lines = path.read_text("utf-8").splitlines(keepends=True)
            with redirect_stdout(io.StringIO()):
                made = mutants_regexp(
                    lines,
                    RULES[path.suffix],
                    ignorePatterns=IGNORED,
                    ignoreStringOnly=True,
                )
            seen: Counter[str] = Counter()
            at = defaultdict(list)
            for line, after, *_ in made:
                at[line].append(after)
            for line, afters in at.items():
                before = lines[line - 1]
                text = before.strip()
                seen[text] += 1
                ours = [
                    Mutant(file, line, before, after, seen[text])
                    for after in afters
                ]
                ours.sort(key=lambda mutant: _rank(*edit(mutant)))
                place = _rank(file, text, str(seen[text]))
                places.append((place, line, ours))
    turns = zip_longest(*(ours for *_, ours in sorted(places)))
    return (mutant for turn in turns for mutant in turn if mutant)


def _rank(*texts: str) -> str:
    return sha256("\n".join((SEED, *texts)).encode()).hexdigest()


def _differs(original: str, text: str) -> bool:
    """Return whether *text* is a mutant of Python and not a slip of a rule.

    It runs other instructions, imports the same, and has no name that the
    file lacks: that would be an error wherever it is met.
    """
    try:
        with catch_warnings(action="error", category=SyntaxWarning):
            before, after = _meaning(original), _meaning(text)
    except (SyntaxError, ValueError):
        return False
    return (
        before[0] != after[0]
        and before[1] == after[1]
        and after[2] <= before[2]
    )


@cache
def _meaning(text: str) -> tuple[str, list[str], set[str]]:
    """Return instructions, imports and names."""
    tree = ast.parse(text)
    imports, names = [], set()
    for node in ast.walk(tree):
        match node:
            case ast.Import() | ast.ImportFrom():
                imports.append(ast.unparse(node))
            case (
                ast.FunctionDef(name=name)
                | ast.arg(arg=name)
                | ast.Name(id=name)
                | ast.Attribute(attr=name)
                | ast.keyword(arg=str(name))
            ):
                names.add(name)
    tree = ast.fix_missing_locations(_Program().visit(tree))
    return _instructions(compile(tree, "", "exec")), imports, names


def _instructions(code: CodeType) -> str:
    """Return what is run, without lines and names of files."""
    constants = [
        _instructions(part) if isinstance(part, CodeType) else repr(part)
        for part in code.co_consts
    ]
    return repr((code.co_code, code.co_names, code.co_varnames, constants))


class _Program(ast.NodeTransformer):
    """Leaves out what does nothing when a program runs."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        if getattr(node, "body", None) == []:
            node.body = [ast.Pass()]
        return node

    def visit_Pass(self, node: ast.Pass) -> None:
        return None

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        nothing = isinstance(node.value, ast.Constant | ast.Name)
        return None if nothing else self.generic_visit(node)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST | None:
        return None if node.module == "__future__" else node

    def visit_If(self, node: ast.If) -> ast.AST | None:
        typing_only = "TYPE_CHECKING" in ast.dump(node.test)
        return None if typing_only else self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        match node.body[-1]:
            case ast.Return(value=None | ast.Constant(value=None)):
                node.body.pop()
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node


def hashed(paths: Iterable[str]) -> str:
    """Return the hash of files, or of all sources in folders."""
    found = sha256()
    for name in paths:
        path = ROOT / name
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in {".py", ".c", ".h", ".toml"}:
                found.update(file.read_bytes())
    return found.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
