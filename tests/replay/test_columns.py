"""Whole logs: what is published of them, and what odd logs do."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from cantools.autosar.end_to_end import compute_profile2_crc
from cantools.database.can import Database

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.output.layout import ADVICE_OFFSET, own_ids
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Following
from bstm_daemon.errors import ConfigError, FileAccessError, LogError
from bstm_daemon.estimate import Reason
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.replay.columns import AdviceSeries, present_roles, stream_log
from bstm_daemon.replay.frames import (
    publications,
    write_frames,
)
from bstm_daemon.replay.results import Collector, Part, Results, ResultsBuilder
from bstm_daemon.replay.results.rows import (
    ADVICE_COLUMNS,
    CAR_COLUMNS,
    CORNER_COLUMNS,
)
from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump
from tests.replayed import Replay, replay_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.model.thermal.brake_corner import CornerSpec
    from bstm_daemon.model.thermal.network import Network

ROOT = Path(__file__).parents[2]
CAR = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"
DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")
ENCODER = Encoder(DBC)

LATER = re.compile("measured|peak")
"""Temperatures that are not there from the first row on."""

# front discs reach some 300 degC; drizzle all the way
DRIVE = """
[drive]
name = "wet"
description = "three hard stops in the rain and a pause"
ambient_c = 10.0
[[segment]]
repeat = 3
[[segment.segment]]
speed_kmh = 120.0
rate_ms2 = 4.0
gear = 4
rain = 0.6
duration_s = 10.0
[[segment.segment]]
speed_kmh = 30.0
rate_ms2 = 7.0
gear = 3
rain = 0.6
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
rain = 0.6
[[segment]]
parked = true
rain = 0.6
duration_s = 10.0
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of the drive."""
    path = tmp_path_factory.mktemp("replay") / "wet.log"
    write_candump(path, simulate(parse_drive(DRIVE, "wet")), ENCODER)
    return path


@pytest.fixture(scope="module")
def lines(log: Path) -> list[str]:
    """Return its lines."""
    return log.read_text(encoding="ascii").splitlines()


@pytest.fixture(scope="module")
def plain(log: Path) -> Replay:
    """Return its replay."""
    return replay_log(*load_vehicle(CAR), log)


@pytest.fixture(scope="module")
def published(log: Path) -> Path:
    """Return what the engine publishes over it, as a log."""
    out = log.with_name("published.log")
    config, signal_map = load_vehicle(CAR)
    assert publish(config, signal_map, log, out) > 0
    return out


@pytest.mark.slow
@pytest.mark.skipif(load_kernel() is None, reason="half an hour of data")
def test_when_the_start_was_known_is_counted_from_the_first_estimate(
    tmp_path: Path,
) -> None:
    """Its minutes are those after which no row has the reason any more."""
    path = tmp_path / "motorway.log"
    motorway = """
