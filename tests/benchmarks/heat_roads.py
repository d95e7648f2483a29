"""Roads and drivers for the population of heat inputs, drawn at random.

A drive is made of pieces of at most some seconds, so that gears change with
the speed, grades change no faster than real roads do, and the wind comes from
where it comes whichever way the road turns.
"""

from __future__ import annotations

from math import cos, pi
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.simulation.drives import Drive

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

PIECE_S: Final = 3.0
SHIFT_KMH: Final = (18.0, 35.0, 55.0, 75.0, 100.0)
"""Up to these speeds gears 1 to 5; beyond, 6."""

CREST_M: Final = 1000.0
"""Radius over which a road's grade changes; 400 m is the least in passes."""

STEEPEST_PERCENT: Final = 12.0
HELD_BAR: Final = 8.0
LEARNING_S: Final = (900.0, 720.0, 720.0)
"""Length of the three learning drives: 15, 12 and 12 minutes."""


class Road:
    """A drive as it grows: speed, gear, grade and heading now."""

    def __init__(
        self, rng: np.random.Generator, wind_ms: float, steep_percent: float
    ) -> None:
        """Begin at rest; grades are drawn within *steep_percent*."""
        self.rng = rng
        self.steep = steep_percent
        self.mean = 0.0
        self.elapsed_s = 0.0
        self._wind_ms = wind_ms
        self._speed = self._grade = self._aim = 0.0
        self._heading = float(rng.uniform(0, 2 * pi))
        self._pieces: list[dict[str, Any]] = []
        self.stand(5.0)

    def drive(self, name: str) -> Drive:
        """Return what was driven; the car comes to rest and is left."""
        self.slow(0.0, 1.5)
        self.stand(5.0)
        head = {"name": name, "description": name, "ambient_c": 15.0}
        return Drive.model_validate({"drive": head, "segment": self._pieces})

    def draw(self, low: float, high: float) -> float:
        """Return a number between *low* and *high*."""
        return float(self.rng.uniform(low, high))

    def turn(self, share: float = 1.0) -> None:
        """Take another road: other heading, other grade."""
        self._heading = self.draw(0, 2 * pi)
        aim = self.mean + share * self.steep * self.draw(-1, 1)
        self._aim = min(max(aim, -STEEPEST_PERCENT), STEEPEST_PERCENT)

    def grade(self, percent: float) -> None:
        """Lead the road towards this grade."""
        self._aim = percent

    def pull(self, speed_kmh: float, rate_ms2: float) -> None:
        """Gain speed through the gears."""
        while self._speed < speed_kmh - 1e-9:
            step = min(rate_ms2 * PIECE_S * 3.6, speed_kmh - self._speed)
            self._piece(self._speed + step, step / 3.6 / rate_ms2, rate_ms2)

    def slow(self, speed_kmh: float, rate_ms2: float) -> None:
        """Lose speed; the gear follows it down."""
        while self._speed > speed_kmh + 1e-9:
            step = min(rate_ms2 * PIECE_S * 3.6, self._speed - speed_kmh)
            self._piece(self._speed - step, step / 3.6 / rate_ms2, rate_ms2)

    def hold(self, seconds: float, **more: float) -> None:
        """Keep the speed."""
        left = seconds
        while left > 0.0:
            part = min(left, PIECE_S)
            self._piece(self._speed, part, 1.0, duration_s=part, **more)
            left -= part

    def stand(self, seconds: float) -> None:
        """Stand with the brake held."""
        self._pieces.append(
            {
                "parked": True,
                "duration_s": seconds,
                "brake_pressure_bar": HELD_BAR,
                "grade_percent": self._grade,
                "headwind_ms": self._headwind(),
            }
        )
        self.elapsed_s += seconds

    def _piece(
        self, speed_kmh: float, seconds: float, rate_ms2: float, **more: float
    ) -> None:
        v = 0.5 * (self._speed + speed_kmh) / 3.6
        most = 100.0 * v * seconds / CREST_M
        self._grade += min(max(self._aim - self._grade, -most), most)
        middle = 0.5 * (self._speed + speed_kmh)
        gear = 1 + sum(middle > limit for limit in SHIFT_KMH)
        self._pieces.append(
            {
                "speed_kmh": speed_kmh,
                "rate_ms2": rate_ms2,
                "gear": gear,
                "grade_percent": self._grade,
                "headwind_ms": self._headwind(),
            }
            | more
        )
        self._speed = speed_kmh
        self.elapsed_s += seconds

    def _headwind(self) -> float:
        return self._wind_ms * cos(self._heading)


