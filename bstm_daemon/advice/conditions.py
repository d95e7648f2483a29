"""Inputs of the advice: the brakes' state, the car's motion, the driver.

Plain values, so that the estimator behind them can be exchanged. All SI; NaN
is unknown.
"""

from collections.abc import Mapping, Sequence
from math import inf, isfinite, nan
from types import MappingProxyType
from typing import Final

from bstm_daemon.channels import CORNER_PRESSURE, FLAGS
from bstm_daemon.estimate import CornerEstimate, RiskLevel, Validity
from bstm_daemon.estimator.blocks import Instant

DRIVER_ROLES: Final = (
    "ignition",
    "gear",
    "clutch_open",
    "engine_speed",
    "brake_switch",
    "brake_pedal_travel",
    "acceleration_longitudinal",
    "pitch",
    "abs_active",
    "esc_active",
)
"""Roles that advice reads in addition to the estimate."""

FAR_US: Final = 10_000_000
"""A sample stamped further ahead has a wrong time."""


class HeldRoles:
    """The newest values of :data:`DRIVER_ROLES` at a time of the data."""

    def __init__(
        self, timeouts_us: Mapping[int, int], numbers: Mapping[str, int]
    ) -> None:
        """Hold the roles of *numbers* (name to role number).

        A value counts until it is older than its time-out.
        """
        self.names = {
            number: name
            for name, number in numbers.items()
            if name in DRIVER_ROLES and number in timeouts_us
        }
        """Names of the roles that are held, by number."""
        self._timeouts = {
            name: timeouts_us[number] for number, name in self.names.items()
        }
        self._held: dict[str, tuple[int, float]] = {}
        self.waiting: list[tuple[int, str, float]] = []
        """Time [us], name and value of samples that wait for their time."""

    def note(self, stamp_us: int, role: int, value: float) -> None:
        """Take a sample; it counts from *stamp_us* on."""
        self.waiting.append((stamp_us, self.names[role], value))

    def export(self) -> dict[str, list[float]]:
        """Return stamp [us] and value of each role as plain values."""
        return {name: list(held) for name, held in self._held.items()}

    def restore(self, saved: Mapping[str, Sequence[float]]) -> None:
        """Take over what :meth:`export` gave, on the same axis of time.

        Raises:
            TypeError, ValueError: it is nothing of that kind.
        """
        for name in self.names.values():
            if name in saved:
                stamp_us, value = saved[name]
                self._held[name] = int(stamp_us), float(value)

    def at(self, time_us: int) -> dict[str, float]:
        """Return the values that are fresh at *time_us*, not going back."""
        later = []
        for sample in self.waiting:
            stamp_us, name, value = sample
            if stamp_us <= time_us:
                self._held[name] = stamp_us, value
            elif stamp_us - time_us < FAR_US:
                later.append(sample)
        self.waiting = later
        return {
            name: value
            for name, (stamp_us, value) in self._held.items()
            if 0 <= time_us - stamp_us <= self._timeouts[name]
        }


NONE_KNOWN: Final[Mapping[str, float]] = MappingProxyType({})

POSSIBLE: Final = 0.01
"""Probability of vaporisation above which it counts as possible."""


_DEGRADED: Final = Validity.DEGRADED
_UNKNOWN, _ELEVATED = RiskLevel.UNKNOWN, RiskLevel.ELEVATED
# members of an enumeration are slow to look up, and each publication does


