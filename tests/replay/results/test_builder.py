"""Rows of estimates: their columns, what they mean, how they are cut."""

from __future__ import annotations

from array import array
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.replay.results import Collector, Results, ResultsBuilder
from bstm_daemon.replay.results.builder import LEARNED
from bstm_daemon.replay.results.rows import (
    ADVICE_COLUMNS,
    CAR_COLUMNS,
    CORNER_COLUMNS,
    STRETCH_ROWS,
)
from bstm_daemon.roles import CORNERS
from tests.replayed import replay_log

if TYPE_CHECKING:
    from bstm_daemon.estimator.blocks import Block
    from bstm_daemon.replay.results import Sink

ROOT = Path(__file__).parents[3]
CAR = ROOT / "config" / "example_vehicle.toml"

QUANTITIES = (
    "disc_c",
    "pad_front_c",
    *(f"pad_{i}_c" for i in range(1, 11)),
    "pad_back_c",
    "backplate_c",
    "fluid_c",
    "wear_dose_j",
    "margin_k",
    "brake_power_w",
    "pad_thickness_m",
    "pad_thickness_std_m",
    "disc_loss_m",
    "validity",
    "reasons",
    *CORNER_COLUMNS,
    "brake_power_std_w",
    "brake_power_ff_w",
    "brake_power_fb_w",
    "pressure_pa",
)
MEASURED = ("disc", "disc_2", "pad_front", "pad_back", "fluid", "caliper")


def test_columns(results: Results) -> None:
    """Names and order; measured ones only where something was measured."""
    expected = ["time_s", "speed_ms", "distance_m", "brake_force_fb_n"]
    expected += [
        "flags",
        *LEARNED,
        *CAR_COLUMNS,
        "forecast_age_s",
        *ADVICE_COLUMNS,
    ]
    for corner in CORNERS:
        expected += [f"{corner}.{quantity}" for quantity in QUANTITIES]
        if corner[0] == "F":
            expected += [f"{corner}.{node}_measured_c" for node in MEASURED]

    assert list(results.columns) == expected
    assert results.corners == results.modelled == CORNERS
    assert {len(column) for column in results.columns.values()} == {
        len(results)
    }


def test_units_and_meaning(results: Results) -> None:
    """Degrees Celsius, metres, watts, and the margin to 155 degC of DOT 4."""
    columns = results.columns

    assert columns["speed_ms"].max() == pytest.approx(100 / 3.6, rel=0.01)
    travelled = columns["speed_ms"].sum() * 0.1
    assert columns["distance_m"][-1] == pytest.approx(travelled, rel=0.01)
    assert columns["FL.disc_c"][0] == pytest.approx(10.0, abs=0.5)
    assert 30.0 < columns["FL.disc_c"].max() < 100.0
    np.testing.assert_allclose(
        columns["FL.margin_k"], 155.0 - columns["FL.fluid_c"], atol=1e-9
    )
    # 5 m/s2 less the resistances of a car of 2.2 t, at 100 km/h
    power = [columns[f"{corner}.brake_power_w"] for corner in CORNERS]
    assert np.sum(power, axis=0).max() == pytest.approx(
        2300 * 5 * 27, rel=0.15
    )
    assert set(columns["FL.validity"].tolist()) == {1.0}


@pytest.mark.parametrize("every_us", [200_000, 1_000_000, 5_000_000])
def test_fewer_rows_keep_the_energy(
    log: Path, results: Results, every_us: int
) -> None:
    """Temperatures are those of the moment, power is the mean since."""
    config, signal_map = load_vehicle(CAR)
    fewer = replay_log(
        config, signal_map, log, every_us=every_us
    ).results.columns
    full = results.columns
    every_s = every_us * 1e-6

    assert np.allclose(np.diff(fewer["time_s"]), every_s)
    rows = np.searchsorted(full["time_s"], fewer["time_s"] - 1e-3)
    for name in ("FL.disc_c", "RR.fluid_c", "distance_m", "FL.margin_k"):
        assert np.array_equal(fewer[name], full[name][rows])
    first_s, last_s = fewer["time_s"][0] - every_s, fewer["time_s"][-1]
    inside = (full["time_s"] > first_s + 1e-3) & (
        full["time_s"] < last_s + 1e-3
    )
    for name in ("FL.brake_power_w", "RR.brake_power_ff_w"):
        energy_j = fewer[name].sum() * every_s
        assert energy_j == pytest.approx(full[name][inside].sum() * 0.1)
        assert energy_j > 5e4


