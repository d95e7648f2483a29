"""Mutated frames, states and configurations through the engine.

``engine_fuzz.py [--frames N] [--states N] [--configurations N] [--seed S]
[--out FOLDER]``. The same seed gives the same input. Nothing but a worded
error may come out, no estimate may leave physical bounds without a flag that
says so, and memory must not grow. Exits 1 at the first input that does
otherwise, which is then in FOLDER.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import re
import sys
import tempfile
import traceback
from collections import Counter
from copy import deepcopy
from math import inf, isfinite
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import structlog
from mutation import mutated

from bstm_daemon.bus.output.e2e import CheckStatus
from bstm_daemon.bus.output.published import PublishedDecoder
from bstm_daemon.bus.signals.signal_map import compile_signal_map
from bstm_daemon.cli.main import main as command
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.service import E2eConfig
from bstm_daemon.engine import Engine
from bstm_daemon.errors import BstmError
from bstm_daemon.estimate import Validity
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.files import shipped_file
from bstm_daemon.service.assembly import BusOverride, build_monitor
from bstm_daemon.service.state_file import (
    decode,
    encode,
    load,
    save,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.engine import Published

FRAMES: Final = 10_000_000
STATES: Final = 20_000
CONFIGURATIONS: Final = 2_000
FRAMES_AT_ONCE: Final = 5_000
RESTART_EVERY: Final = 100_000
"""Frames after which the state goes through a file into a new engine."""

LOWEST_K: Final = 200.0
HIGHEST_K: Final = 1800.0
"""Colder than any air, hotter than iron melts: no brake."""

MEMORY_GROWTH: Final = 1.05
MEMORY_SLACK_BYTES: Final = 4 * 2**20
"""Most growth of resident memory from a tenth of the frames to all."""

START_US: Final = 1_700_000_000_000_000
_S: Final = 1_000_000
_JUMPS_US: Final = (
    *(sign * far * _S for far in (2, 11, 90, 4000) for sign in (1, -1)),
    *(50_000 * _S, -50_000 * _S, 3_000_000 * _S, 1 << 50, -(1 << 50)),
    *(1 << 61, -(1 << 61), -START_US, (1 << 63) - 1 - 2 * START_US),
)
_CLOCK_SET: Final[tuple[Callable[[Random], int], ...]] = (
    lambda rng: rng.randrange(-(10**13), 0),
    lambda rng: rng.randrange(60 * _S),
    lambda rng: rng.randrange(43_300 * _S, 10**13),
)
"""By how much the clock is set [us]. What lies between a minute and half a day
is marched, which takes its time: no service does that, it parks the brakes."""
_PROTECTED: Final = E2eConfig(
    message="BrakePressure", profile=5, data_ids=[0x1234]
)


class Defect(Exception):  # noqa: N818  (what is found, not what went wrong)
    """The engine did what it must not."""


class Input(NamedTuple):
    """A frame as the engine takes it; with ``tick`` only its time."""

    stamp_us: int
    tick: bool
    bus: int = 0
    can_id: int = 0
    extended: bool = False
    data: bytes = b""
    is_error: bool = False
    is_remote: bool = False


def main(arguments: list[str] | None = None) -> int:
    """Fuzz as asked for; 1 where a defect was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES, metavar="N")
    parser.add_argument("--states", type=int, default=STATES, metavar="N")
    parser.add_argument(
        "--configurations", type=int, default=CONFIGURATIONS, metavar="N"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--out", type=Path, default=Path(), metavar="FOLDER")
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for check, count in (
            (FrameCheck(), args.frames),
            (StateCheck(folder), args.states),
            (ConfigCheck(folder), args.configurations),
        ):
            what = check.what
            rng = Random(f"{args.seed} {what}")  # noqa: S311
            try:
                check.run(rng, count)
            except Exception:  # noqa: BLE001  (any is the finding)
                kept = args.out / f"fuzz-{args.seed}-{what}{check.ending}"
                kept.write_bytes(check.last_input())
                say(traceback.format_exc())
                say(f"failed: {what}, kept in {kept}")
                return 1
            told = ", ".join(
                f"{number} {reason}"
                for reason, number in check.outcomes.most_common()
            )
            say(f"{count} mutated {what}: {told}")
    say(f"{args.frames + args.states + args.configurations} passed")
    return 0


class FrameCheck:
    """Frames into a running engine."""

    what = "frames"
    ending = ".frames"

    def __init__(self) -> None:
        """Build the example car, one message of it protected."""
        self.outcomes: Counter[str] = Counter()
        path = shipped_file("config/example_vehicle.toml")
        self._config = config = load_config(path)
        self._signal_map = compile_signal_map(
            config.bus,
            config.signals,
            path.parent,
            config.vehicle.wheel_radius_m,
            e2e=[_PROTECTED],
        )
        self._traffic = Traffic(self._signal_map)
        self._before: dict[str, Any] = {}
        self._inputs: list[Input] = []

    def run(self, rng: Random, count: int) -> None:
        """Raise :class:`Defect` or whatever comes out of the engine."""
        engine = self._engine()
        watch = Watch(engine)
        early = resident_bytes()
        for first in range(0, count, FRAMES_AT_ONCE):
            if first and first % RESTART_EVERY == 0:
                self._count(engine, watch)
                engine = self._restarted(engine, rng)
                watch = Watch(engine)
                self.outcomes["restarts"] += 1
            self._before = engine.export_state()
            self._inputs = list(
                self._traffic.inputs(rng, min(FRAMES_AT_ONCE, count - first))
            )
            feed(engine, self._inputs, watch)
            if first <= count // 10:
                early = resident_bytes()
        late = resident_bytes()
        expect(
            late <= MEMORY_GROWTH * early + MEMORY_SLACK_BYTES,
            f"memory: {early} bytes after a tenth, {late} at the end",
        )
        self._count(engine, watch)
        self.outcomes["KiB of memory more"] = (late - early) // 1024

    def last_input(self) -> bytes:
        """Return the last inputs behind the state before them, as text."""
        lines = [json.dumps(self._before)]
        lines += [
            json.dumps(one._replace(data=one.data.hex()))  # type: ignore[arg-type]
            for one in self._inputs
        ]
        return "\n".join(lines).encode()

    def _engine(self) -> Engine:
        return Engine(self._config, self._signal_map, history_known=True)

    def _count(self, engine: Engine, watch: Watch) -> None:
        """Add up what *engine* met and gave."""
        self.outcomes.update(watch.outcomes)
        self.outcomes["clock jumps"] += engine.estimator.counts["jumps"]
        self.outcomes["estimates begun anew"] += engine.estimator.resets
        for reason, number in engine.decoder.counts.items():
            self.outcomes[str(reason)] += number

    def _restarted(self, engine: Engine, rng: Random) -> Engine:
        """Return a new engine that goes on from the state of *engine*."""
        fresh = self._engine()
        document = decode(encode(engine.export_state()))
        time_us = document["time_us"] or 0
        parked_us = rng.choice((None, 0, 5 * _S, 3600 * _S, -7 * _S))
        fresh.resume(document, parked_us, time_us + (parked_us or 0))
        return fresh


class Traffic:
    """Frames that might come from a bus, sound and otherwise."""

    def __init__(self, signal_map: SignalMap) -> None:
        """Take the wanted frames of *signal_map* as the model."""
        self._lengths = {
            (key.can_id, key.extended): plan.length
            for key, plan in signal_map.messages.items()
        }
        self._keys = list(self._lengths)
        self._now_us = START_US

    def inputs(self, rng: Random, count: int) -> Iterator[Input]:
        """Yield *count* frames, ticks besides."""
        for _ in range(count):
            self._now_us += rng.randrange(4000)
            luck = rng.random()
            if luck < 2e-5:
                # the clock is set: everything from now on is there
                self._now_us += rng.choice(_CLOCK_SET)(rng)
            stamp_us = self._now_us
            if luck < 0.2:
                stamp_us += rng.randrange(-20_000, 20_000)
            elif luck < 0.20005:
                stamp_us = _bounded(stamp_us + rng.choice(_JUMPS_US))
            yield self._frame(rng, stamp_us)
            if luck > 0.95:
                ahead_us = rng.choice((0, 0, 0, 2000, -50_000))
                if luck > 0.9999:
                    ahead_us = rng.choice((10, -10, 120)) * _S
                yield Input(self._now_us + ahead_us, tick=True)

    def _frame(self, rng: Random, stamp_us: int) -> Input:
        key = rng.choice(self._keys)
        length = self._lengths[key]
        kind = rng.random()
        if kind < 0.5:
            # values that change little: most pass the checks of samples
            data = bytes(length)
            place = rng.randrange(length)
            data = (
                data[:place] + bytes([rng.randrange(40)]) + data[place + 1 :]
            )
        else:
            data = rng.randbytes(length)
        can_id, extended = key
        bus = 0
        is_error = is_remote = False
        if kind > 0.9:
            change = rng.randrange(6)
            if change == 0:
                data = data[: rng.randrange(length + 1)]
            elif change == 1:
                data += rng.randbytes(rng.choice((1, 4, 56)))
            elif change == 2:
                can_id, extended = rng.getrandbits(29), True
            elif change == 3:
                can_id, bus = rng.getrandbits(11), rng.randrange(3)
            else:
                is_error, is_remote = change == 4, change == 5
        return Input(
            *(stamp_us, False, bus, can_id, extended, data),
            *(is_error, is_remote),
        )


class Watch:
    """Looks at everything that an engine publishes."""

    def __init__(self, engine: Engine) -> None:
        """Watch *engine* from its first publication on."""
        self.outcomes: Counter[str] = Counter()
        self._engine = engine
        config = engine.config
        self._decoder = PublishedDecoder(
            config.publish.id_base, [corner.name for corner in config.corner]
        )

    def look(self, published: Sequence[Published]) -> None:
        """Check the estimates of the last tick and what tells of them."""
        engine = self._engine
        for block in engine.blocks:
            for group, output in zip(
                engine.estimator.groups, block.outputs, strict=True
            ):
                places = len(block.times_us) * len(group.corners)
                for place in range(places):
                    row, member = divmod(place, len(group.corners))
                    first = place * group.size
                    validity = block.validity[group.corners[member]][row]
                    check_nodes(output[first : first + group.nodes], validity)
                    self.outcomes[f"estimates {Validity(validity).name}"] += 1
        for time_us, frame in published:
            found = self._decoder.decode(frame.can_id, frame.data)
            expect(found is not None, f"id {frame.can_id:X}")
            assert found is not None
            expect(
                found.verdict is not CheckStatus.WRONG_CRC,
                f"CRC of {frame.name} at {time_us}",
            )
            usable = found.values["Validity"] <= Validity.DEGRADED
            expect(
                not usable or inf not in found.values.values(),
                f"{frame.name} at {time_us}: {found.values}",
            )


def feed(engine: Engine, inputs: Sequence[Input], watch: Watch) -> None:
    """Give *inputs* to *engine*, everything it publishes to *watch*."""
    frame = engine.frame
    for one in inputs:
        if one.tick:
            watch.look(engine.tick(one.stamp_us))
            continue
        frame(
            one.bus,
            one.can_id,
            one.extended,
            one.data,
            one.stamp_us,
            is_error=one.is_error,
            is_remote=one.is_remote,
        )


def check_nodes(nodes_k: Sequence[float], validity: int) -> None:
    """Raise :class:`Defect` where *nodes_k* need a flag and have none."""
    sound = isfinite(sum(nodes_k)) and (
        min(nodes_k) > LOWEST_K and max(nodes_k) < HIGHEST_K
    )
    expect(
        sound or validity >= Validity.INVALID,
        f"{list(nodes_k)} K with validity {validity}",
    )


class StateCheck:
    """State files, damaged in their bytes and in what they say."""

    what = "states"
    ending = ".state"

    def __init__(self, folder: Path) -> None:
        """Write files to *folder*; the sound state is of a short drive."""
        self.outcomes: Counter[str] = Counter()
        self._path = folder / "car.state"
        self._config, self._signal_map = load_vehicle(
            shipped_file("config/example_vehicle.toml")
        )
        self._traffic = Traffic(self._signal_map)
        engine = Engine(self._config, self._signal_map)
        self._engine = engine
        self._document: dict[str, Any] = {}
        self._sound = self._input = b""

    def run(self, rng: Random, count: int) -> None:
        """Raise :class:`Defect` or whatever comes out."""
        engine = self._engine
        feed(engine, list(self._traffic.inputs(rng, 2000)), Watch(engine))
        self._document = engine.export_state()
        self._sound = self._input = encode(self._document)
        for number in range(count):
            if number % 2:
                self._damaged_bytes(rng)
            else:
                self._other_content(rng)

    def last_input(self) -> bytes:
        """Return the last file."""
        return self._input

    def _damaged_bytes(self, rng: Random) -> None:
        head, _, body = self._sound.partition(b"\n")
        part = rng.choice((head, body, self._sound))
        changed = mutated(part, [head, body], rng)
        self._input = self._sound.replace(part, changed)
        self._path.write_bytes(self._input)
        loaded = load(self._path)
        if self._input == self._sound:
            return
        if loaded.document is None:
            problem = loaded.problem or ""
            expect(self._path.name in problem, f"problem {problem!r}")
            self.outcomes["damaged files refused"] += 1
        else:
            # nothing that matters changed, such as a zero before the length
            expect(loaded.document == self._document, "another document")
            self.outcomes["damaged files read as they were"] += 1

    def _other_content(self, rng: Random) -> None:
        document = deepcopy(self._document)
        for _ in range(rng.choice((1, 1, 2, 5))):
            _mutate(document, rng)
        try:
            self._input = encode(document)
        except ValueError:
            self.outcomes["contents not for a file"] += 1
            return
        save(self._path, self._input)
        loaded = load(self._path)
        expect(loaded.document == document, "another document")
        engine = Engine(self._config, self._signal_map)
        parked_us = rng.choice((None, 0, 7 * _S, 86_400 * _S, -5 * _S))
        now_us = self._document["time_us"] + (parked_us or 0)
        try:
            engine.resume(document, parked_us, now_us)
        except StateError as error:
            expect(len(str(error)) > 10, f"message {error}")
            self.outcomes["contents refused"] += 1
            return
        self.outcomes["contents taken"] += 1
        inputs = list(self._traffic.inputs(rng, 200))
        behind_us = now_us - inputs[0].stamp_us
        inputs = [
            one._replace(stamp_us=_bounded(one.stamp_us + behind_us))
            for one in inputs
        ]
        feed(engine, inputs, Watch(engine))
        encode(engine.export_state())


_OTHER_VALUES: Final[tuple[Callable[[Random], Any], ...]] = (
    lambda _: None,
    lambda rng: rng.choice((True, False)),
    lambda rng: rng.choice((0, 1, -1, 15, 1 << 31, 1 << 63, -(1 << 63))),
    lambda rng: rng.getrandbits(rng.choice((8, 64, 200))),
    lambda rng: rng.choice((0.0, -0.0, 1e-320, 1e308, -1e308, 199.9, 1e4)),
    lambda rng: rng.uniform(-2000.0, 2000.0),
    lambda rng: rng.choice(("", "disc", "0", "FL", "\0", "\ud7ff" * 9)),
    lambda rng: [0.0] * rng.choice((0, 1, 2, 500)),
    lambda _: {},
    lambda _: {"disc": 300.0},
    lambda _: [[[]]],
)


def _mutate(document: dict[str, Any], rng: Random) -> None:
    """Change, remove or add one value somewhere in *document*."""
    place: Any = document
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        key = rng.choice(keys)
        inner = place[key]
        if not isinstance(inner, dict | list) or not inner:
            break
        if rng.random() < 0.15:
            break
        place = inner
    kind = rng.random()
    if kind < 0.1:
        del place[key]
    elif kind < 0.15 and isinstance(place, dict):
        place[rng.choice(("x", "", "FL", "disc"))] = place[key]
    elif isinstance(place[key], float) and kind < 0.5:
        place[key] *= rng.choice((-1.0, 0.0, 2.0, 1e6, 1e-6, 1e300))
    else:
        place[key] = rng.choice(_OTHER_VALUES)(rng)


_VALUE: Final = re.compile(r"(?<== )[^#\n]+")
_WORDS: Final = (
    *("0", "-1", "1", "1e9", "-1e9", "1e-9", "1e308", "nan", "inf", "-inf"),
    *("true", "false", '""', '"x"', "[]", "[1]", "{}", "[[]]", '"FL"'),
    *('"bar"', '"km/h"', '"degC"', '"can0"', '"../../../x"', '"\\u0000"'),
    *("9223372036854775808", "0.5", '"abs("', '"1/0"', '"ff"', '"fb"'),
    *("1979-05-27", "0x7FF", '"measured"', '"é"', "[nan]", "1_000"),
)
_FACTORS: Final = (0.5, 0.9, 1.1, 2.0, -1.0, 10.0, 0.1, 1e3, 1e-3, 1e6, 1e-6)


class ConfigCheck:
    """Configuration files: as text and as values."""

    what = "configurations"
    ending = ".toml"

    def __init__(self, folder: Path) -> None:
        """Write files to *folder*, which lies beside the DBC files."""
        self.outcomes: Counter[str] = Counter()
        self._path = folder / "config" / "car.toml"
        self._path.parent.mkdir()
        sources = [
            shipped_file(f"config/{name}.toml")
            for name in ("example_vehicle", "subaru_wrx_sti", "toyota_rav4")
        ]
        dbc = folder / "dbc"
        dbc.symlink_to(sources[0].parents[1] / "dbc")
        self._texts = [source.read_text("utf-8") for source in sources]
        self._input = b""

    def run(self, rng: Random, count: int) -> None:
        """Raise :class:`Defect` or whatever comes out."""
        for _ in range(count):
            self._input = self._changed(rng)
            self._path.write_bytes(self._input)
            code = self._check()
            expect(code in (0, 74, 78), f"exit code {code}")
            self.outcomes[f"ended with {code}"] += 1
            self._load(rng, accepted=code == 0)

    def last_input(self) -> bytes:
        """Return the last file."""
        return self._input

    def _changed(self, rng: Random) -> bytes:
        text = rng.choice(self._texts)
        values = list(_VALUE.finditer(text))
        if rng.random() < 0.5:
            for _ in range(rng.choice((1, 1, 2))):
                found = rng.choice(values)
                new = rng.choice(_WORDS)
                with contextlib.suppress(ValueError):
                    number = float(found[0])
                    if rng.random() < 0.7:
                        new = repr(number * rng.choice(_FACTORS))
                if rng.random() < 0.2:
                    new = rng.choice(values)[0]
                text = text[: found.start()] + new + text[found.end() :]
                values = list(_VALUE.finditer(text))
            return text.encode()
        lines = text.encode().splitlines(keepends=True)
        told = [
            number
            for number, line in enumerate(lines)
            if line.strip() and not line.startswith(b"#")
        ]
        for _ in range(rng.choice((1, 1, 3))):
            number = rng.choice(told)
            lines[number] = mutated(lines[number], lines, rng)
        return b"".join(lines)

    def _check(self) -> int:
        """Run ``bstm check``; the user has to be told of every problem."""
        told, problems = io.StringIO(), io.StringIO()
        with (
            contextlib.redirect_stdout(told),
            contextlib.redirect_stderr(problems),
        ):
            code = command(["check", str(self._path)])
        text = problems.getvalue()
        expect("Traceback" not in text, text)
        expect(bool(text) == (code != 0), f"exit code {code}: {text!r}")
        return code

    def _load(self, rng: Random, *, accepted: bool) -> None:
        """Build the service of it; one that was accepted has to run."""
        try:
            load_config(self._path)
            monitor = build_monitor(self._path, BusOverride())
        except BstmError as error:
            expect(len(str(error)) > 10, f"message {error}")
            self.outcomes["services refused"] += 1
            if accepted:
                self.outcomes["services refused after the check"] += 1
            return
        expect(accepted, "a service of what the check refuses")
        engine = monitor.engine
        if not engine.decoder._messages:
            return
        inputs = list(Traffic(monitor.signal_map).inputs(rng, 300))
        feed(engine, inputs, Watch(engine))
        encode(engine.export_state())


def _bounded(stamp_us: int) -> int:
    """Return *stamp_us* as a kernel could give it."""
    return max(-(1 << 62), min(stamp_us, 1 << 62))


def resident_bytes() -> int:
    """Return the memory in use now."""
    status = Path("/proc/self/status").read_text("ascii")
    found = re.search(r"^VmRSS:\s*(\d+) kB$", status, re.MULTILINE)
    assert found is not None
    return int(found[1]) * 1024


def expect(holds: bool, message: str) -> None:  # noqa: FBT001
    """Raise :class:`Defect` with *message* unless it *holds*."""
    if not holds:
        raise Defect(message)


def say(line: str) -> None:
    """Write *line* at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR)
    )
    sys.exit(main())
