"""S over speed from any drive with measured discs, heat from motion.

No stretch of one speed is needed: S as a straight line over speed, which the
thesis finds it to be (section 4.4), a factor on the heat and one on the
resistances are fitted to windows of a drive. What the fit is worth is its
error on windows that it did not see. A value for each speed of the table
would take up what the heat misses at speeds that are only braked through.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.braked_discs import (
    WINDOW_S,
    BrakedLanes,
    Window,
    windows_of,
)
from bstm_daemon.analysis.identify.cool_downs import slow_of
from bstm_daemon.analysis.identify.disc_loss import DiscLoss, disc_loss
from bstm_daemon.analysis.statistics.levenberg_marquardt import (
    Solution,
    minimise,
)
from bstm_daemon.analysis.statistics.resampling import jackknife
from bstm_daemon.errors import LogError
from bstm_daemon.model.thermal.brake_corner import corner_spec
from bstm_daemon.model.thermal.partition import pad_share

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.analysis.statistics.series import Column, Indices, Matrix
    from bstm_daemon.config.sections import Config, CornerConfig

LEAST_TIMES: Final = 4
"""Windows in time: two to fit, two to judge by."""

FAINT: Final = 0.2
"""A larger share of standard error, at the mean speed, is no value."""

ENDS: Final = (0.05, 0.95)
"""Shares of the time below the speeds at which the line is held."""

_LEAST_SPAN_MS: Final = 3.0
_LEAST_PER_S: Final = 1e-5
_START_RESIST: Final = 1.5


@dataclass(frozen=True, slots=True)
class BrakedAxle:
    """What a drive shows about an axle's discs.

    S is a line through ``s_per_s`` at the two ``held_ms`` with
    ``covariance``, from leaving out one window at a time. ``heat`` is the
    factor on the heat of the configured mass, shares and disc, ``resist``
    that on the resistances while braking, each with its error. ``fitted_k``
    and ``held_k`` are the root mean squares on windows in and not in the fit,
    both halves in turn, each window from its first measurement on.
    """

    axle: str
    form: str
    mean_speed_ms: float
    held_ms: tuple[float, float]
    s_per_s: Column
    covariance: Matrix
    speeds_ms: tuple[float, ...]
    configured: Column
    heat: tuple[float, float]
    resist: tuple[float, float]
    fitted_k: float
    held_k: float
    range_k: tuple[float, float]
    windows: tuple[Window, ...]
    held_model_k: Matrix

    def driven(self, speed_ms: float) -> bool:
        """Whether *speed_ms* lies on the line that was driven."""
        return self.held_ms[0] <= speed_ms <= self.held_ms[1]

    def at(self, speed_ms: float) -> tuple[float, float]:
        """Return S at *speed_ms* and its standard error.

        Beyond the line's ends, the configured S moved by what the end moved
        by: a line carried on may have no cooling at rest.
        """
        low, high = self.held_ms
        if not self.driven(speed_ms):
            end = low if speed_ms < low else high
            there, here = np.interp(
                [end, speed_ms], self.speeds_ms, self.configured
            )
            factor = float(here / max(there, _LEAST_PER_S))
            value, error = self.at(end)
            return value * factor, error * factor
        into = (speed_ms - low) / (high - low)
        weights = np.array([1.0 - into, into])
        value = max(float(weights @ self.s_per_s), 0.0)
        return value, float(np.sqrt(weights @ self.covariance @ weights))

    @property
    def still(self) -> None:
        """The standstill fraction is not looked for."""

    @property
    def caveat(self) -> str:
        """Why the line is not settled; empty if it is."""
        value, error = self.at(self.mean_speed_ms)
        if error > FAINT * value:
            share = 100.0 * error / max(value, 1e-9)
            return f"standard error of {share:.0f} % at the mean speed"
        return ""

    @property
    def table(self) -> tuple[tuple[float, float, bool], ...]:
        """S at the configured speeds, and whether they were driven."""
        if self.caveat:
            return ()
        return tuple(
            (speed, self.at(speed)[0], self.driven(speed))
            for speed in self.speeds_ms
        )


@dataclass(frozen=True, slots=True)
class BrakedCooling:
    """What the drives of all logs show."""

    axles: tuple[BrakedAxle, ...]
    remarks: tuple[str, ...]


def identify_while_braking(
    drivings: Sequence[Driving], config: Config
) -> BrakedCooling:
    """Fit S over speed to *drivings* as a whole, stops included.

    Raises:
        LogError: too few windows in which all is known and a disc is hot.
    """
    found = [
        window
        for driving in drivings
        for window in windows_of(driving, slow_of(driving))
    ]
    axles, counts = [], []
    for letter, axle in (("F", "front"), ("R", "rear")):
        corners = {c.name: c for c in config.corner if c.name[0] == letter}
        discs: dict[str, tuple[DiscLoss, float]] = {
            name: (loss, _share(config, corner))
            for name, corner in corners.items()
            if (loss := disc_loss(config, name)) is not None
        }
        windows = [window for window in found if window.corner in discs]
        times = {(w.log, w.start_s) for w in windows}
        counts.append(f"{axle} {len(times)}")
        if len(times) >= LEAST_TIMES:
            axles.append(_axle(axle, windows, discs))
    if not axles:
        msg = (
            f"{LEAST_TIMES} stretches of {WINDOW_S:g} s with speed and a "
            f"measured disc 40 K above ambient needed: {', '.join(counts)}"
        )
        raise LogError(msg)
    remarks = [f"{d.name}: {text}" for d in drivings for text in d.remarks]
    if not all(driving.line_known for driving in drivings):
        remarks.append(
            "nothing tells what the engine does: whatever slows the car "
            "beyond its resistances is taken as brake"
        )
    remarks.append(
        "heat and heat capacity are one: the factor on the heat is that of "
        "mass, shares and capacity together"
    )
    return BrakedCooling(tuple(axles), tuple(remarks))


def _share(config: Config, corner: CornerConfig) -> float:
    """Return the disc's share of the car's brake work, as configured."""
    front = config.vehicle.front_share
    of_axle = front if corner.name[0] == "F" else 1.0 - front
    spec = corner_spec(config, corner)
    thermal = spec.thermal
    pads = pad_share(spec.disc_share, thermal.heat_partition_correction_factor)
    air = thermal.direct_air_fraction
    return 0.5 * of_axle * (1.0 - air) * (1.0 - pads)


def _lanes(
    windows: Sequence[Window],
    discs: Mapping[str, tuple[DiscLoss, float]],
    knots_ms: Sequence[float],
) -> BrakedLanes:
    """Return the march of *windows*, each with its disc and share."""
    return BrakedLanes(
        windows,
        [discs[w.corner][0] for w in windows],
        knots_ms,
        [discs[w.corner][1] for w in windows],
    )


def _left(lanes: BrakedLanes, logs: Matrix) -> Matrix:
    """Return measurement less model at *logs* (k, p), (k, steps, windows)."""
    model = lanes.march(np.exp(logs))
    return np.moveaxis(lanes.measured_k[:, :, None] - model, -1, 0)


def _fit(lanes: BrakedLanes, start: Column) -> Solution:
    """Fit the logarithms of the values to all windows of *lanes*."""
    wide = np.full(len(start), np.inf)
    return minimise(
        lambda logs: _left(lanes, logs).reshape(len(logs), -1),
        start,
        -wide,
        wide,
        converged=1e-6,
    )


def _axle(
    axle: str,
    windows: Sequence[Window],
    discs: Mapping[str, tuple[DiscLoss, float]],
) -> BrakedAxle:
    loss = next(iter(discs.values()))[0]
    speeds = np.concatenate([w.speed_ms for w in windows])
    low, high = (float(one) for one in np.quantile(speeds, ENDS))
    if high - low < _LEAST_SPAN_MS:
        msg = (
            f"{axle} discs: speeds from {3.6 * low:.0f} to "
            f"{3.6 * high:.0f} km/h only, nothing over speed to be found"
        )
        raise LogError(msg)
    knots = [low, high]
    first = np.maximum(loss.configured(np.array(knots)), _LEAST_PER_S)
    start = np.log([*first, 1.0, _START_RESIST])
    times = sorted({(w.log, w.start_s) for w in windows})
    number = np.array([times.index((w.log, w.start_s)) for w in windows])
    whole = _lanes(windows, discs, knots)
    joint = _fit(whole, start)
    shape = whole.measured_k.shape
    fitted, held = 0.0, np.empty(shape)
    for half in (0, 1):
        inside = number % 2 == half
        own = _fit(
            _lanes(
                [w for w, on in zip(windows, inside, strict=True) if on],
                discs,
                knots,
            ),
            joint.x,
        )
        fitted += 2.0 * own.cost
        held[:, ~inside] = _left(whole, own.x[None])[0][:, ~inside]
    values = np.exp(joint.x)
    spread = _left_out(
        joint.residuals.reshape(shape),
        joint.jacobian.reshape(*shape, -1),
        number,
    ) * np.outer(values, values)
    errors = np.sqrt(np.diag(spread))
    return BrakedAxle(
        axle,
        "rate" if loss.rate_form else "conductance",
        float(speeds.mean()),
        (low, high),
        values[:2],
        spread[:2, :2],
        loss.speeds_ms,
        loss.configured(np.array(loss.speeds_ms)),
        (float(values[2]), float(errors[2])),
        (float(values[3]), float(errors[3])),
        float(np.sqrt(fitted / held.size)),
        float(np.sqrt(np.mean(held**2))),
        (
            min(float(w.disc_k.min()) for w in windows),
            max(float(w.disc_k.max()) for w in windows),
        ),
        tuple(windows),
        whole.measured_k - held,
    )


def _left_out(left: Matrix, slopes: Matrix, number: Indices) -> Matrix:
    """Return the covariance, leaving out one time at a time (jackknife).

    A window is one number however many steps it has: what it misses is
    missed all along.
    """
    size = slopes.shape[-1]
    count = int(number.max()) + 1
    normals = np.empty((count, size, size))
    pulls = np.empty((count, size))
    for time in range(count):
        x = slopes[:, number == time].reshape(-1, size)
        normals[time] = x.T @ x
        pulls[time] = x.T @ left[:, number == time].ravel()
    without = normals.sum(axis=0) - normals
    steps = np.einsum(
        "tij,tj->ti",
        np.linalg.pinv(without, hermitian=True),
        pulls.sum(axis=0) - pulls,
    )
    return jackknife(steps)