class Conditions:
    """Inputs of the advice at one publication, and what follows from them."""

    __slots__ = (
        *("time_us", "corners", "speed_ms", "brake_power_w", "pressures_pa"),
        *("driver", "level", "is_unsure", "may_boil", "validity"),
        *("margins_k", "least_k"),
    )

    def __init__(
        self,
        time_us: int,
        corners: Mapping[str, CornerEstimate],
        speed_ms: float = nan,
        brake_power_w: float = nan,
        pressures_pa: Mapping[str, float] = NONE_KNOWN,
        driver: Mapping[str, float] = NONE_KNOWN,
    ) -> None:
        """Look at each corner once: every machine asks for the same.

        Args:
            time_us: of the publication [us].
            corners: those with a thermal model.
            speed_ms: of the car.
            brake_power_w: of all brakes.
            pressures_pa: those of all corners, NaN if unknown.
            driver: fresh values of the roles of :data:`DRIVER_ROLES`.
        """
        self.time_us, self.corners = time_us, corners
        self.speed_ms, self.brake_power_w = speed_ms, brake_power_w
        self.pressures_pa, self.driver = pressures_pa, driver
        self.margins_k: dict[str, float] = {}
        """Boiling point less fluid and its deviation of each corner; NaN
        where that is not usable."""
        least_k = inf
        worst = Validity.VALID if corners else Validity.NOT_AVAILABLE
        highest, is_unsure, may_boil = _UNKNOWN, False, False
        for name, corner in corners.items():
            validity, level = corner.validity, corner.sure_level
            worst = max(worst, validity)
            if validity > _DEGRADED:
                self.margins_k[name] = nan
                is_unsure = True
                continue
            margin_k = corner.cautious_margin_k
            self.margins_k[name] = margin_k
            # one that is not known is below nothing
            least_k = min(least_k, margin_k)
            # where only the bound of an unknown start is raised, a car that
            # is cold is no less likely
            if level is _UNKNOWN:
                is_unsure = True
                continue
            if highest is _UNKNOWN or level > highest:
                highest = level
            may_boil = may_boil or (
                level >= _ELEVATED
                or (
                    corner.risk is not None
                    and corner.risk.probability >= POSSIBLE
                )
            )
        self.least_k = least_k
        """The smallest margin of usable corners; infinite if there is none: a
        brake without a thermal model causes no request."""
        self.level = highest
        """The worst level of a usable corner; unknown if there is none."""
        self.is_unsure = is_unsure
        """Whether the level of any corner is unknown."""
        self.may_boil = may_boil
        """Whether vapour is possible at a corner of a level that is sure."""
        self.validity = worst
        """The worst validity of the corners."""

    @property
    def waiting_s(self) -> float:
        """How long until every corner is safe [s]; NaN where one is not known.

        Only corners that ask for waiting count.
        """
        times = [
            corner.waiting_s
            for corner in self.corners.values()
            if corner.is_at_least(RiskLevel.HIGH)
        ]
        if not times or not all(map(isfinite, times)):
            return nan
        return max(times)

    @property
    def highest_pressure_pa(self) -> float:
        """The highest known pressure [Pa]; NaN where none is."""
        known = [p for p in self.pressures_pa.values() if isfinite(p)]
        return max(known, default=nan)

    def is_known(self, axle: str) -> bool:
        """Whether every corner of *axle* "F" or "R" has a known margin.

        One without a thermal model is not known.
        """
        margins = [
            margin_k
            for name, margin_k in self.margins_k.items()
            if name.startswith(axle)
        ]
        return bool(margins) and all(map(isfinite, margins))

    def margin_k(self, axle: str) -> float:
        """Smallest margin of usable corners [K] of an *axle* "F" or "R".

        Infinite if there is none.
        """
        known = [
            margin_k
            for name, margin_k in self.margins_k.items()
            if name.startswith(axle) and margin_k < inf
        ]
        return min(known, default=inf)

    def flag(self, role: str) -> bool | None:
        """Return a switch, None where it is not known."""
        value = self.driver.get(role)
        return None if value is None else value > 0.5


_SPEED_MISSING: Final = FLAGS["speed_missing"]


def conditions_at(
    instant: Instant,
    corners: Mapping[str, CornerEstimate],
    driver: Mapping[str, float],
) -> Conditions:
    """Return the inputs of the advice at one publication.

    Args:
        instant: the publication.
        corners: the corners with a thermal model then.
        driver: fresh values of the driver's roles.
    """
    flags = instant.flags
    # the model takes a missing one as 0; advice must not
    pressures = dict(
        zip(
            instant.block.layout.corners,
            instant.each("pressure_pa"),
            strict=True,
        )
    )
    if flags & ((CORNER_PRESSURE << len(pressures)) - CORNER_PRESSURE):
        for place, name in enumerate(pressures):
            if flags & CORNER_PRESSURE << place:
                pressures[name] = nan
    return Conditions(
        instant.time_us,
        corners,
        nan if flags & _SPEED_MISSING else instant.vehicle("speed_ms"),
        sum(instant.each("brake_power_w")),
        pressures,
        driver,
    )
