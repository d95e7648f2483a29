"""Two real cars: what the recordings show, and what they must not show.

Subaru WRX STI: 90 s from a car park to 130 km/h, braked only while creeping.
Toyota RAV4: a minute under adaptive cruise control, which brakes without the
pedal: a pressure from the pedal sees nothing of it. Bit 0x80 in byte 3 of its
frame 0x224 tells when the brakes were on; no role is mapped to that bit.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.bus.opening import EventLog, open_log
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.roles import CORNERS, ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS
from tests.replayed import Replay, replay_log

if TYPE_CHECKING:
    import numpy.typing as npt

    Series = npt.NDArray[np.float64]

ROOT = Path(__file__).parents[2]
REAL = os.environ.get("BSTM_REAL_DATA")
SUBARU = ROOT / "config" / "subaru_wrx_sti.toml"
TOYOTA = ROOT / "config" / "toyota_rav4.toml"
SUBARU_LOG = Path(str(REAL)) / "subaru-wrx-sti-candump" / "can_sample.log"
TOYOTA_LOG = (
    Path(str(REAL))
    / "toyota-rav4-comma2k19"
    / "rav4_bus0_bus1.converted.candump.log"
)
FIRST_BUS_ONLY = {"can1": ""}

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]


@pytest.fixture(scope="module")
def subaru() -> Replay:
    """Return the replay of the Subaru."""
    return replay_log(*load_vehicle(SUBARU), SUBARU_LOG)


@pytest.fixture(scope="module")
def toyota() -> Replay:
    """Return the replay of the Toyota's first bus."""
    return replay_log(*load_vehicle(TOYOTA), TOYOTA_LOG, FIRST_BUS_ONLY)


def power_w(replay: Replay, way: str = "brake_power_w") -> Series:
    """Return the brake power of all four corners."""
    columns = replay.results.columns
    total: Series = np.sum([columns[f"{c}.{way}"] for c in CORNERS], axis=0)
    return total


def braked_spans() -> list[tuple[float, float]]:
    """Return (on, off) stamps [s] of the Toyota's own brake bit."""
    stamps, bits = [], []
    for line in TOYOTA_LOG.read_text(encoding="ascii").splitlines():
        stamp, interface, frame = line.split()[:3]
        if interface == "can0" and frame.startswith("224#"):
            stamps.append(float(stamp.strip("()")))
            bits.append(bool(bytes.fromhex(frame[4:])[3] & 0x80))
    edges = np.flatnonzero(np.diff(bits)) + 1
    times = [stamps[i] for i in edges] + [stamps[-1]] * (len(edges) % 2)
    return list(zip(times[::2], times[1::2], strict=True))


# Subaru


def test_subaru_counts(subaru: Replay) -> None:
    """Every frame of the recording is accounted for."""
    assert subaru.lines == 82_558
    assert subaru.frames + subaru.refused["unknown_id"] == 82_558
    assert set(subaru.refused) == {"unknown_id"}
    assert subaru.counts == {"late": 0, "dropped": 0, "jumps": 0}
    time_s = subaru.results.columns["time_s"]
    assert len(time_s) == pytest.approx(903, abs=2)
    assert np.allclose(np.diff(time_s), 0.1)


def test_subaru_brakes_only_while_creeping(subaru: Replay) -> None:
    """One stop from walking pace; none of the pull to 130 km/h is heat."""
    speed_ms = subaru.results.columns["speed_ms"]
    power = power_w(subaru)
    energy_j = power.sum() * 0.1

    assert speed_ms.max() == pytest.approx(36.0, abs=0.2)
    assert np.all(power[speed_ms > 2.0] == 0.0)
    assert np.count_nonzero(speed_ms > 5.0) > 600
    # 1/2 m v2 of 1.64 t at 1.4 to 2.5 m/s, the pace of a walk
    assert 0.5 * 1640 * 1.3**2 < energy_j < 0.5 * 1640 * 2.5**2
    for corner in CORNERS:
        discs = subaru.results.columns[f"{corner}.disc_c"]
        assert np.abs(discs - 20.0).max() < 0.5


def test_subaru_by_motion_brakes_no_more_than_by_pressure(
    subaru: Replay,
) -> None:
    """Feed-Back, with the pressure to tell when, adds no heat at speed.

    It is unknown unless the torque is, or is declared.
    """
    speed_ms = subaru.results.columns["speed_ms"]
    assert np.isnan(power_w(subaru, "brake_power_fb_w")).all()
    config, signal_map = load_vehicle(SUBARU)
    declared = {"assume_powertrain_torque_nm": 0.0}
    heat = config.heat.model_copy(update=declared)
    config = config.model_copy(update={"heat": heat})
    coasting = replay_log(config, signal_map, SUBARU_LOG)
    power = power_w(coasting, "brake_power_fb_w")

    assert power[speed_ms > 2.0].sum() * 0.1 < 1.0
    assert power.sum() * 0.1 < 0.5 * 1640 * 2.5**2


@pytest.mark.parametrize(
    ("car", "log", "overrides"),
    [(SUBARU, SUBARU_LOG, {}), (TOYOTA, TOYOTA_LOG, FIRST_BUS_ONLY)],
    ids=["subaru", "toyota"],
)
def test_every_signal_is_what_cantools_says(
    car: Path, log: Path, overrides: dict[str, str]
) -> None:
    """Each sample of each role, in order, against cantools and the units."""
    config, signal_map = load_vehicle(car)
    bus = config.bus[0]
    database = cantools.database.load_file(
        car.parent / bus.dbc, strict=bus.strict, encoding=bus.encoding
    )
    assert isinstance(database, Database)
    found: dict[int, list[tuple[int, float]]] = {}
    for events in EventLog(log, signal_map, overrides).events():
        for at_us, role, value in zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        ):
            found.setdefault(role, []).append((at_us, value))

    expected = _by_cantools(load_config(car), database, log)

    assert {ROLES[role].name for role in found} == set(expected)
    for name, rows in expected.items():
        ours = found[ROLE_INDEX[name]]
        assert [at for at, _ in ours] == [at for at, _ in rows], name
        np.testing.assert_allclose(
            [value for _, value in ours],
            [value for _, value in rows],
            rtol=1e-12,
            atol=1e-12,
            err_msg=name,
        )