[drive]
name = "motorway"
description = "light brakes in much air"
[[segment]]
speed_kmh = 108.0
rate_ms2 = 4.0
gear = 5
duration_s = 1500.0
"""
    write_candump(path, simulate(parse_drive(motorway, "motorway")), ENCODER)
    light = load_vehicle(ROOT / "tests" / "golden" / "alpine.toml")

    found = replay_log(*light, path, every_us=1_000_000, forecast=False)

    assert 15.0 < found.start_known_s / 60.0 < 25.0
    time_s = found.results.columns["time_s"]
    for corner in found.results.modelled:
        why = found.results.columns[f"{corner}.reasons"].astype(int)
        unknown = time_s[(why & Reason.START_UNKNOWN) != 0]
        assert unknown[-1] - time_s[0] <= found.start_known_s
    assert unknown[-1] - time_s[0] == pytest.approx(
        found.start_known_s, abs=2.0
    )


@pytest.mark.parametrize("parts", [Part.NONE, Part.VALIDITY])
def test_only_the_parts_that_a_sink_uses(
    log: Path, plain: Replay, parts: Part
) -> None:
    """The others change no bit of the rest."""
    one, other = Collector(Part.NONE), Collector(parts)

    stream_log(*load_vehicle(CAR), log, [one, other])

    found = one.results().columns
    assert found.keys() == other.results().columns.keys()
    every = plain.results.columns
    assert all(found[k].tobytes() == every[k].tobytes() for k in found)
    absent = {name.rpartition(".")[2] for name in every.keys() - found.keys()}
    forecast = {
        *(*CORNER_COLUMNS, *CAR_COLUMNS, *ADVICE_COLUMNS, "forecast_age_s"),
    }
    validity = {"validity", "reasons"} if parts is Part.NONE else set()
    assert absent == forecast | validity


def publish(
    config: Config,
    signal_map: SignalMap,
    log: Path,
    out: Path,
    *,
    forecast: bool = True,
) -> int:
    """Write what a daemon would have sent beside *log*."""
    ticks = publications(config, signal_map, log, forecast=forecast)
    channel = config.bus[config.publishing_bus].channel
    return write_frames(ticks, channel, out)


def moved(line: str, seconds: float) -> str:
    """Return *line* with its stamp moved by *seconds*."""
    stamp, rest = line.split(maxsplit=1)
    whole, micros = stamp.strip("()").split(".")
    at_us = int(whole) * 1_000_000 + int(micros) + round(seconds * 1e6)
    return f"({at_us // 1_000_000}.{at_us % 1_000_000:06d}) {rest}"


def write(path: Path, lines: list[str]) -> Path:
    """Write a log of *lines*."""
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def replayed(path: Path, car: Path = CAR, *, forecast: bool = True) -> Replay:
    """Replay *path*."""
    return replay_log(*load_vehicle(car), path, forecast=forecast)


def same(one: Results, other: Results) -> bool:
    """Whether two results agree in every bit."""
    return one.columns.keys() == other.columns.keys() and all(
        one.columns[name].tobytes() == other.columns[name].tobytes()
        for name in one.columns
    )


def frames_of(path: Path) -> list[tuple[int, str, int, bytes]]:
    """Return (time, channel, id, data) of a log, read by our own reader."""
    reader = CandumpReader(path)
    found = []
    for chunk in reader.chunks():
        assert not chunk.extended.any()
        assert set(chunk.length.tolist()) <= {8}
        found += list(
            zip(
                chunk.time_us.tolist(),
                [reader.interfaces[i] for i in chunk.channel.tolist()],
                chunk.can_id.tolist(),
                [row.tobytes()[:8] for row in chunk.data],
                strict=True,
            )
        )
    assert not reader.refused
    return found


# --publish


def test_published_frames_are_ours_alone_at_their_rates(
    published: Path,
) -> None:
    """10 Hz, risk and forecast at 1 Hz, wear at 0.1 Hz, on the car's bus."""
    frames = frames_of(published)
    first_us, last_us = frames[0][0], frames[-1][0]
    tenths = (last_us - first_us) // 100_000 + 1

    advice = {0x5B0 + ADVICE_OFFSET}
    assert {can_id for _, _, can_id, _ in frames} == set(
        own_ids(0x5B0, frozenset(CORNERS))
    ) - advice
    assert {channel for _, channel, _, _ in frames} == {"can0"}
    for message in DATABASE.messages:
        if message.frame_id in advice:
            continue
        times = [at for at, _, i, _ in frames if i == message.frame_id]
        cycle_us = 1000 * (message.cycle_time or 0)
        assert set(np.diff(times).tolist()) == {cycle_us}, message.name
        assert len(times) == pytest.approx(tenths * 1e5 / cycle_us, abs=1)


def test_published_frames_are_protected(published: Path) -> None:
    """CRC as cantools forms it with the DBC's data ids; counters in turn."""
    last: dict[int, int] = {}
    for _, _, can_id, data in frames_of(published):
        message = DATABASE.get_message_by_frame_id(can_id)
        assert message.dbc is not None
        listed = str(message.dbc.attributes["E2EDataIDList"].value)
        data_ids = [int(part) for part in listed.split(",")]
        counter = data[1] & 0x0F
        assert data[0] == compute_profile2_crc(data, data_ids[counter])
        if can_id in last:
            assert counter == (last[can_id] + 1) % 16
        last[can_id] = counter
    assert len(last) == len(DATABASE.messages) - 1


