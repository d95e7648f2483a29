"""The S-function of the discs from cool-downs, thesis section 4.4."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import nan
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify import cool_downs, disc_loss
from bstm_daemon.analysis.identify.cooling_fit import (
    CoolingFit,
    Series,
    fit_cooling,
    rms_k,
)
from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.identify.value import Value
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError

POINTS: Final = 5
"""Measurements the thesis takes from a cool-down; ten pairs."""

FAINT: Final = 0.2
"""A value with a larger relative standard error is not identified."""

WRONG_FORM: Final = 3.0
"""The other form is named if it reduces the residual by this factor."""

NEAR_SHARE: Final = 0.1
NEAR_MS: Final = 1.0
"""A point of the table this near to a speed that was driven is dropped."""

STANDING_BLEND: Final = 0.02
"""Least S at standstill, as a share of the whole loss, to be separable from
the radiation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoolingPoint(Value):
    """S [1/s] at one speed.

    ``ten_pairs`` is the thesis's average over the same cool-downs and
    ``ten_pairs_spread`` the standard deviation of its pairs; both hold
    radiation. At standstill ``value`` is the convection beside the configured
    radiation and ``whole`` all of the loss; elsewhere they are equal.
    """

    speed_ms: float
    whole: float
    whole_error: float
    ten_pairs: float
    ten_pairs_spread: float
    by_corner: dict[str, tuple[float, float]]
    series: tuple[Series, ...]

    @property
    def loss(self) -> tuple[float, float]:
        """The S to configure: all of the loss, and its standard error."""
        if self.speed_ms <= 0.0:
            return self.whole, self.whole_error
        return self.value, self.standard_error

    @property
    def residual_k(self) -> float:
        """Root mean square of measurement less model."""
        return rms_k(self.series)


@dataclass(frozen=True, slots=True)
class AxleCooling:
    """The S-function of an axle's discs.

    ``table`` is to be configured: (speed [m/s], S [1/s], whether measured)
    by rising speed; ``still`` the convection fraction at standstill, None
    where it was not measured.
    """

    axle: str
    disc: disc_loss.DiscLoss
    points: tuple[CoolingPoint, ...]
    table: tuple[tuple[float, float, bool], ...]
    still: float | None
    fit: CoolingFit
    other_residual_k: float


@dataclass(frozen=True, slots=True)
class Cooling:
    """Results from the cool-downs of all logs."""

    axles: tuple[AxleCooling, ...]
    searched: tuple[str, ...]
    remarks: tuple[str, ...]


def identify_cooling(drivings: Sequence[Driving], config: Config) -> Cooling:
    """Find S over speed from the measured discs of *drivings*.

    Raises:
        LogError: no log has a cool-down; says what was searched.
    """
    downs: list[cool_downs.CoolDown] = []
    searched = []
    for driving in drivings:
        found, words = cool_downs.cool_downs(cool_downs.slow_of(driving))
        downs += found
        searched.append(words)
    losses = {
        name: loss
        for name in {down.corner for down in downs}
        if (loss := disc_loss.disc_loss(config, name)) is not None
    }
    downs = [down for down in downs if down.corner in losses]
    if not downs:
        msg = "no cool-down found. " + "; ".join(searched)
        raise LogError(msg)
    axles = [
        _axle(axle, of_axle, losses)
        for letter, axle in cool_downs.AXLES.items()
        if (of_axle := [down for down in downs if down.corner[0] == letter])
    ]
    return Cooling(
        tuple(axles), tuple(searched), _remarks(drivings, axles, downs)
    )


def speed_groups(
    downs: Sequence[cool_downs.CoolDown],
) -> tuple[list[int], list[float]]:
    """Return the group of each of *downs* and each group's mean speed.

    Speeds that differ by no more than those within a cool-down are one group.
    """
    speeds = np.array([0.0 if d.standing else d.mean_speed_ms for d in downs])
    order = np.argsort(speeds, kind="stable")
    groups = np.zeros(len(downs), int)
    number, first = 0, float(speeds[order[0]])
    for place in order.tolist():
        speed = float(speeds[place])
        is_next = speed - first > max(
            cool_downs.SPAN_MS, cool_downs.SPAN_SHARE * speed
        )
        if is_next or (first == 0.0 < speed):
            number, first = number + 1, speed
        groups[place] = number
    means = [
        float(speeds[groups == group].mean()) for group in range(number + 1)
    ]
    return groups.tolist(), means


