"""Linings of one corner: wear law from events, and the learned rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from enum import Enum, auto
from math import inf, isfinite
from typing import Any, Final

from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.estimate import WearSource
from bstm_daemon.model.wear.dose import disc_rate_m_j, pad_rate_m_j
from bstm_daemon.model.wear.law import (
    WearLaw,
    between_indicators_rate_m_j,
    first_millimetre_rate_m_j,
)

ROLES: Final = ("pads_new", "pad_worn_1mm", "pad_2mm_left")
"""The switches of section 4.6, by role."""

RATE_BOUND: Final = 10.0
"""Largest factor between learned and expected rate; beyond it the switch does
not belong to these pads."""

NEW_WITHIN_M: Final = 1.0e-4
"""A configured thickness this close to that of new pads means new pads."""


class Change(Enum):
    """Why a lining differs from the one its network was built for."""

    WORN = auto()
    CORRECTED = auto()
    """The estimate was corrected; the lining itself did not change."""
    FITTED = auto()
    """New linings were fitted."""


@dataclass(frozen=True, slots=True)
class Configured:
    """Configured values of a corner's linings and disc; SI."""

    thickness_m: float
    new_thickness_m: float
    measured: str | None
    disc_worn_m: float
    pad_rate_m_j: float
    disc_rate_m_j: float

    @classmethod
    def of_corner(cls, config: Config, corner: CornerConfig) -> Configured:
        """Gather it for *corner*, a disc corner."""
        pad, disc = corner.pad, corner.disc
        if pad is None or disc is None:
            msg = f"corner {corner.name}: no pads"
            raise ValueError(msg)
        new_m = pad.new_thickness_m
        return cls(
            pad.thickness_m,
            pad.thickness_m if new_m is None else new_m,
            None if pad.measured is None else pad.measured.isoformat(),
            disc.worn_m,
            pad_rate_m_j(config, corner),
            disc_rate_m_j(config, corner),
        )

    @property
    def entry(self) -> list[Any]:
        """A value entered by a person; a change of it is a new measurement."""
        return [self.thickness_m, self.measured, self.disc_worn_m]