def test_brake_power_is_the_heat_that_went_in(log: Path) -> None:
    """By pressure or by motion, as the mode says; both are always there."""
    config, signal_map = load_vehicle(CAR)
    for mode in ("ff", "fb"):
        heat = config.heat.model_copy(update={"mode": mode})
        car = config.model_copy(update={"heat": heat})
        columns = replay_log(car, signal_map, log).results.columns
        np.testing.assert_allclose(
            columns["FL.brake_power_w"],
            columns[f"FL.brake_power_{mode}_w"],
            rtol=1e-6,
            atol=1e-3,
        )
        assert columns["FL.brake_power_ff_w"].max() > 1e4
        assert columns["FL.brake_power_fb_w"].max() > 1e4


def test_a_drum_has_power_and_no_temperature(
    log: Path, tmp_path: Path
) -> None:
    """Its columns say what is known of it."""
    dbc = (ROOT / "dbc" / "example_vehicle.dbc").as_posix()
    text = CAR.read_text(encoding="utf-8")
    text = text.replace("../dbc/example_vehicle.dbc", dbc)
    start = text.index('[[corner]]\nname = "RR"')
    end = text.index("# Tunable parameters")
    drum = (
        '[[corner]]\nname = "RR"\ntype = "drum"\n'
        "piston_area_m2 = 3e-4\neffective_radius_m = 0.11\n"
        "drum_brake_factor = 2.5\n"
    )
    car = tmp_path / "drum.toml"
    car.write_text(text[:start] + drum + text[end:], encoding="utf-8")

    results = replay_log(*load_vehicle(car), log).results

    assert results.corners == CORNERS
    assert results.modelled == ("FL", "FR", "RL")
    names = {n for n in results.columns if n.startswith("RR.")}
    assert names == {
        "RR.brake_power_w",
        "RR.brake_power_std_w",
        "RR.brake_power_ff_w",
        "RR.brake_power_fb_w",
        "RR.pressure_pa",
    }
    assert results.columns["RR.brake_power_w"].max() > 1e3


@pytest.fixture(scope="module")
def blocks(log: Path) -> tuple[Estimator, list[Block]]:
    """Return the blocks of the drive, six times one behind the other."""
    config, signal_map = load_vehicle(CAR)
    estimator = Estimator(config, present_roles(signal_map))
    found: list[Block] = []
    for lap in range(6):
        for events in EventLog(log, signal_map).events():
            time_us = events.time_us + lap * 40_000_000
            found += estimator.advance(time_us, events.role, events.value)
    return estimator, found


def _in_pieces(block: Block, rows: int) -> list[Block]:
    """Return *block* cut into blocks of *rows* publications."""
    count = len(block.times_us)

    def part(flat: Any, first: int) -> Any:
        width = len(flat) // count
        return flat[first * width : (first + rows) * width]

    return [
        replace(
            block,
            times_us=part(block.times_us, first),
            rows=part(block.rows, first),
            vehicle=part(block.vehicle, first),
            outputs=tuple(part(output, first) for output in block.outputs),
            flags=part(block.flags, first),
            validity={n: part(v, first) for n, v in block.validity.items()},
            reasons={n: part(v, first) for n, v in block.reasons.items()},
            disagrees=part(block.disagrees, first),
        )
        for first in range(0, count, rows)
    ]


class Lengths:
    """A sink that keeps how many rows came at a time."""

    def __init__(self) -> None:
        """Begin without rows."""
        self.rows: list[int] = []

    def write(self, rows: Results) -> None:
        """Take *rows*."""
        self.rows.append(len(rows))