def _axle(
    axle: str,
    downs: list[cool_downs.CoolDown],
    losses: dict[str, disc_loss.DiscLoss],
) -> AxleCooling:
    groups, speeds = speed_groups(downs)
    discs = [losses[down.corner] for down in downs]
    rate_form = discs[0].rate_form
    fit = fit_cooling(downs, discs, groups, speeds, rate_form=rate_form)
    other = fit_cooling(downs, discs, groups, speeds, rate_form=not rate_form)
    whole = fit
    if speeds[0] < discs[0].blend_end_ms:
        whole = fit_cooling(
            downs, discs, groups, speeds, rate_form=rate_form, beside=False
        )
    points = []
    for group, speed in enumerate(speeds):
        series = tuple(one for one in fit.series if one.group == group)
        pairs = np.array([ten_pairs(one) for one in series])
        value, error = float(fit.s_per_s[group]), fit.standard_error(group)
        all_of_it = float(whole.s_per_s[group])
        configured = float(discs[0].configured(speed))
        if speed <= 0.0:
            configured *= discs[0].still
        points.append(
            CoolingPoint(
                speed_ms=speed,
                value=value,
                standard_error=error,
                configured=configured,
                caveat=_caveat(value, error, all_of_it),
                whole=all_of_it,
                whole_error=whole.standard_error(group),
                ten_pairs=float(np.nanmean(pairs)),
                ten_pairs_spread=float(np.nanstd(pairs)),
                by_corner=fit.by_corner[group],
                series=series,
            )
        )
    still, slowest = None, points[0]
    if slowest.speed_ms <= 0.0 and slowest.identified:
        still = min(slowest.value / slowest.whole, 1.0)
    return AxleCooling(
        axle,
        discs[0],
        tuple(points),
        _table(points, discs[0]),
        still,
        fit,
        other.residual_k,
    )


def ten_pairs(series: Series) -> list[float]:
    """Return the thesis's ten values of S (section 4.4), NaN if none.

    Five measurements evenly spread over the cool-down, Eq 4.12 for each pair.
    """
    above = series.measured_k - series.down.bins(series.down.ambient_k)
    places = np.linspace(0, len(above) - 1, POINTS).round().astype(int)
    found = []
    for a, b in combinations(places.tolist(), 2):
        dt_s = float(series.time_s[b] - series.time_s[a])
        usable = dt_s > 0.0 and above[a] > 0.0 and above[b] > 0.0
        found.append(
            float(np.log(above[a] / above[b])) / dt_s if usable else nan
        )
    return found


def _caveat(value: float, error: float, whole: float) -> str:
    if value < STANDING_BLEND * whole:
        return (
            "the configured radiation alone cools faster: emissivity or free "
            "area too large"
        )
    if error > FAINT * value:
        return f"standard error of {100 * error / value:.0f} %"
    return ""


def _table(
    points: Sequence[CoolingPoint], disc: disc_loss.DiscLoss
) -> tuple[tuple[float, float, bool], ...]:
    """Return the table to configure: driven speeds, the others scaled.

    A configured point that was not driven is scaled as its neighbours, so
    that the table keeps its shape where nothing was measured.
    """
    # at standstill S is the whole loss, of which a fraction is convection
    measured = {
        point.speed_ms: point.loss[0] for point in points if point.identified
    }
    if not measured:
        return ()
    ratios = {
        speed: value / max(float(disc.configured(speed)), 1e-9)
        for speed, value in measured.items()
        # standstill is another regime, which does not show the wind's part
        if speed > 0.0
    }
    rows = [(speed, value, True) for speed, value in measured.items()]
    for speed, value in zip(disc.speeds_ms, disc.s_per_s, strict=True):
        near = max(NEAR_MS, NEAR_SHARE * speed)
        if any(abs(speed - driven) < near for driven in measured):
            continue
        factor = 1.0
        if ratios and speed > 0.0:
            factor = float(np.interp(speed, [*ratios], [*ratios.values()]))
        rows.append((speed, value * factor, False))
    return tuple(sorted(rows))


def _remarks(
    drivings: Sequence[Driving],
    axles: Sequence[AxleCooling],
    downs: Sequence[cool_downs.CoolDown],
) -> tuple[str, ...]:
    remarks = [f"{d.name}: {text}" for d in drivings for text in d.remarks]
    speed_ms = np.concatenate([driving.speed_ms for driving in drivings])
    speed_ms = speed_ms[np.isfinite(speed_ms)]
    for one in axles:
        end_ms = one.table[-1][0] if one.table else one.disc.speeds_ms[-1]
        share = float(np.mean(speed_ms > end_ms + NEAR_MS))
        if share > 0.0:
            remarks.append(disc_loss.beyond_words(one.axle, share, end_ms))
        best = one.fit.residual_k
        if one.other_residual_k * WRONG_FORM < best:
            other = "conductance" if one.disc.form == "rate" else "rate"
            remarks.append(
                f'{one.axle}: with [cooling] form = "{one.disc.form}" the fit '
                f"misses by {best:.1f} K rms, with {other!r} by "
                f"{one.other_residual_k:.1f} K. S of the two forms differs"
            )
        if any(not point.speed_ms for point in one.points) and any(
            not np.isfinite(down.pad_k).all()
            for down in downs
            if down.standing and down.corner[0].lower() == one.axle[0]
        ):
            remarks.append(
                f"{one.axle}: no measured pad front at standstill: S includes "
                "the exchange of disc and pads"
            )
    remarks.append(
        "the errors include drift of the thermocouples and of the model, the "
        "sides' difference, and 3 K of offset between disc and ambient sensor"
    )
    return tuple(remarks)
