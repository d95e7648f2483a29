"""From a log file to columns of samples, against python-can and cantools."""

from __future__ import annotations

import os
import tempfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest import mock

import can
import numpy as np
from mf4_traffic import with_asammdf, write_mf4
from side_by_side import Goal, Outcome, Table, Work, take_turns
from traffic import FRAMES_PER_S, RATES_HZ, example_database, write_traffic

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.native.loader import VARIABLE, extension

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy.typing as npt

    from bstm_daemon.bus.signals.columns import Events
    from bstm_daemon.bus.signals.extraction import Output
    from bstm_daemon.bus.signals.signal_map import SignalMap


class Samples(NamedTuple):
    """Samples in file order: stamps [us], role numbers, SI values."""

    time_us: npt.NDArray[np.int64]
    role: npt.NDArray[np.int32]
    value: npt.NDArray[np.float64]

    def bytes(self) -> tuple[bytes, bytes, bytes]:
        """Return every bit of them, for comparison."""
        return (
            self.time_us.tobytes(),
            self.role.tobytes(),
            self.value.tobytes(),
        )

    def first(self, count: int) -> Samples:
        """Return the first *count* of them."""
        return Samples(
            self.time_us[:count], self.role[:count], self.value[:count]
        )


_BYTES_PER_SAMPLE = 24
"""Of a log, at a guess: room for more samples costs a copy."""

GOALS = (
    ("reference", "cantools", "Python against python-can", 1.0, 0.3),
    ("any", "cantools", "compiled against python-can", 80.0, 0.4),
    ("any", "asammdf", "compiled against asammdf's MF4", 5.0, 0.4),
    ("mf4 any", "asammdf", "MF4, compiled, against asammdf", 2.5, 0.4),
)
"""Fast, slow, name, ratio, tolerance."""
PATHS = {
    "cantools": "python-can, cantools",
    "reference": "Python, line by line",
    "any": "compiled",
    "asammdf": "asammdf, from MF4",
    "mf4 reference": "Python, from MF4",
    "mf4 any": "compiled, from MF4",
}