class PadWear:
    """One corner: its law now, the doses of its events, the learned rate."""

    def __init__(self, config: Config, corner: CornerConfig) -> None:
        """Begin with the configured thickness at dose 0."""
        self._wear = config.wear
        self.configured = Configured.of_corner(config, corner)
        self.learned_rate_m_j: float | None = None
        """The rate of the previous set, or of this one."""
        self.new_dose_j: float | None = None
        self.first_dose_j: float | None = None
        self.law = self._configured_law(0.0, self.configured.disc_worn_m)
        self.begin_dose_j = 0.0
        self.begin_distance_m = 0.0
        """Start of the driving from which the remaining distance follows."""
        self.change = Change.WORN
        """The last change that the network has not followed yet."""

    def happened(
        self, role: str, dose_j: float, distance_m: float, *, seen: bool
    ) -> None:
        """Take the event of *role* at *dose_j*.

        Args:
            role: one of :data:`ROLES`.
            dose_j: the corner's dose then [J].
            distance_m: the distance driven then [m].
            seen: whether the switch was seen to change; one that is on from
                the first moment gives an upper bound of the lining, not the
                time when it was reached.
        """
        if role == "pads_new":
            if seen:
                self._fitted(dose_j, distance_m)
            return
        at_m = self._indicator_m(role)
        if self.law.highest_m <= at_m:
            # a loose contact: these linings have passed it already
            return
        law = self.law.moved_to(dose_j)
        self.change = Change.CORRECTED
        if not seen:
            self.law = replace(
                law,
                thickness_m=min(law.thickness_m, at_m),
                highest_m=min(law.highest_m, at_m),
                lowest_m=0.0 if role == "pad_2mm_left" else law.lowest_m,
            )
            return
        law = replace(
            law,
            thickness_m=at_m,
            thickness_std_m=self._wear.indicator_std_m,
            highest_m=at_m,
            lowest_m=0.0,
        )
        rate = self._learned(role, dose_j)
        if rate is not None:
            self.learned_rate_m_j = rate
            law = replace(
                law,
                rate_m_j=rate,
                rate_spread=self._wear.learned_spread,
                source=WearSource.FIRST_INDICATOR
                if role == "pad_worn_1mm"
                else WearSource.SECOND_INDICATOR,
            )
        if role == "pad_worn_1mm":
            self.first_dose_j = dose_j
        self.law = law

    def off(self, role: str, dose_j: float) -> None:
        """Take the indicator of *role* as present and off.

        The lining is thicker than where it would come on.
        """
        if role == "pads_new":
            return
        at_m = self._indicator_m(role)
        law = self.law.moved_to(dose_j)
        # a configured thickness below it contradicts the indicator
        if law.highest_m > at_m and law.thickness_m >= at_m:
            self.law = replace(law, lowest_m=max(law.lowest_m, at_m))

    def configure(self, entry: list[Any], dose_j: float) -> None:
        """Take the configured thickness if it differs from *entry*.

        A thickness that is the same as when the state was saved was known
        then; a new one is a measurement made now.
        """
        if entry != self.configured.entry:
            self.change = Change.CORRECTED
            self.new_dose_j = self.first_dose_j = None
            disc_m = self.law.disc_loss_at_m(dose_j)
            if entry[2:] != [self.configured.disc_worn_m]:
                disc_m = self.configured.disc_worn_m
            self.law = self._configured_law(dose_j, disc_m)

    def export(self) -> dict[str, Any]:
        """Return everything as plain values."""
        law = asdict(self.law)
        law["source"] = int(self.law.source)
        if law["highest_m"] == inf:
            law["highest_m"] = None
        return {
            "law": law,
            "entry": self.configured.entry,
            "learned_rate_m_j": self.learned_rate_m_j,
            "new_dose_j": self.new_dose_j,
            "first_dose_j": self.first_dose_j,
            "begin_dose_j": self.begin_dose_j,
            "begin_distance_m": self.begin_distance_m,
            "change": self.change.name,
        }

    def restore(self, saved: Mapping[str, Any], dose_j: float) -> None:
        """Take over what :meth:`export` gave; *dose_j* is the dose now.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind; the
                object may be half restored.
        """
        law = dict(saved["law"])
        law["source"] = WearSource(law["source"])
        if law["source"] is WearSource.NOT_AVAILABLE:
            msg = "a saved lining rests on nothing"
            raise ValueError(msg)
        if law["highest_m"] is None:
            law["highest_m"] = inf
        for name, number in law.items():
            unlimited = name == "highest_m" and number == inf
            if not (unlimited or isfinite(number)):
                msg = f"{name} = {number}: not a number"
                raise ValueError(msg)
        self.law = WearLaw(**law)
        self.learned_rate_m_j = _optional(saved["learned_rate_m_j"])
        self.new_dose_j = _optional(saved["new_dose_j"])
        self.first_dose_j = _optional(saved["first_dose_j"])
        self.begin_dose_j = float(saved["begin_dose_j"])
        self.begin_distance_m = float(saved["begin_distance_m"])
        self.change = Change[saved["change"]]
        self.configure(list(saved["entry"]), dose_j)

    def _fitted(self, dose_j: float, distance_m: float) -> None:
        """New pads: Eq 4.20 begins here."""
        self.change = Change.FITTED
        disc_m = self.law.disc_loss_at_m(dose_j)
        self.law = replace(
            self._configured_law(dose_j, disc_m),
            source=WearSource.NEW_PADS,
            thickness_m=self.configured.new_thickness_m,
            thickness_std_m=self._wear.indicator_std_m,
        )
        self.new_dose_j, self.first_dose_j = dose_j, None
        self.begin_dose_j, self.begin_distance_m = dose_j, distance_m

    def _indicator_m(self, role: str) -> float:
        """Return the lining [m] at which the indicator of *role* comes on."""
        if role == "pad_2mm_left":
            return self._wear.second_indicator_left_m
        new_m = self.configured.new_thickness_m
        return new_m - self._wear.first_indicator_worn_m

    def _expected(self) -> tuple[float, float]:
        """Return rate and spread of a set without any event yet.

        The thesis assumes that the driver does not change during a pad's
        life; here the next set starts with the rate learned from the last.
        """
        if self.learned_rate_m_j is not None:
            return self.learned_rate_m_j, self._wear.learned_spread
        return self.configured.pad_rate_m_j, self._wear.rate_spread

    def _configured_law(self, dose_j: float, disc_m: float) -> WearLaw:
        configured = self.configured
        new_m = configured.new_thickness_m
        if configured.thickness_m >= new_m - NEW_WITHIN_M:
            self.new_dose_j = dose_j
        rate, spread = self._expected()
        return WearLaw(
            WearSource.CONFIGURED,
            configured.thickness_m,
            dose_j,
            rate,
            self._wear.configured_std_m,
            spread,
            disc_loss_m=disc_m,
            disc_rate_m_j=configured.disc_rate_m_j,
        )

    def _learned(self, role: str, dose_j: float) -> float | None:
        """Return the rate learned from the event, None if there is none."""
        wear = self._wear
        new_m = self.configured.new_thickness_m
        worn_m = wear.first_indicator_worn_m
        left_m = wear.second_indicator_left_m
        try:
            if role == "pad_worn_1mm":
                if self.new_dose_j is None:
                    return None
                rate = first_millimetre_rate_m_j(
                    worn_m, self.new_dose_j, dose_j
                )
            elif self.first_dose_j is not None:
                rate = between_indicators_rate_m_j(
                    new_m, worn_m, left_m, self.first_dose_j, dose_j
                )
            elif self.new_dose_j is not None:
                rate = between_indicators_rate_m_j(
                    new_m, 0.0, left_m, self.new_dose_j, dose_j
                )
            else:
                return None
        except ValueError:
            return None
        expected = self.configured.pad_rate_m_j
        plausible = expected / RATE_BOUND < rate < expected * RATE_BOUND
        return rate if plausible else None


def _optional(value: object) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        msg = f"{value!r}: not a number"
        raise TypeError(msg)
    return float(value)
