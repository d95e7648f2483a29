"""From a log file to columns of samples, against python-can and cantools."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest import mock

import can
import numpy as np
from side_by_side import Goal, Outcome, Table, Work, take_turns
from traffic import FRAMES_PER_S, RATES_HZ, example_database, write_traffic

from bstm_daemon.bus.compiled import extension
from bstm_daemon.bus.logs import EventLog
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.native import VARIABLE
from bstm_daemon.shipped import shipped_file

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.bus.extraction import Output
    from bstm_daemon.bus.signal_map import SignalMap


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


def run(*, full: bool) -> Outcome:
    """Measure a mixed log, every value compared."""
    vehicle = load_vehicle(shipped_file("config/example_vehicle.toml"))
    config, signal_map = vehicle
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mixed.log"
        lines = write_traffic(path, 1020 if full else 120, config)
        megabytes = path.stat().st_size / 1e6
        ours = with_events(path, signal_map, "reference")
        if ours.bytes() != with_cantools(path, signal_map).bytes():
            msg = "samples differ from those of python-can and cantools"
            raise AssertionError(msg)
        works = {
            "cantools": Work(lambda: with_cantools(path, signal_map)),
            "reference": Work(
                lambda: with_events(path, signal_map, "reference")
            ),
        }
        if extension() is not None:
            compiled = with_events(path, signal_map, "any")
            if compiled.bytes() != ours.bytes():
                msg = "samples differ between the compiled form and NumPy's"
                raise AssertionError(msg)
            works["any"] = Work(lambda: with_events(path, signal_map, "any"))
        timings = take_turns(works, 5 if full else 3)
    outcome = Outcome(
        "Log decode",
        f"A candump file of {lines / 1e6:.2f} million frames, "
        f"{megabytes:.0f} MB: {FRAMES_PER_S} frames a second, "
        f"{sum(RATES_HZ.values())} of them wanted, to columns of "
        f"{len(ours.value) / 1e6:.2f} million samples in SI. Against "
        "python-can's LogReader with cantools, only wanted ids decoded, "
        "choices off. All samples are equal bit for bit, checked in the run.",
    )
    outcome.goals = [
        Goal(
            f"{text} against python-can with cantools",
            timings.ratio("cantools", name),
            at_least,
            tolerance,
        )
        for name, text, at_least, tolerance in (
            ("reference", "columns, NumPy", 40.0, 0.5),
            ("any", "columns, compiled", 80.0, 0.4),
        )
        if name in works
    ]
    outcome.tables = [
        Table(
            "Frames read in a second of CPU time",
            ("path", "million frames/s", "MB/s", "of real time"),
            tuple(
                (
                    text,
                    f"{lines / timings.median(name) / 1e6:.3g}",
                    f"{megabytes / timings.median(name):.3g}",
                    f"{lines / FRAMES_PER_S / timings.median(name):.0f}x",
                )
                for name, text in (
                    ("cantools", "python-can, cantools"),
                    ("reference", "columns, NumPy"),
                    ("any", "columns, compiled"),
                )
                if name in works
            ),
        )
    ]
    return outcome


def with_events(path: Path, signal_map: SignalMap, form: str) -> Samples:
    """Read *path* as the replay does, in the *form* of ``BSTM_KERNEL``."""
    with mock.patch.dict(os.environ, {VARIABLE: form}):
        events = list(EventLog(path, signal_map).events())
    return Samples(
        np.concatenate([e.time_us for e in events]),
        np.concatenate([e.role for e in events]),
        np.concatenate([e.value for e in events]),
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