def _by_cantools(
    config: Any, database: Database, log: Path
) -> dict[str, list[tuple[int, float]]]:
    """Return (stamp, SI value) of each role, decoded frame by frame."""
    roles: dict[int, list[tuple[str, Any]]] = {}
    for name, signal in config.signals.items():
        message = database.get_message_by_name(signal.message)
        roles.setdefault(message.frame_id, []).append((name, signal))
    rows: dict[str, list[tuple[int, float]]] = {}
    for line in log.read_text(encoding="ascii").splitlines():
        stamp, interface, frame = line.split()[:3]
        identifier, _, payload = frame.partition("#")
        wanted = roles.get(int(identifier, 16), [])
        if interface != "can0" or not wanted:
            continue
        message = database.get_message_by_frame_id(int(identifier, 16))
        data = bytes.fromhex(payload)
        if len(data) != message.length:
            continue
        values = message.decode(data, decode_choices=False)
        assert isinstance(values, dict)
        whole, micros = stamp.strip("()").split(".")
        at_us = int(whole) * 1_000_000 + int(micros)
        for name, signal in wanted:
            given = float(str(values[signal.signal]))
            shown = signal.sign * (given * signal.scale + signal.offset)
            low = -np.inf if signal.min is None else signal.min
            high = np.inf if signal.max is None else signal.max
            if not low <= shown <= high:
                continue
            unit = UNITS[signal.unit]
            value = shown * unit.factor + unit.offset
            if unit.quantity == "flag" or name == "clutch_open":
                value = float(value != 0)
            rows.setdefault(name, []).append((at_us, value))
    return rows


# Toyota


def test_toyota_needs_a_map_for_its_second_bus(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Frames of an interface that nobody named are never guessed at."""
    assert main(["replay", str(TOYOTA_LOG), "-c", str(TOYOTA)]) == 65
    err = capsys.readouterr().err
    assert "interface can1 (channels: can0)" in err
    assert "--map can1=BUS" in err

    arguments = ["replay", str(TOYOTA_LOG), "-c", str(TOYOTA)]
    assert main([*arguments, "--map", "can1="]) == 0
    assert "unknown interface" not in capsys.readouterr().out


def test_toyota_counts(toyota: Replay) -> None:
    """98 800 frames, 45 000 of them on the bus that is left out."""
    assert toyota.lines == 98_800
    refused = toyota.refused
    assert refused["unknown_interface"] == 45_000
    assert (
        toyota.frames + refused["unknown_id"] + refused["unknown_interface"]
        == 98_800
    )
    frames = sum(len(chunk) for chunk in open_log(TOYOTA_LOG).chunks())
    assert frames == 98_800


def test_toyota_by_pressure_sees_nothing(toyota: Replay) -> None:
    """The driver's pedal is never touched: Feed-Forward has no heat."""
    assert power_w(toyota, "brake_power_ff_w").max() == 0.0


def test_toyota_by_motion_finds_when_it_brakes(toyota: Replay) -> None:
    """The heat lies within the spans that the car's own brake bit marks.

    Four of them, the two hard ones at 29.6 and 56.1 s. Half a second more at
    each end: the derivative's filter and the brakes' own delay.
    """
    time_s = toyota.results.columns["time_s"]
    power = power_w(toyota)
    spans = braked_spans()
    inside = np.zeros(len(time_s), np.bool_)
    for on_s, off_s in spans:
        inside |= (time_s > on_s - 0.5) & (time_s < off_s + 0.5)

    starts = [on_s - 46_408.595 for on_s, _ in spans]
    assert starts == pytest.approx([10.5, 22.1, 29.7, 56.2], abs=0.2)
    assert power[inside].sum() > 0.97 * power.sum()
    assert np.count_nonzero(~inside) > 350


@pytest.mark.parametrize(
    ("number", "least_kj", "most_kj"), [(2, 15.0, 40.0), (3, 55.0, 90.0)]
)
def test_toyota_by_motion_finds_how_hard_it_brakes(
    toyota: Replay, number: int, least_kj: float, most_kj: float
) -> None:
    """The two hard ones: a good part of 1/2 m dv2, never more than it.

    The rest goes into rolling resistance, drag, the engine and the grade.
    """
    columns = toyota.results.columns
    on_s, off_s = braked_spans()[number]
    span = (columns["time_s"] > on_s - 0.5) & (columns["time_s"] < off_s + 0.5)
    speed_ms = columns["speed_ms"][span]
    config = load_config(TOYOTA).vehicle
    mass_kg = (
        config.mass_kg + config.wheel_inertia_kg_m2 / config.wheel_radius_m**2
    )
    lost_j = 0.5 * mass_kg * (speed_ms[0] ** 2 - speed_ms[-1] ** 2)
    energy_j = power_w(toyota)[span].sum() * 0.1

    assert least_kj * 1e3 < energy_j < most_kj * 1e3
    assert 0.2 * lost_j < energy_j < lost_j
    # two seconds of it in the discs: some kelvin, at the front more
    rise = {c: float(np.ptp(columns[f"{c}.disc_c"][span])) for c in CORNERS}
    assert 0.5 < rise["RL"] < rise["FL"] < 20.0