def test_published_temperatures_are_the_estimates(
    published: Path, plain: Replay
) -> None:
    """Each within half a quantum of the column of the same time."""
    columns = plain.results.columns
    row = {
        round(at * 1e6): i for i, at in enumerate(columns["time_s"].tolist())
    }
    compared = 0
    for at_us, _, can_id, data in frames_of(published):
        if at_us not in row:
            continue
        message = DATABASE.get_message_by_frame_id(can_id)
        corner = message.name.split("_")[1]
        values = message.decode(data, decode_choices=False)
        assert isinstance(values, dict)
        if corner not in CORNERS:
            continue
        names = {
            "Temperatures": {
                "Disc": ("disc_c", 0.5),
                "PadFront": ("pad_front_c", 0.5),
                "PadBack": ("pad_back_c", 0.5),
                "Fluid": ("fluid_c", 0.1),
                "Validity": ("validity", 1.0),
            },
            "Risk": {
                "Margin": ("margin_k", 0.2),
                "Level": ("risk_level", 1.0),
                "FadeLevel": ("fade_level", 1.0),
            },
            "Forecast": {
                "Peak": ("peak_c", 0.1),
                "PeakIn": ("peak_in_s", 30.0),
                "FluidDeviation": ("fluid_std_k", 0.5),
            },
        }.get(message.name.split("_")[-1], {})
        for signal, (column, quantum) in names.items():
            estimate = columns[f"{corner}.{column}"][row[at_us]]
            if np.isnan(estimate):  # no forecast yet
                continue
            sent = float(str(values[signal]))
            assert abs(sent - estimate) <= 0.5 * quantum + 1e-9
            compared += 1
    assert compared > 4 * 5 * len(plain.results) - 100


def test_published_reasons_are_those_of_the_table(
    published: Path, plain: Replay
) -> None:
    """The bits of every corner, in each row."""
    columns = plain.results.columns
    message = DATABASE.get_message_by_name("BSTM_Reasons")
    sent = {}
    for at_us, _, can_id, data in frames_of(published):
        if can_id == message.frame_id:
            values = message.decode(data, decode_choices=False)
            assert isinstance(values, dict)
            sent[at_us] = [values[f"Reasons{corner}"] for corner in CORNERS]

    rows = np.column_stack([columns[f"{c}.reasons"] for c in CORNERS])
    for at_s, row in zip(columns["time_s"].tolist(), rows, strict=True):
        assert sent[round(at_s * 1e6)] == row.tolist()
    assert {Reason.START_UNKNOWN} <= set(rows.ravel().astype(int).tolist())


def test_publication_covers_the_whole_log(
    published: Path, plain: Replay
) -> None:
    """Every row of the table is on the bus, and the one before the first."""
    time_s = plain.results.columns["time_s"]
    times = [at for at, _, i, _ in frames_of(published) if i == 0x5B0]

    assert times[1:] == np.rint(time_s * 1e6).astype(int).tolist()
    assert times[0] == times[1] - 100_000


def test_publication_of_nothing_leaves_nothing(tmp_path: Path) -> None:
    """A log without a frame gives no empty file."""
    log = write(tmp_path / "remarks.log", ["# nothing", "# here"])
    config, signal_map = load_vehicle(CAR)

    with pytest.raises(LogError, match="no CAN frame"):
        publish(config, signal_map, log, tmp_path / "out.log")
    assert list(tmp_path.iterdir()) == [log]


# one path


@pytest.mark.parametrize("chunk_bytes", [64, 1_000, 77_777])
def test_chunks_of_the_reader_do_not_matter(
    log: Path, plain: Replay, chunk_bytes: int
) -> None:
    """Cut the log anywhere: not a bit changes."""
    config, signal_map = load_vehicle(CAR)
    events = EventLog(log, signal_map)
    events.reader = CandumpReader(log, events._wanted, chunk_bytes=chunk_bytes)
    present = present_roles(signal_map)
    estimator = Estimator(config, present)
    rows = Collector()
    builder = ResultsBuilder(estimator, [rows])
    following = Following(config, estimator, present)
    monitor, advice = following.risk, AdviceSeries(following)
    assert monitor is not None
    for part in events.events():
        samples = part.time_us, part.role, part.value
        monitor.ingest(*samples)
        advice.ingest(*samples)
        for block in estimator.blocks(*samples):
            risks = monitor.add(block)
            builder.add([block], [risks], [advice.add(block, risks)])

    builder.finish()
    assert same(rows.results(), plain.results)