def run(*, full: bool) -> Outcome:
    """Measure a mixed log, every value compared."""
    config, signal_map = load_vehicle(
        shipped_file("config/example_vehicle.toml")
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mixed.log"
        lines = write_traffic(path, 1020 if full else 120, config)
        megabytes = path.stat().st_size / 1e6
        ours = with_events(path, signal_map, "reference")
        if ours.bytes() != with_cantools(path, signal_map).bytes():
            msg = "samples differ from those of python-can and cantools"
            raise AssertionError(msg)
        works = {"cantools": Work(lambda: with_cantools(path, signal_map))}
        works |= _own(path, signal_map, ours, "")
        if find_spec("asammdf") is not None:
            mf4 = path.with_suffix(".mf4")
            write_mf4(mf4, path)
            _compare(ours, with_asammdf(mf4, signal_map))
            works["asammdf"] = Work(lambda: with_asammdf(mf4, signal_map))
            works |= _own(mf4, signal_map, ours, "mf4 ")
        # the first rounds get their memory from the system, page by page
        timings = take_turns(works, 5 if full else 9)
    outcome = Outcome(
        "Log decode",
        f"A candump file of {lines / 1e6:.2f} million frames, "
        f"{megabytes:.0f} MB: {FRAMES_PER_S} frames a second, "
        f"{sum(RATES_HZ.values())} of them wanted, to columns of "
        f"{len(ours.value) / 1e6:.2f} million samples in SI. Against "
        "python-can's LogReader with cantools, only wanted ids decoded, "
        "choices off; all samples are equal bit for bit, checked in the run. "
        "The same frames as an MF4 file, not compressed, against asammdf, "
        "values equal to 1e-12. Opening the file is in all of it, reading the "
        "DBC in none. The quickest round of each side, not the median.",
    )
    outcome.goals = [
        Goal(name, timings.best(slow) / timings.best(fast), least, tolerance)
        for fast, slow, name, least, tolerance in GOALS
        if fast in works and slow in works
    ]
    outcome.tables = [
        Table(
            "Frames read in a second of CPU time",
            ("path", "million frames/s", "ns/frame"),
            tuple(
                (
                    text,
                    f"{lines / timings.best(name) / 1e6:.3g}",
                    f"{timings.best(name) / lines * 1e9:.3g}",
                )
                for name, text in PATHS.items()
                if name in works
            ),
        )
    ]
    return outcome


def _own(
    path: Path, signal_map: SignalMap, expected: Samples, prefix: str
) -> dict[str, Work]:
    """Return the forms that are there, each found to give *expected*."""
    forms = ["reference"] if extension() is None else ["reference", "any"]
    works = {}
    for form in forms:
        if with_events(path, signal_map, form).bytes() != expected.bytes():
            msg = f"samples of {path.name} differ in the form {form!r}"
            raise AssertionError(msg)
        works[prefix + form] = Work(
            partial(with_events, path, signal_map, form)
        )
    return works


def _compare(
    ours: Samples, by_role: Mapping[int, tuple[Any, npt.NDArray[np.float64]]]
) -> None:
    """Raise where asammdf's samples are not those of *ours*."""
    for role, (time_us, value) in by_role.items():
        own = ours.role == role
        if not (
            np.array_equal(ours.time_us[own], time_us)
            and np.allclose(ours.value[own], value, rtol=1e-12, atol=1e-12)
        ):
            msg = f"samples of role {role} differ from those of asammdf"
            raise AssertionError(msg)


def with_events(path: Path, signal_map: SignalMap, form: str) -> Samples:
    """Read *path* as the replay does, in the *form* of ``BSTM_KERNEL``."""
    with mock.patch.dict(os.environ, {VARIABLE: form}):
        room = path.stat().st_size // _BYTES_PER_SAMPLE
        return joined(EventLog(path, signal_map).events(), room)


def joined(chunks: Iterable[Events], room: int) -> Samples:
    """Return all samples in one array each, with *room* for so many at first.

    A chunk is let go at once: keeping all of them takes new memory from the
    system for each, and that costs more than to copy them.
    """
    whole = _room(room)
    count = 0
    for events in chunks:
        end = count + len(events)
        if end > len(whole.value):
            grown = _room(2 * end)
            grown.time_us[:count] = whole.time_us[:count]
            grown.role[:count] = whole.role[:count]
            grown.value[:count] = whole.value[:count]
            whole = grown
        whole.time_us[count:end] = events.time_us
        whole.role[count:end] = events.role
        whole.value[count:end] = events.value
        count = end
    return whole.first(count)


def _room(count: int) -> Samples:
    return Samples(
        np.empty(count, np.int64),
        np.empty(count, np.int32),
        np.empty(count, np.float64),
    )


def with_cantools(path: Path, signal_map: SignalMap) -> Samples:
    """Read *path* frame by frame; units in one go at the end."""
    database = example_database()
    outputs: list[Output] = []
    wanted = {}
    for key, plan in signal_map.messages.items():
        message = database.get_message_by_frame_id(key.can_id)
        names = []
        for output in plan.outputs:
            names.append((plan.signals[output.index].name, len(outputs)))
            outputs.append(output)
        wanted[key.can_id] = (message.decode, names)
    times: list[float] = []
    which: list[int] = []
    values: list[Any] = []
    with can.LogReader(path) as reader:
        for frame in reader:
            if frame.arbitration_id not in wanted or frame.is_extended_id:
                continue
            decode, names = wanted[frame.arbitration_id]
            found: Any = decode(frame.data, decode_choices=False)  # type: ignore[arg-type]
            for name, number in names:
                times.append(frame.timestamp)
                which.append(number)
                values.append(found[name])
    numbers = np.array(which)
    gains = np.array([output.gain for output in outputs])[numbers]
    biases = np.array([output.bias for output in outputs])[numbers]
    roles = np.array([output.role for output in outputs], np.int32)[numbers]
    return Samples(
        np.rint(np.array(times) * 1e6).astype(np.int64),
        roles,
        gains * np.array(values, np.float64) + biases,
    )