def town(road: Road, until_s: float) -> None:
    """Streets of 30 to 60 km/h, lights and turnings."""
    while road.elapsed_s < until_s:
        road.turn(0.5)
        road.pull(road.draw(30, 60), road.draw(0.8, 2.0))
        road.hold(road.draw(4, 35))
        if road.rng.random() < 0.6:
            road.slow(0.0, road.draw(1.0, 2.5))
            road.stand(road.draw(3, 18))
        else:
            road.slow(road.draw(12, 25), road.draw(1.0, 2.5))
            road.hold(4.0, bend_radius_m=float(road.rng.choice((-1, 1))) * 14)


def country(road: Road, until_s: float) -> None:
    """Roads of 60 to 100 km/h with bends, out and home again."""
    mean, from_s = road.mean, road.elapsed_s
    while road.elapsed_s < until_s:
        home = road.elapsed_s - from_s > 0.5 * (until_s - from_s)
        road.mean = -mean if home else mean
        road.turn(0.6)
        road.pull(road.draw(60, 100), road.draw(0.6, 1.5))
        road.hold(road.draw(8, 40))
        road.slow(road.draw(30, 55), road.draw(1.0, 3.0))
        side = float(road.rng.choice((-1, 1)))
        road.hold(road.draw(3, 6), bend_radius_m=side * road.draw(60, 200))
    road.mean = mean


def motorway(road: Road, until_s: float) -> None:
    """100 to 130 km/h, braked now and then."""
    while road.elapsed_s < until_s:
        road.turn(0.3)
        road.pull(road.draw(100, 130), road.draw(0.4, 1.0))
        road.hold(road.draw(15, 60))
        road.slow(road.draw(70, 95), road.draw(1.0, 2.5))
        road.hold(road.draw(3, 15))


def learning(road: Road, number: int) -> None:
    """Drive one of three ordinary drives: town, country, mixed."""
    whole = LEARNING_S[number]
    for share, kind in (
        ((0.6, town), (1.0, country)),
        ((1.0, country),),
        ((0.3, town), (0.7, motorway), (1.0, country)),
    )[number]:
        kind(road, share * whole)
        road.slow(0.0, road.draw(1.0, 2.0))
        road.stand(road.draw(3, 10))


def descent(road: Road) -> None:
    """A pass road down: long straights, hairpins; about 9 minutes."""
    steep = -(0.5 * STEEPEST_PERCENT + 0.5 * road.steep)
    road.grade(0.0)
    road.pull(40.0, 1.0)
    for _ in range(9):
        road.turn()
        road.grade(steep)
        road.hold(road.draw(20, 35))
        road.grade(steep - 0.7)
        road.slow(road.draw(24, 30), 1.2)
        road.grade(0.6 * steep)
        road.hold(6.0, bend_radius_m=14.0)
        road.grade(steep)
        road.pull(road.draw(36, 48), 0.7)


def hard_stops(road: Road) -> None:
    """Eight full stops from 100 km/h, about 7 minutes."""
    for _ in range(8):
        road.turn(0.2)
        road.pull(100.0, road.draw(2.0, 2.8))
        road.hold(road.draw(5, 15))
        road.slow(0.0, road.draw(5.0, 8.5))
        road.stand(road.draw(3, 12))


def city(road: Road) -> None:
    """Ten minutes of streets, flatter than those of learning."""
    road.steep = min(road.steep, 6.0)
    town(road, 600.0)


TESTS: Final[dict[str, Callable[[Road], None]]] = {
    "descent": descent,
    "hard stops": hard_stops,
    "city": city,
}
"""The drives that heat is judged on."""