def edited(lines: list[str], how: str) -> list[str]:
    """Return the log with one thing wrong in the middle of the drive."""
    i = next(n for n, line in enumerate(lines) if "(1700000017." in line)
    edits: dict[str, Callable[[], list[str]]] = {
        "clock backwards": lambda: [
            *lines[:i],
            *(moved(line, -600.0) for line in lines[i:]),
        ],
        "gap of 5 s": lambda: [
            *lines[:i],
            *(moved(line, 5.0) for line in lines[i:]),
        ],
        "gap of 2 h": lambda: [
            *lines[:i],
            *(moved(line, 7200.0) for line in lines[i:]),
        ],
        "gap of 3 days": lambda: [
            *lines[:i],
            *(moved(line, 259_200.0) for line in lines[i:]),
        ],
        "clock set": lambda: [
            *lines[:i],
            *(moved(line, 1e9) for line in lines[i:]),
        ],
        "outlier": lambda: [
            *lines[:i],
            moved(lines[i], 1e8 + 0.0123),
            *lines[i + 1 :],
        ],
        "outlier back": lambda: [
            *lines[:i],
            moved(lines[i], 0.0123 - 1e8),
            *lines[i + 1 :],
        ],
        "a frame too early": lambda: [
            *lines[:i],
            lines[i + 40],
            *lines[i : i + 40],
            *lines[i + 41 :],
        ],
        "outlier at the end": lambda: [
            *lines[:-1],
            moved(lines[-1], 1e8 + 0.01),
        ],
    }
    return edits[how]()


@pytest.mark.parametrize(
    ("how", "rows", "counts"),
    [
        ("clock backwards", 0, {"dropped": 5, "jumps": 1}),
        ("gap of 5 s", 50, {}),
        pytest.param(
            *("gap of 2 h", 72_000, {"dropped": 5}),
            marks=[pytest.mark.slow, pytest.mark.full],  # 390 000 frames
        ),
        ("gap of 3 days", 0, {"dropped": 5, "jumps": 1}),
        ("clock set", 0, {"dropped": 5, "jumps": 1}),
        ("outlier", 0, {"dropped": 5}),
        ("outlier back", 0, {"dropped": 5}),
        ("a frame too early", 0, {"late": 200}),
        ("outlier at the end", 0, {"dropped": 5}),
    ],
)
def test_odd_time_stamps(
    lines: list[str],
    plain: Replay,
    tmp_path: Path,
    how: str,
    rows: int,
    counts: dict[str, int],
) -> None:
    """Each has its defined answer, the same for replay and publication.

    ``counts`` are upper bounds of samples (a frame has up to five), except
    for jumps. The table leaves the first publication out.
    """
    path = write(tmp_path / "odd.log", edited(lines, how))
    config, signal_map = load_vehicle(CAR)

    odd = replay_log(config, signal_map, path, forecast=False)
    publish(config, signal_map, path, tmp_path / "out.log", forecast=False)

    assert odd.counts["jumps"] == counts.get("jumps", 0)
    for name in ("late", "dropped"):
        most = counts.get(name, 0)
        assert min(most, 1) <= odd.counts[name] <= most, name
    assert len(odd.results) == pytest.approx(len(plain.results) + rows, abs=2)
    sent = [
        (at, DATABASE.decode_message(i, data, decode_choices=False))
        for at, _, i, data in frames_of(tmp_path / "out.log")
        if i == 0x5B4
    ][1:]
    expected = np.rint(odd.results.columns["time_s"] * 1e6).astype(int)
    assert [at for at, _ in sent] == expected.tolist()
    discs = np.array([dict(values)["Disc"] for _, values in sent], float)
    assert (
        np.abs(discs - odd.results.columns["FL.disc_c"]).max() <= 0.25 + 1e-9
    )
    assert all(
        np.isfinite(column).all()
        for name, column in odd.results.columns.items()
        if name.endswith("_c") and not LATER.search(name)
    )


