"""What was found against the heat is remembered as long as it matters."""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.estimator.trust import (
    LEAST_J,
    LEAST_S,
    MEMORY,
    MOST_RATIO,
    Trust,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

STEP_S = 0.1
SETTLING_S = 3000.0


def trust_of(*, has_switch: bool = False) -> Trust:
    return Trust(
        ("FL", "RL"), SETTLING_S, compares=True, has_switch=has_switch
    )


class Course:
    """Publications of a car with two corners."""

    def __init__(self) -> None:
        self.flags: list[int] = []
        self.vehicle = array("d")
        self.rows = array("d")
        self._pressed_j = 0.0

    def go(
        self,
        seconds: float,
        speed_ms: float = 20.0,
        flags: int = 0,
        *,
        pressed_w: float = 0.0,
        heat_w: float = 0.0,
        std_w: float = 0.0,
    ) -> Course:
        """Go on; the powers are those of each corner."""
        for _ in range(round(seconds / STEP_S)):
            self._pressed_j += pressed_w * STEP_S
            self.flags.append(flags)
            vehicle = dict.fromkeys(VEHICLE_CHANNELS, 0.0)
            vehicle["speed_ms"] = speed_ms
            self.vehicle.extend(vehicle.values())
            row = dict.fromkeys(CHANNELS, 0.0)
            row |= {
                "brake_power_w": heat_w,
                "brake_power_std_w": std_w,
                "brake_energy_ff_j": self._pressed_j,
            }
            for _ in range(2):
                self.rows.extend(row.values())
        return self

    def block(self) -> Any:
        layout = SimpleNamespace(corners=("FL", "RL"))
        return SimpleNamespace(
            flags=self.flags,
            vehicle=self.vehicle,
            rows=self.rows,
            layout=layout,
        )

    def found(self, trust: Trust) -> list[bool]:
        return trust.findings(self.block(), STEP_S)


def held(trust: Trust, found: Sequence[bool]) -> list[bool]:
    return [trust.holds("FL", STEP_S, found=one) for one in found]


def test_a_finding_counts_thirty_times_as_long() -> None:
    trust = trust_of()
    held(trust, [True] * 200)  # 20 s

    after = held(trust, [False] * 7000)

    assert sum(after) * STEP_S == pytest.approx(MEMORY * 20.0, abs=0.2)
    assert after.index(False) == sum(after)
    # the other corner had nothing
    assert not trust.holds("RL", STEP_S, found=False)


def test_a_few_seconds_leave_nothing() -> None:
    trust = trust_of()
    assert all(held(trust, [True] * round(LEAST_S / STEP_S)))
    assert not any(held(trust, [False] * 10))


def test_known_time_pays_back_a_thirtieth() -> None:
    """4 s, two minutes without and 2 s more: 2 s in total."""
    trust = trust_of()
    held(trust, [True] * 40)
    held(trust, [False] * 1200)
    held(trust, [True] * 20)
    assert not any(held(trust, [False] * 10))


def test_nothing_is_remembered_for_longer_than_by_the_slowest_node() -> None:
    trust = trust_of()
    held(trust, [True] * 2000)  # 200 s would be 6000 s
    after = held(trust, [False] * 31_000)
    assert sum(after) * STEP_S == pytest.approx(SETTLING_S, abs=0.2)


def test_parking_is_time_that_passes() -> None:
    trust = trust_of()
    held(trust, [True] * 200)
    trust.park(500.0)
    assert sum(held(trust, [False] * 2000)) * STEP_S == pytest.approx(
        100.0, abs=0.2
    )


def test_what_was_found_is_paid_back_parked_as_it_is_driving() -> None:
    """20 s found, of which five minutes pay back ten."""
    trust = trust_of()
    held(trust, [True] * 200)
    trust.park(10.0 * MEMORY)
    held(trust, [True] * 20)
    after = held(trust, [False] * 7000)
    assert sum(after) * STEP_S == pytest.approx(MEMORY * 12.0, abs=0.2)


def test_it_goes_on_after_a_restart() -> None:
    first, second = trust_of(), trust_of()
    held(first, [True] * 200)
    second.restore(first.export())
    assert held(second, [False] * 7000) == held(first, [False] * 7000)


def test_a_corner_that_a_file_does_not_know_was_not_found() -> None:
    first, second = trust_of(), trust_of()
    held(first, [True] * 200)
    saved = first.export()
    for memory in saved.values():
        if isinstance(memory, dict):
            memory.pop("RL")
    second.restore(saved)
    assert second.holds("FL", STEP_S, found=False)
    assert not second.holds("RL", STEP_S, found=False)


def test_a_bad_memory_is_refused() -> None:
    trust = trust_of()
    for key, value in (
        ("_found_s", {"FL": "long"}),
        ("_held_s", [1.0]),
        ("_work", [1.0]),
    ):
        saved = trust.export() | {key: value}
        with pytest.raises(ValueError, match="validation error"):
            trust.restore(saved)
    with pytest.raises(KeyError):
        trust.restore({})


def test_a_hole_counts_against_every_corner() -> None:
    trust = trust_of()
    trust.count(LEAST_S)
    assert not any(held(trust, [False] * 10))
    trust.count(15.0)
    for corner in ("FL", "RL"):
        after = [trust.holds(corner, STEP_S, found=False) for _ in range(7000)]
        assert sum(after) * STEP_S == pytest.approx(MEMORY * 20.0, abs=2.0)


def test_a_long_hole_is_forgotten_like_the_heat() -> None:
    """Once it is over a finding of a moment degrades nothing again."""
    trust = trust_of()
    trust.count(1e5)
    after = held(trust, [False] * 31_000)
    assert sum(after) * STEP_S == pytest.approx(SETTLING_S, abs=0.2)
    assert held(trust, [True, False]) == [True, False]


@pytest.mark.parametrize(
    ("pressed", "found"),
    [(0.0, True), (0.5, True), (0.7, False), (1.0, False), (1.3, False),
     (1.7, False), (1.8, True)],
)  # fmt: skip
def test_work_by_pressure_and_heat(pressed: float, *, found: bool) -> None:
    """Compared over 1 MJ."""
    power_w = 20e3
    course = Course().go(50.0, pressed_w=pressed * power_w, heat_w=power_w)
    assert course.found(trust_of())[-1] is found


def test_little_work_is_not_compared() -> None:
    """Of two corners: 0.28 MJ are too little, 0.35 MJ are enough."""
    trust = trust_of()
    seconds = 0.95 * LEAST_J / 40e3
    assert not any(Course().go(seconds, heat_w=20e3).found(trust))
    more = Course().go(0.25 * LEAST_J / 40e3, heat_w=20e3)
    assert more.found(trust)[-1]


def test_old_work_is_forgotten() -> None:
    """3 MJ of agreement follow one of none."""
    course = Course().go(25.0, heat_w=20e3)
    course.go(75.0, pressed_w=20e3, heat_w=20e3)
    found = course.found(trust_of())
    assert found[249]
    assert not found[-1]


def test_without_a_pressure_there_is_no_work_by_it() -> None:
    missing = FLAGS["pressure_missing"]
    course = Course().go(50.0, flags=missing, heat_w=20e3)
    assert not any(course.found(trust_of()))


def test_an_assistant_brakes_without_the_pedal() -> None:
    """With a switch that says so; without one it is not known."""
    unpressed = FLAGS["braking_unpressed"]
    course = Course().go(50.0, flags=unpressed, heat_w=20e3)
    assert not any(course.found(trust_of(has_switch=True)))
    assert course.found(trust_of())[-1]


@pytest.mark.parametrize(
    ("pressed_w", "std_w", "differs"),
    [
        (11e3, 0.0, True),
        (11e3, 2e3, False),  # 0.55 is not below 0.6 of 18 kW
        (10.7e3, 2e3, True),
        (11.5e3, 1.1e3, False),
        (11.5e3, 0.9e3, True),  # the car is known
        (36e3, 0.0, True),
        (36e3, 9e3, True),  # what is too little is not excused
    ],
)
def test_heat_within_its_deviation_is_no_contradiction(
    pressed_w: float,
    std_w: float,
    differs: bool,  # noqa: FBT001
) -> None:
    course = Course().go(50.0, pressed_w=pressed_w, heat_w=20e3, std_w=std_w)
    trust = trust_of()
    assert course.found(trust)[-1] is differs

    again = trust_of()
    flags = FLAGS["braking_unpressed"]  # heat that no pressure shows
    course = Course().go(50.0, flags=flags, heat_w=20e3, std_w=15e3)
    assert course.found(again)[-1]

    again.restore(trust.export())
    assert again.export() == trust.export()
    old = {k: v for k, v in trust.export().items() if k != "_doubt_j"}
    again.restore(old)
    assert again.export()["_doubt_j"] == 0.0


def test_limits_are_those_of_linings() -> None:
    """Faded linings press for 1/0.6 of the work that heats."""
    assert 1.0 / 0.6 < MOST_RATIO < 2.0


def test_a_long_stand_leaves_nothing() -> None:
    """Neither a debt of time nor a credit."""
    trust = trust_of()
    trust.count(20.0)
    trust.park(1e6)
    saved = trust.export()
    for key in ("_held_s", "_found_s"):
        assert saved[key] == {"FL": 0.0, "RL": 0.0}
