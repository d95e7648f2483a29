"""The duty of a corner: fading means, with values."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from math import exp
from typing import TYPE_CHECKING, Any, cast

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.blocks import friction_energies
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.march import DUTY_MEMORY_S, Conditions, Duty

if TYPE_CHECKING:
    from bstm_daemon.estimator.blocks import Instant
    from bstm_daemon.model.thermal.program import Program

AIR_K = 283.15
SLOW, FAST = (10.0, 5e5, 1.0), (30.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def program() -> Program:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    return compile_corner(config, config.corner[0])


@dataclass
class Moment:
    """A publication as the duty sees it; it has one corner, FL."""

    time_us: int
    channels: dict[str, float]
    energies: array[float]

    def channel(self, corner: str, channel: str) -> float:
        assert corner == "FL"
        return self.channels[channel]

    def output(self, corner: str) -> array[float]:
        assert corner == "FL"
        return self.energies


class Drive:
    """Publications one after the other."""

    def __init__(self, program: Program) -> None:
        self.duty = Duty(program)
        self._sources = friction_energies(program)
        self._size = len(program.state_names) + len(program.network.sources)
        self._energy_j = 7e6
        self._time_us = 0

    def go(
        self,
        seconds: float,
        motion: tuple[float, float, float],
        power_w: float = 0.0,
        step_s: float = 1.0,
    ) -> Drive:
        """Drive for *seconds* at speed, pressure, brake on and power."""
        names = ("speed_ms", "pressure_pa", "brake_on")
        for _ in range(round(seconds / step_s)):
            self._time_us += round(1e6 * step_s)
            self._energy_j += power_w * step_s
            energies = array("d", [0.0] * self._size)
            for place in self._sources:
                energies[place] = self._energy_j / len(self._sources)
            moment: Any = Moment(
                self._time_us,
                dict(zip(names, motion, strict=True)),
                energies,
            )
            self.duty.add(cast("Instant", moment), "FL")
        return self

    def away(self, seconds: float, energy_j: float) -> Drive:
        """Let time pass, and heat, of which the duty sees nothing."""
        self._time_us += round(1e6 * seconds)
        self._energy_j += energy_j
        return self


def test_a_duty_that_lasts_is_what_it_is(program: Program) -> None:
    """From the second publication on, however little there was of it."""
    for seconds in (2, 30, 600):
        found = Drive(program).go(seconds, SLOW, 4e3).duty.conditions(AIR_K)
        assert found == pytest.approx(Conditions(AIR_K, *SLOW, 4e3))


def test_what_is_longer_ago_counts_less(program: Program) -> None:
    """Two minutes each: the first counts exp(-1) of the second."""
    assert DUTY_MEMORY_S == 120.0
    drive = Drive(program).go(121, SLOW, 4e3).go(120, FAST, 1e3)

    old = exp(-1.0) / (1.0 + exp(-1.0))
    assert drive.duty.conditions(AIR_K) == pytest.approx(
        Conditions(
            AIR_K,
            speed_ms=30.0 - 20.0 * old,
            pressure_pa=5e5 * old,
            brake_on=old,
            power_w=1e3 + 3e3 * old,
        )
    )


def test_publications_count_by_their_time(program: Program) -> None:
    """Ten a second weigh as much as one."""
    dense = Drive(program).go(121, SLOW, 4e3).go(60, FAST, step_s=0.1)
    sparse = Drive(program).go(121, SLOW, 4e3).go(60, FAST)

    assert dense.duty.conditions(AIR_K) == pytest.approx(
        sparse.duty.conditions(AIR_K)
    )


def test_without_publications_there_is_no_duty(program: Program) -> None:
    """One alone has no power yet."""
    for seconds in (0, 1):
        drive = Drive(program).go(seconds, SLOW, 4e3)
        assert drive.duty.conditions(AIR_K) == Conditions(AIR_K)


def test_heat_is_never_given_back(program: Program) -> None:
    """An energy that was set anew is no power."""
    drive = Drive(program).go(2, SLOW, 4e3).away(0.0, -5e6).go(1, SLOW)

    power_w = drive.duty.conditions(AIR_K).power_w
    assert power_w == pytest.approx(
        4e3 * exp(-1 / 120) / (1.0 + exp(-1 / 120))
    )


def test_a_restart_forgets_all(program: Program) -> None:
    """Neither what was before a hole nor the heat within counts."""
    drive = Drive(program).go(300, SLOW, 4e3)
    drive.duty.restart()
    assert drive.duty.conditions(AIR_K) == Conditions(AIR_K)

    drive.away(3600.0, 9e6).go(2, FAST, 1e3)
    assert drive.duty.conditions(AIR_K) == pytest.approx(
        Conditions(AIR_K, *FAST, 1e3)
    )