@pytest.mark.parametrize(
    ("how", "shift_s", "share"),
    [
        ("gap of 5 s", 5.0, (1.3, 1.6)),
        pytest.param(
            *("gap of 2 h", 7200.0, (1.0, 5.0)), marks=pytest.mark.slow
        ),
        ("gap of 3 days", 259_200.0, (1.0, 5.0)),
        ("clock set", 1e9, (0.99, 1.01)),
    ],
)
def test_what_gaps_do_to_the_brakes(
    lines: list[str],
    plain: Replay,
    tmp_path: Path,
    how: str,
    shift_s: float,
    share: tuple[float, float],
) -> None:
    """The car drives before and after, so that no gap is parking.

    5 s: a full stop; 2 h and 3 days: the balance of the load before, which
    was one stop in a minute; clock set: nothing. Bounds are shares of the
    disc's temperature over ambient before it.
    """
    path = write(tmp_path / "gap.log", edited(lines, how))
    after = replayed(path, forecast=False).results.columns
    before_s = 1_700_000_016.9
    row = int(np.searchsorted(after["time_s"], before_s + 0.3 + shift_s))

    hot = plain.results.columns["FL.disc_c"]
    at = int(np.searchsorted(plain.results.columns["time_s"], before_s))
    kept = (after["FL.disc_c"][row] - 10.0) / (hot[at] - 10.0)

    assert hot[at] > 50.0
    assert share[0] <= kept <= share[1]


def test_values_out_of_range_are_no_samples(
    lines: list[str], plain: Replay, tmp_path: Path
) -> None:
    """A sensor's error pattern does not become a pressure of 1638 bar."""
    broken = [
        line[: line.index("#")] + "#FF7FFF7F00000000"
        if " 1A4#" in line and number % 2
        else line
        for number, line in enumerate(lines)
    ]
    path = write(tmp_path / "broken.log", broken)

    odd = replayed(path, forecast=False)

    bad = sum(a != b for a, b in zip(lines, broken, strict=True))
    assert bad > 1000
    assert odd.refused["out_of_range"] == 2 * bad
    good = plain.results.columns["FL.disc_c"]
    apart = np.abs(odd.results.columns["FL.disc_c"] - good)
    assert good.max() > 200.0
    assert apart.max() < 3.0


def test_a_value_that_is_no_number_is_no_sample(
    lines: list[str], tmp_path: Path
) -> None:
    """A float signal with NaN and infinity in it, through a log."""
    dbc = DBC.read_text(encoding="utf-8")
    old = ' SG_ PressurePrimary : 0|16@1- (0.05,0) [-5|250] "bar" BSTM\n'
    new = ' SG_ PressurePrimary : 0|32@1- (1,0) [-5|250] "bar" BSTM\n'
    start = dbc.index(" SG_ PressureSecondary")
    dbc = dbc[:start] + dbc[dbc.index("\n", start) + 1 :]
    assert old in dbc
    (tmp_path / "float.dbc").write_text(
        dbc.replace(old, new) + "\nSIG_VALTYPE_ 420 PressurePrimary : 1;\n",
        encoding="utf-8",
    )
    text = CAR.read_text(encoding="utf-8")
    start = text.index("[signals.secondary_pressure]")
    text = text[:start] + text[text.index("[signals.accel", start) :]
    car = tmp_path / "float.toml"
    car.write_text(text.replace("../dbc/example_vehicle.dbc", "float.dbc"))
    numbers = [b"\0\0\xc0\x7f", b"\0\0\x80\x7f", b"\0\0\x80\x3f"]
    odd = [
        line[: line.index("#") + 1] + (numbers[n % 3] + bytes(4)).hex().upper()
        if " 1A4#" in line
        else line
        for n, line in enumerate(lines)
    ]

    result = replayed(write(tmp_path / "float.log", odd), car, forecast=False)

    total = sum(" 1A4#" in line for line in lines)
    refused = result.refused
    assert refused["not_a_number"] > total // 6
    assert refused["out_of_range"] > total // 6
    assert refused["not_a_number"] + refused["out_of_range"] < total
    pressure = result.results.columns["FL.pressure_pa"]
    assert pressure.max() == pytest.approx(1e5)
    assert np.isfinite(pressure).all()


