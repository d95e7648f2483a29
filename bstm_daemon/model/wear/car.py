"""Wear of all linings and discs of a car.

Events come with the samples and count from the publication that follows them;
the networks are built anew on whole minutes of the data's time, where a lining
or disc has become noticeably thinner. Both depend on the data alone, not on
how it is cut.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite, nan
from typing import Any, Final, NamedTuple

from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.estimate import WearEstimate, WearLevel
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import Program
from bstm_daemon.model.thermal.regrid import follow_wear, heat_above_j
from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.model.wear.law import WearLaw
from bstm_daemon.model.wear.pads import ROLES, Change, PadWear
from bstm_daemon.roles import ROLE_INDEX

REFIT_US: Final = 60_000_000
"""Interval at which worn networks are rebuilt."""

REFIT_M: Final = 5.0e-5
"""Least wear for a rebuilt network: half a percent of a new lining, well below
the resolution of a switch."""

THINNEST_M: Final = 5.0e-4
LEAST_MASS: Final = 0.8
"""Least lining thickness, and least share of a disc's mass, in the model. The
discard thickness of discs is about a tenth below that of new ones; a disc that
seems to have lost twice as much was replaced, or its rate is wrong."""

KNOWN_DISTANCE_M: Final = 50_000.0
"""Least distance on the pads before a remaining distance is reported."""

CONFIRMED: Final = 2
"""Consecutive equal samples that confirm a switch."""

MOST_EVENTS: Final = 64
"""Most events kept for later; more come from a wrong clock."""

Laws = tuple[tuple[int, "WearLaw"], ...]
"""Wear laws, each with the publication of a block from which it applies."""


class _Event(NamedTuple):
    stamp_us: int
    role: str
    on: bool
    seen: bool


class Refit(NamedTuple):
    """A network to be built: the worn corner, and the kind of change."""

    corner: CornerConfig
    change: Change


class CarWear:
    """The wear of every disc corner of one car."""

    def __init__(self, config: Config, present: Iterable[int]) -> None:
        """Begin with the configured thicknesses.

        Args:
            config: the vehicle.
            present: numbers of the roles that are mapped.
        """
        self._config = config
        self._corners: dict[str, CornerConfig] = {
            corner.name: corner for corner in config.disc_corners()
        }
        self.pads: dict[str, PadWear] = {
            name: PadWear(config, corner)
            for name, corner in self._corners.items()
        }
        mapped = set(present)
        self._switches = {
            ROLE_INDEX[role]: role
            for role in ROLES
            if ROLE_INDEX[role] in mapped
        }
        self._levels: dict[str, bool | None] = dict.fromkeys(ROLES)
        self._noted: dict[str, bool | None] = dict.fromkeys(ROLES)
        self._raw: dict[str, tuple[bool, int]] = {}
        self._events: list[_Event] = []
        self._built: dict[str, tuple[float, float]] = {
            name: (pad.configured.thickness_m, pad.configured.disc_worn_m)
            for name, pad in self.pads.items()
        }
        self.worn_heat_j = dict.fromkeys(self.pads, 0.0)
        """Heat above ambient that left with worn mass or came with new [J]."""

    def note(self, times_us: Any, roles: Any, values: Any) -> None:
        """Take the samples of the switches, [n] each.

        Two samples in a row make a level: one alone is no event.
        """
        for number, role in self._switches.items():
            for i in _places(roles, number):
                self._level(role, int(times_us[i]), on=bool(values[i] > 0.5))

    def laws(
        self,
        times_us: Sequence[int],
        totals: Callable[[str, int], tuple[float, float]],
    ) -> dict[str, Laws]:
        """Apply the events before the last publication of a block.

        One counts from the next publication on: those at its own time may
        be gone, however the stream is cut.

        Args:
            times_us: the publications [us], rising.
            totals: gives dose [J] and distance [m] of a corner at a
                publication.

        Returns:
            Per corner the laws and from which publication on they hold.
        """
        if not times_us:
            return {}
        found: dict[str, Laws] = {
            name: ((0, pad.law),) for name, pad in self.pads.items()
        }
        due = [e for e in self._events if e.stamp_us < times_us[-1]]
        if due:
            self._events = [e for e in self._events if e not in due]
        # they were noted switch by switch
        for event in sorted(due, key=lambda event: event.stamp_us):
            at = next(i for i, t in enumerate(times_us) if t > event.stamp_us)
            self._levels[event.role] = event.on
            for name in self._watched():
                dose_j, distance_m = totals(name, at)
                self._apply(self.pads[name], event, dose_j, distance_m)
                found[name] = (*found[name], (at, self.pads[name].law))
        return found

    def refit(self, name: str, dose_j: float) -> Refit | None:
        """Return what the network of *name* should be built for, if anew."""
        if not self._config.wear.model_follows:
            return None
        pad = self.pads[name]
        now = (
            max(pad.law.thickness_at_m(dose_j), THINNEST_M),
            pad.law.disc_loss_at_m(dose_j),
        )
        moved = max(
            abs(a - b) for a, b in zip(now, self._built[name], strict=True)
        )
        # a nan dose gives no wear
        if not moved >= REFIT_M:
            return None
        change, pad.change = pad.change, Change.WORN
        self._built[name] = now
        return Refit(self.built_corner(name), change)

    def built_corner(self, name: str) -> CornerConfig:
        """Return the corner that the network of *name* stands for."""
        corner = self._corners[name]
        pad, disc = corner.pad, corner.disc
        if pad is None or disc is None:
            raise KeyError(name)
        thickness_m, loss_m = self._built[name]
        further_m = loss_m - self.pads[name].configured.disc_worn_m
        lost_kg = 0.5 * further_m * disc.swept_area_m2 * disc.density_kg_m3
        mass_kg = max(disc.mass_kg - lost_kg, LEAST_MASS * disc.mass_kg)
        return corner.model_copy(
            update={
                "pad": pad.model_copy(update={"thickness_m": thickness_m}),
                "disc": disc.model_copy(update={"mass_kg": mass_kg}),
            }
        )

    def estimate(
        self, name: str, law: WearLaw, dose_j: float, distance_m: float
    ) -> WearEstimate:
        """Return the state of *name* by *law*.

        The remaining distance is that to ``[wear] limit_m``, if the pads are
        used as they were since they are on this car.
        """
        limit_m = self._config.wear.limit_m
        thickness_m, std_m = law.thickness_at_m(dose_j), law.std_at_m(dose_j)
        pad = self.pads[name]
        driven_m = distance_m - pad.begin_distance_m
        worn_m = law.rate_m_j * (dose_j - pad.begin_dose_j)
        left_m = nan
        if driven_m >= KNOWN_DISTANCE_M and worn_m > 0.0:
            left_m = max(thickness_m - limit_m, 0.0) * driven_m / worn_m
        if thickness_m <= limit_m:
            level = WearLevel.WORN
        elif thickness_m - 2.0 * std_m <= limit_m:
            level = WearLevel.CHECK
        else:
            level = WearLevel.OK
        return WearEstimate(
            thickness_m,
            std_m,
            law.disc_loss_at_m(dose_j),
            left_m,
            law.source,
            level,
        )

    def export(self) -> dict[str, Any]:
        """Return everything that a restart needs, as plain values."""
        return {
            "levels": dict(self._levels),
            "corners": {
                name: pad.export()
                | {
                    "built": list(self._built[name]),
                    "worn_heat_j": self.worn_heat_j[name],
                }
                for name, pad in self.pads.items()
            },
        }

    def restored(
        self, saved: Mapping[str, Any], doses_j: Mapping[str, float]
    ) -> CarWear:
        """Return a copy of this, with what was *saved* of it.

        *doses_j* are those of the saved corners now; a corner without one
        begins anew.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind.
        """
        fresh = CarWear(self._config, self._switches)
        for role in ROLES:
            level = saved["levels"][role]
            fresh._levels[role] = level if level is None else bool(level)
        fresh._noted = dict(fresh._levels)
        for name, pad in fresh.pads.items():
            if name not in saved["corners"] or name not in doses_j:
                continue
            corner = saved["corners"][name]
            pad.restore(corner, doses_j[name])
            thickness_m, loss_m = map(float, corner["built"])
            if self._config.wear.model_follows:
                fresh._built[name] = max(thickness_m, THINNEST_M), loss_m
            fresh.worn_heat_j[name] = float(corner["worn_heat_j"])
        return fresh

    def _level(self, role: str, stamp_us: int, *, on: bool) -> None:
        level, count = self._raw.get(role, (on, 0))
        count = min(count + 1, CONFIRMED) if level == on else 1
        self._raw[role] = on, count
        before = self._noted[role]
        if count < CONFIRMED or on == before:
            return
        self._noted[role] = on
        self._events.append(_Event(stamp_us, role, on, before is not None))
        del self._events[:-MOST_EVENTS]

    def _watched(self) -> list[str]:
        """Corners that the switches watch."""
        axle = self._config.wear.indicators
        if axle == "all":
            return list(self.pads)
        return [name for name in self.pads if name[0] == axle[0].upper()]

    def _apply(
        self, pad: PadWear, event: _Event, dose_j: float, distance_m: float
    ) -> None:
        if event.on:
            pad.happened(event.role, dose_j, distance_m, seen=event.seen)
        # an indicator that is off bounds the lining from below
        for role, level in self._levels.items():
            if level is False:
                pad.off(role, dose_j)


def _places(roles: Any, number: int) -> Iterable[int]:
    """Return where *number* stands in *roles*, an array of any kind."""
    if hasattr(roles, "nonzero"):
        return (roles == number).nonzero()[0].tolist()  # type: ignore[no-any-return]
    return [i for i, role in enumerate(roles) if role == number]


def exchange(
    batch: Batch, member: int, program: Program, change: Change, air_k: float
) -> float:
    """Replace the network of *member* of *batch* by *program*, after *change*.

    Worn material leaves with its heat; new linings are at air temperature; a
    corrected estimate of wear moves no heat. NaN temperatures stay NaN: such
    an estimate is invalid and will be reset.

    Returns:
        The heat above *air_k* [K] that left the corner [J].
    """
    old = batch.programs[member].network
    first = member * batch.width
    last = first + len(old.nodes)
    before = batch.state[first:last]
    batch.replace(member, program)
    if change is Change.CORRECTED or not isfinite(sum(before)):
        return 0.0
    if change is Change.FITTED:
        after = [
            air_k if node.name.startswith("pad_") else kelvin
            for node, kelvin in zip(old.nodes, before, strict=True)
        ]
    else:
        after = follow_wear(old, program.network, before)
    batch.state[first:last] = array("d", after)
    return heat_above_j(old, before, air_k) - heat_above_j(
        program.network, after, air_k
    )


def keep_totals(
    fresh: array[float], names: Sequence[str], state: Sequence[float]
) -> None:
    """Put the doses of *state* into *fresh*, a start of the same *names*.

    The dose is kept even if temperatures are unknown.
    """
    for key in (DOSE, DISTANCE):
        at = names.index(key)
        if state[at] >= 0.0:  # nan is not
            fresh[at] = state[at]
