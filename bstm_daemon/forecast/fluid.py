"""The car's fluid as configured, and what the bus reports of it."""

from __future__ import annotations

from datetime import date, timedelta
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.estimator.memory import Flag, Number, Saved
from bstm_daemon.model.risk.vaporisation import Fluid, boiling
from bstm_daemon.model.risk.water import water_measured, water_of_age
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.config.estimates import FluidConfig
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.risk.water import Water

CHANGED_ROLE: Final = ROLE_INDEX["fluid_changed"]
WATER_ROLE: Final = ROLE_INDEX["fluid_water_percent"]

_DAY: Final = timedelta(days=1)
_YEAR_DAYS: Final = 365.25
_EPOCH: Final = date(1970, 1, 1)
_FIRST_DAY: Final = date(2000, 1, 1)
"""Data time before this is not a date: a log that begins at 0."""


class SavedFluid(Saved):
    """Reports of the bus about the fluid, in a saved state."""

    changed: date | None = None
    percent: Number | None = None
    measured: date | None = None
    flag: Flag = False


class FluidKnowledge:
    """Knowledge of the fluid at a time of the data; recomputed daily."""

    def __init__(self, config: FluidConfig) -> None:
        """Begin with what is configured."""
        self._config = config
        self._fluid = Fluid(
            config.grade,
            _kelvin(config.dry_boiling_point_c),
            _kelvin(config.wet_boiling_point_c),
        )
        self._changed = config.changed
        self._percent = config.water_percent
        self._measured = config.water_measured
        self._flag = False
        self._day: date | None = None
        self._boiling: Boiling | None = None
        self.water: Water = self._water(None)

    def ingest(self, time_us: int, role: int, value: float) -> None:
        """Take a sample of one of the fluid's roles."""
        day = _day(time_us)
        if role == CHANGED_ROLE:
            rises = value > 0.5 and not self._flag
            self._flag = value > 0.5
            if rises and day is not None and day != self._changed:
                self._changed, self._percent, self._measured = day, None, None
                self._boiling = None
        elif role == WATER_ROLE and isfinite(value):
            percent = 100.0 * value
            if percent != self._percent or day != self._measured:
                self._percent, self._measured = percent, day
                self._boiling = None

    def boiling(self, time_us: int) -> Boiling:
        """Return the distribution of the boiling point at *time_us*."""
        day = _day(time_us)
        if self._boiling is None or day != self._day:
            self._day = day
            self.water = self._water(day)
            self._boiling = boiling(self._fluid, self.water)
        return self._boiling

    def export(self) -> dict[str, Any]:
        """Return what the bus reported, for the state file."""
        saved = SavedFluid(
            changed=self._changed,
            percent=self._percent,
            measured=self._measured,
            flag=self._flag,
        )
        return saved.model_dump(mode="json")

    def resume(self, saved: SavedFluid) -> None:
        """Take back what :meth:`export` gave.

        If the configuration has a later fluid change than the state, it is
        new from the workshop: the configuration applies.
        """
        changed, own = saved.changed, self._config.changed
        if own is not None and (changed is None or changed < own):
            return
        self._changed = changed
        newer = saved.measured is not None and (
            self._measured is None or saved.measured >= self._measured
        )
        if saved.percent is not None and newer:
            self._percent, self._measured = saved.percent, saved.measured
        elif changed != own:
            self._percent, self._measured = None, None
        self._flag = saved.flag
        self._boiling = None

    def _water(self, day: date | None) -> Water:
        climate = self._config.climate
        if self._percent is not None:
            since = _years(self._measured, day) or 0.0
            accuracy = self._config.water_accuracy
            return water_measured(self._percent, accuracy, climate, since)
        return water_of_age(_years(self._changed, day), climate)


def _years(since: date | None, day: date | None) -> float | None:
    if since is None or day is None or day < since:
        return None
    return (day - since) / _DAY / _YEAR_DAYS


def _day(time_us: int) -> date | None:
    try:
        day = _EPOCH + timedelta(days=time_us // 86_400_000_000)
    except OverflowError:
        return None
    return day if day >= _FIRST_DAY else None


def _kelvin(celsius: float | None) -> float | None:
    return None if celsius is None else celsius + KELVIN_OFFSET