def test_junk_is_counted_and_changes_nothing(
    lines: list[str], plain: Replay, tmp_path: Path
) -> None:
    """Garbage, comments and blank lines between the frames."""
    junk = ["(17000", "# remark", "", "(1.0) can0 1A4#ZZ", "\x7f\x01 \t"]
    mixed = [
        item
        for number, line in enumerate(lines)
        for item in (
            [line, junk[number // 100 % 5]] if number % 100 == 0 else [line]
        )
    ]

    result = replayed(write(tmp_path / "junk.log", mixed))

    assert same(result.results, plain.results)
    assert result.lines == len(mixed)
    refused = result.refused
    added = len(mixed) - len(lines)
    assert refused["malformed"] + refused["not_a_frame"] == added
    assert refused["malformed"] >= 3 * (added // 5)


def test_truncated_gzip_gives_what_is_there(
    log: Path, plain: Replay, tmp_path: Path
) -> None:
    """The recorder lost power: the rest is used, and it is said."""
    whole = tmp_path / "whole.log.gz"
    whole.write_bytes(gzip.compress(log.read_bytes()))
    cut = tmp_path / "cut.log.gz"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])

    complete, part = replayed(whole), replayed(cut)

    assert same(complete.results, plain.results)
    assert not complete.truncated
    assert part.truncated
    rows = len(part.results)
    assert 100 < rows < len(plain.results) - 100
    disc = plain.results.columns["FL.disc_c"]
    assert np.array_equal(part.results.columns["FL.disc_c"], disc[:rows])


def test_truncated_last_line(log: Path, plain: Replay, tmp_path: Path) -> None:
    """Half a frame at the end is refused and counted."""
    cut = tmp_path / "cut.log"
    cut.write_bytes(log.read_bytes()[:-9])

    result = replayed(cut)

    assert sum(result.refused.values()) == 1
    assert len(result.results) == pytest.approx(len(plain.results), abs=1)


def test_logs_that_can_not_be_used(tmp_path: Path) -> None:
    """Missing, empty, too short."""
    config, signal_map = load_vehicle(CAR)
    with pytest.raises(FileAccessError, match=r"none\.log"):
        replay_log(config, signal_map, tmp_path / "none.log")
    (tmp_path / "empty.log").touch()
    with pytest.raises(LogError, match="empty"):
        replay_log(config, signal_map, tmp_path / "empty.log")
    brief = write(tmp_path / "brief.log", ["(1.02) can0 1B0#0000000000000000"])
    with pytest.raises(LogError, match="too short"):
        replay_log(config, signal_map, brief)


# what a configuration changes


def car_with(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    """Write the example car with *changes* and *text* at its end."""
    source = CAR.read_text(encoding="utf-8")
    changes = (("../dbc/example_vehicle.dbc", DBC.as_posix()), *changes)
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    path = folder / "car.toml"
    path.write_text(f"{source}\n{text}", encoding="utf-8")
    return path


def test_wet_disc_cools_the_corner_it_is_given_for(
    log: Path, plain: Replay, tmp_path: Path
) -> None:
    """One entry, one corner: all others keep every bit."""
    car = car_with(tmp_path, '[[effect]]\nname = "wet_disc"\ncorner = "FL"\n')

    wet = replayed(log, car).results.columns
    dry = plain.results.columns

    assert wet["FL.disc_c"].max() < dry["FL.disc_c"].max() - 2.0
    assert np.all(wet["FL.disc_c"] <= dry["FL.disc_c"] + 1e-9)
    assert wet.keys() == dry.keys()
    for name, column in dry.items():
        # the car's risk is one of all corners
        if not name.startswith("FL.") and name != "risk":
            assert np.array_equal(wet[name], column, equal_nan=True), name


def test_wet_disc_does_nothing_in_the_dry(tmp_path: Path) -> None:
    """Without rain the entry changes nothing at all."""
    log = tmp_path / "dry.log"
    drive = DRIVE.replace("rain = 0.6", "rain = 0.0")
    write_candump(log, simulate(parse_drive(drive, "dry")), ENCODER)
    car = car_with(tmp_path, '[[effect]]\nname = "wet_disc"\n')

    wet, dry = (
        replayed(log, path, forecast=False).results for path in (car, CAR)
    )

    for name, column in dry.columns.items():
        assert np.allclose(
            wet.columns[name], column, rtol=0, atol=1e-9, equal_nan=True
        )


def test_an_effect_with_a_memory_gets_a_column(
    log: Path, plain: Replay, tmp_path: Path
) -> None:
    """Pyrolysis from 250 degC on: it cools the pad and only progresses."""
    car = car_with(
        tmp_path,
        '[[effect]]\nname = "pad_pyrolysis"\n'
        "parameters = {onset_c = 250.0, rate_per_s = 0.1, heat_j = 2e4}\n",
    )

    result = replayed(log, car, forecast=False).results.columns

    assert result["FL.pyrolysis"][-1] > 0.01
    assert np.all(np.diff(result["FL.pyrolysis"]) >= 0.0)
    assert (
        result["FL.pad_front_c"].max()
        < plain.results.columns["FL.pad_front_c"].max() - 0.1
    )
    assert "FL.pyrolysis" not in plain.results.columns


def two_node_disc(net: Network, spec: CornerSpec) -> Network:
    """The shipped disc, with a hat of a third of its capacity behind it."""
    from bstm_daemon.model.thermal.brake_corner import lumped_disc  # noqa: PLC0415
    from bstm_daemon.model.thermal.network import Link, Node  # noqa: PLC0415

    return (
        lumped_disc(net, spec)
        .with_node(Node("hat", 0.3 * spec.disc_mass_kg * 500.0))
        .with_link(Link("disc-hat", "disc", "hat", 15.0))
    )


def test_a_part_of_ones_own(
    log: Path,
    plain: Replay,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """``module:function`` replaces the disc; its nodes become columns."""
    source = Path(__file__).read_text(encoding="utf-8")
    start = source.index("def two_node_disc")
    end = source.index("def test_a_part_of_ones_own")
    code = source[start:end].replace(": Network, spec: CornerSpec", ", spec")
    (tmp_path / "own_brakes_for_test.py").write_text(
        code.replace(" -> Network", ""), encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    # the first [corner.disc] is FL's
    car = car_with(
        tmp_path,
        "",
        ('model = "lumped"', 'model = "own_brakes_for_test:two_node_disc"'),
    )

    own = replayed(log, car, forecast=False).results.columns
    dry = plain.results.columns

    assert own["FL.disc_c"].max() < dry["FL.disc_c"].max() - 5.0
    assert 12.0 < own["FL.hat_c"][-1] < own["FL.disc_c"][-1]
    assert "FR.hat_c" not in own
    assert np.array_equal(own["FR.disc_c"], dry["FR.disc_c"])


def test_parts_and_effects_that_do_not_exist(tmp_path: Path) -> None:
    """Configuration errors; an effect with the nearest name."""
    car = car_with(tmp_path, '[[effect]]\nname = "wet_disk"\n')
    with pytest.raises(ConfigError, match="did you mean 'wet_disc'"):
        load_vehicle(car)
    car = car_with(
        tmp_path, "", ('model = "lumped"', 'model = "nowhere:disc"')
    )
    config, signal_map = load_vehicle(car)
    with pytest.raises(ConfigError, match=r"FL disc\.model.*nowhere"):
        Estimator(config, present_roles(signal_map))


def test_odd_values_in_every_signal_never_break_the_estimate(
    lines: list[str], tmp_path: Path
) -> None:
    """Random payloads: nothing raises, no temperature leaves reason."""
    chance = np.random.default_rng(7)
    noisy = [
        line[: line.index("#") + 1] + chance.bytes(8).hex().upper()
        if number % 7 == 0
        else line
        for number, line in enumerate(lines)
    ]

    result: Any = replayed(write(tmp_path / "noise.log", noisy))

    for name, column in result.results.columns.items():
        if name.endswith("_c") and not LATER.search(name):
            assert np.isfinite(column).all(), name
            assert column.min() > -60.0, name