@pytest.mark.slow
@pytest.mark.parametrize("every_us", [100_000, 300_000])
@pytest.mark.parametrize("rows", [1, 100, 5000])
def test_how_blocks_are_cut_does_not_matter(
    blocks: tuple[Estimator, list[Block]], rows: int, every_us: int
) -> None:
    """The same rows to the bit, in the same stretches."""
    estimator, found = blocks
    whole, pieces, lengths = Collector(), Collector(), Lengths()
    cuts: list[tuple[list[Sink], list[Block]]] = [
        ([whole], found),
        ([pieces, lengths], [p for b in found for p in _in_pieces(b, rows)]),
    ]
    for sinks, cut in cuts:
        builder = ResultsBuilder(estimator, sinks, every_us)
        for block in cut:
            builder.add([block])
        builder.finish()

    one, other = whole.results(), pieces.results()
    assert len(one) == builder.rows == sum(lengths.rows)
    assert set(lengths.rows[:-1]) <= {STRETCH_ROWS}
    assert len(lengths.rows) == -(-len(one) // STRETCH_ROWS)
    for name, column in one.columns.items():
        assert np.array_equal(column, other.columns[name], equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize("every_us", [300_000, 1_000_000])
@pytest.mark.parametrize("rows", [1, 7, 5000])
def test_a_row_has_the_flags_of_those_dropped_before_it(
    blocks: tuple[Estimator, list[Block]], rows: int, every_us: int
) -> None:
    """Each publication's bit is in the next row that is kept, there only."""
    estimator, found = blocks
    marked = [replace(block, flags=array("q", block.flags)) for block in found]
    times = np.concatenate([block.times_us for block in marked])
    chance = np.random.default_rng(7)
    bits = 1 << chance.integers(0, 40, len(times))
    start = 0
    for block in marked:
        count = len(block.flags)
        block.flags[:] = array("q", bits[start : start + count].tolist())
        start += count

    collected = Collector()
    builder = ResultsBuilder(estimator, [collected], every_us)
    for block in marked:
        builder.add(_in_pieces(block, rows))
    builder.finish()

    flags = collected.results().columns["flags"].astype(np.int64)
    kept = np.flatnonzero(times % every_us == 0)
    expected = np.bitwise_or.reduceat(
        bits[: kept[-1] + 1], np.r_[0, kept[:-1] + 1]
    )
    # a part of the first is left out of the rows, if it was kept at all
    assert len(flags) in {len(kept), len(kept) - 1}
    assert flags.tolist() == expected[len(kept) - len(flags) :].tolist()


def test_a_publication_that_stays_alone_is_a_row(
    blocks: tuple[Estimator, list[Block]],
) -> None:
    """The first is left out only where another comes."""
    estimator, found = blocks
    first, second, *_ = _in_pieces(found[0], 1)
    counts = []
    for cut in ([first], [first, second], []):
        rows = Collector()
        builder = ResultsBuilder(estimator, [rows])
        builder.add(cut)
        builder.finish()
        counts.append(builder.rows)
        if cut:
            time_s = rows.results().columns["time_s"]
            assert time_s.tolist() == [cut[-1].times_us[0] * 1e-6]

    assert counts == [1, 1, 0]


def test_a_thermocouple_that_is_mapped_has_a_column(
    log: Path, tmp_path: Path
) -> None:
    """Also one that is silent: the first rows do not know of the rest."""
    silent = tmp_path / "silent.log"
    lines = log.read_text(encoding="ascii").splitlines(keepends=True)
    kept = [line for line in lines if " 6A" not in line]
    assert len(kept) < len(lines)
    silent.write_text("".join(kept), encoding="ascii")

    columns = replay_log(*load_vehicle(CAR), silent).results.columns

    for node in MEASURED:
        assert np.isnan(columns[f"FR.{node}_measured_c"]).all()
    assert "RL.disc_measured_c" not in columns
