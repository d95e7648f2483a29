"""S over speed from any drive with measured discs, heat from motion.

No stretch of one speed is needed: S as a straight line over speed, which the
thesis finds it to be (section 4.4), a factor on the heat and one on the
resistances are fitted to windows of a drive. Its quality is the
error on windows held out of the fit. A value for each speed of the table
would absorb errors of the heat at speeds that occur only while braking.

Steps of a quarter of a second: a race car's stop lasts two. Brake work is
the loss of kinetic energy that resistances, climb and drive line do not
account for (Eq 4.5).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify import disc_loss
from bstm_daemon.analysis.identify.cool_downs import AXLES, HOT_K, slow_of
from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.quality.braking import released_reading, resistance_n
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.statistics import levenberg_marquardt
from bstm_daemon.analysis.statistics.resampling import jackknife
from bstm_daemon.analysis.statistics.series import (
    Column,
    Indices,
    Matrix,
    block_means,
)
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError

STEP_S: Final = 0.25
WINDOW_S: Final = 90.0
"""Length of a window, longer than a stop and short within a drive: a lap."""

LEAST_TIMES: Final = 4
"""Least number of windows: two to fit, two to validate."""

FAINT: Final = 0.2
"""Largest relative standard error of S at the mean speed."""

ENDS: Final = (0.05, 0.95)
"""Shares of the time below the speeds at which the line is held."""

_POINTS: Final = round(STEP_S / GRID_S)
_STEPS: Final = round(WINDOW_S / STEP_S)
_LEAST_SPAN_MS: Final = 3.0
_LEAST_PER_S: Final = 1e-5
_START_RESIST: Final = 1.5


@dataclass(frozen=True, slots=True)
class Window:
    """One thermocouple over :data:`WINDOW_S`, (n,) each, SI.

    ``lost_j`` is the kinetic energy lost in each step less climb and plus
    the drive line's work, ``resisted_j`` the work of the resistances;
    ``pressed`` is 0 where the brake is known to be released.
    """

    log: str
    role: str
    corner: str
    start_s: float
    disc_k: Column
    ambient_k: Column
    speed_ms: Column
    lost_j: Column
    resisted_j: Column
    pressed: Column

    @property
    def place(self) -> tuple[str, float]:
        """Log and time, which the thermocouples share."""
        return self.log, self.start_s

    @property
    def time_s(self) -> Column:
        """Time since the start of the log, (n,)."""
        steps = np.arange(len(self.disc_k), dtype=np.float64)
        return self.start_s + STEP_S * steps


@dataclass(frozen=True, slots=True)
class BrakedAxle:
    """Results of a drive for an axle's discs.

    S is a line through ``s_per_s`` at the two ``held_ms`` with
    ``covariance``, from leaving out one window at a time. ``heat`` is the
    factor on the heat of the configured mass, shares and disc, ``resist``
    that on the resistances while braking, each with its error. ``fitted_k``
    and ``held_k`` are the root mean squares on windows in and not in the fit,
    both halves in turn, each window from its first measurement on.
    """

    axle: str
    disc: disc_loss.DiscLoss
    mean_speed_ms: float
    held_ms: tuple[float, float]
    s_per_s: Column
    covariance: Matrix
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

        Beyond the line's ends, the configured S scaled as at the end: an
        extrapolated line may have no cooling at rest.
        """
        low, high = self.held_ms
        if not self.driven(speed_ms):
            end = low if speed_ms < low else high
            there, here = self.disc.configured(np.array([end, speed_ms]))
            factor = float(here / max(there, _LEAST_PER_S))
            value, error = self.at(end)
            return value * factor, error * factor
        into = (speed_ms - low) / (high - low)
        weights = np.array([1.0 - into, into])
        value = max(float(weights @ self.s_per_s), 0.0)
        return value, float(np.sqrt(weights @ self.covariance @ weights))

    @property
    def still(self) -> None:
        """None: the standstill fraction is not identified."""

    @property
    def caveat(self) -> str:
        """Why the line is not identified; empty if it is."""
        value, error = self.at(self.mean_speed_ms)
        if error > FAINT * value:
            share = 100.0 * error / max(value, 1e-9)
            return f"standard error of {share:.0f} % at the mean speed"
        return ""

    @property
    def table(self) -> tuple[tuple[float, float, bool], ...]:
        """S at :attr:`speeds_ms`, and whether they were driven."""
        if self.caveat:
            return ()
        return tuple(
            (speed, self.at(speed)[0], self.driven(speed))
            for speed in self.speeds_ms
        )

    @property
    def speeds_ms(self) -> tuple[float, ...]:
        """The configured speeds, and the line's end where it is beyond."""
        speeds, top = self.disc.speeds_ms, self.held_ms[1]
        return (*speeds, top) if top > speeds[-1] else speeds

    @property
    def beyond(self) -> tuple[float, float]:
        """Share of the time above the table's last speed, and that [m/s].

        The configured table's where none is found.
        """
        end_ms = self.table[-1][0] if self.table else self.disc.speeds_ms[-1]
        speed = np.concatenate([one.speed_ms for one in self.windows])
        return float(np.mean(speed > end_ms)), end_ms


@dataclass(frozen=True, slots=True)
class BrakedCooling:
    """Results from the drives of all logs."""

    axles: tuple[BrakedAxle, ...]
    remarks: tuple[str, ...]


def identify_while_braking(
    drivings: Sequence[Driving], config: Config
) -> BrakedCooling:
    """Fit S over speed to *drivings* as a whole, stops included.

    Raises:
        LogError: too few windows in which all is known and a disc is hot.
    """
    found = [window for driving in drivings for window in windows_of(driving)]
    axles, counts = [], []
    for letter, axle in AXLES.items():
        discs: dict[str, tuple[disc_loss.DiscLoss, float]] = {
            corner.name: (loss, disc_loss.share_of_work(config, corner))
            for corner in config.corner
            if corner.name[0] == letter
            and (loss := disc_loss.disc_loss(config, corner.name)) is not None
        }
        windows = [window for window in found if window.corner in discs]
        times = {window.place for window in windows}
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
            "no signal shows what the engine does: all deceleration beyond "
            "the resistances counts as braking"
        )
    remarks += [
        disc_loss.beyond_words(axle.axle, *axle.beyond)
        for axle in axles
        if axle.beyond[0] > 0.0
    ]
    remarks.append(
        "heat and heat capacity cannot be separated: the factor on the heat "
        "covers mass, shares and capacity together"
    )
    return BrakedCooling(tuple(axles), tuple(remarks))


def windows_of(driving: Driving) -> list[Window]:
    """Return the windows of *driving* in which everything is known.

    Only those in which the disc is :data:`HOT_K` above ambient at some time.
    """
    car, speed, slow = driving.vehicle, driving.speed_ms, slow_of(driving)
    count = (len(speed) - 1) // _POINTS
    ends = np.arange(count + 1) * _POINTS

    def per_step(value: Column) -> Column:
        return block_means(value, _POINTS)[:count]

    pull = np.nan_to_num(driving.torque_nm) / car.wheel_radius_m
    pull = pull + driving.external_n
    if driving.has_accelerometer:
        pull = pull - car.mass_kg * np.nan_to_num(driving.slope_ms2)
    kinetic = 0.5 * car.effective_mass_kg * speed[ends] ** 2
    lost = -np.diff(kinetic) + per_step(pull * speed) * STEP_S
    resisted = per_step(resistance_n(car, speed) * speed) * STEP_S
    pressed = np.ones(len(speed))
    if driving.pressures:
        top = driving.highest_pressure_pa()
        rest, above = released_reading(top, speed, driving.rate_ms2)
        pressed[top - rest < above] = 0.0
    on, mean_speed = per_step(pressed), per_step(speed)
    ambient = np.interp(driving.time_s[ends[:-1]], slow.time_s, slow.ambient_k)
    columns = ambient, mean_speed, lost, resisted, on
    found = []
    for role in slow.discs:
        disc = driving.value(role)[ends[:-1]]
        known = np.isfinite(disc + lost + resisted + mean_speed)
        for first in range(0, count - _STEPS + 1, _STEPS):
            part = slice(first, first + _STEPS)
            hottest_k = (disc[part] - ambient[part]).max()
            if not known[part].all() or hottest_k < HOT_K:
                continue
            found.append(
                Window(
                    *(driving.name, role, role.split("_")[1].upper()),
                    float(driving.time_s[ends[first]]),
                    *(column[part] for column in (disc, *columns)),
                )
            )
    return found


class BrakedLanes:
    """Windows marched side by side with brake heat (Eq 2.6, 4.12)."""

    def __init__(
        self,
        windows: Sequence[Window],
        discs: Mapping[str, tuple[disc_loss.DiscLoss, float]],
        held_ms: tuple[float, float],
    ) -> None:
        """Take *windows* and the speeds at which the line of S is held.

        *discs* has disc and share of the work by corner.
        """

        def side_by_side(name: str) -> Matrix:
            return np.stack([getattr(one, name) for one in windows], axis=1)

        losses, shares = zip(*(discs[w.corner] for w in windows), strict=True)
        self.count = len(windows)
        self.measured_k = side_by_side("disc_k")
        self._ambient_k = side_by_side("ambient_k")
        self._lost_j = side_by_side("lost_j")
        self._resisted_j = side_by_side("resisted_j")
        self._share = side_by_side("pressed") * np.array(shares)
        speed = side_by_side("speed_ms")
        low, high = held_ms
        self._into = np.clip((speed - low) / (high - low), 0.0, 1.0)
        still = np.array([loss.still for loss in losses])
        end = np.array([loss.blend_end_ms for loss in losses])
        rising = np.clip(speed / end, 0.0, 1.0)
        self._blend = STEP_S * (still + (1.0 - still) * rising)
        radiation = np.array([loss.radiation_w_k4 for loss in losses])
        self._radiation = STEP_S * (1.0 - rising) * radiation
        self._capacities = disc_loss.HeatCapacities(
            losses, [loss.rate_form for loss in losses]
        )

    def march(self, values: Matrix) -> Matrix:
        """Return the discs [K], (steps, windows, m), of m sets of *values*.

        *values* (m, 4): S at both speeds [1/s], the factor on the heat, and
        that on the resistances.
        """
        low, high, heat, resist = values.T
        rows = np.arange(self.count)[:, None]
        now = np.repeat(self.measured_k[0][:, None], len(values), axis=1)
        out = np.empty((len(self.measured_k), *now.shape))
        for step in range(len(out)):
            out[step] = now
            into = self._into[step][:, None]
            rate = low * (1.0 - into) + high * into
            work = self._lost_j[step][:, None] - (
                resist * self._resisted_j[step][:, None]
            )
            work = np.maximum(work, 0.0) * heat * self._share[step][:, None]
            per_capacity = self._capacities.inverse(rows, now)
            strength = self._capacities.factor(rows, per_capacity)
            ambient = self._ambient_k[step][:, None]
            beside = self._radiation[step][:, None] * (now**4 - ambient**4)
            loss = rate * strength * self._blend[step][:, None]
            now = now + (work - beside) * per_capacity - loss * (now - ambient)
            now = np.clip(now, disc_loss.LOWEST_K, disc_loss.HIGHEST_K)
        return out

    def left(self, logs: Matrix) -> Matrix:
        """Return measurement less model at *logs* (k, p) of the values.

        (k, steps, windows).
        """
        model = self.march(np.exp(logs))
        return np.moveaxis(self.measured_k[:, :, None] - model, -1, 0)

    def fit(self, start: Column) -> levenberg_marquardt.Solution:
        """Fit the logarithms of the values, from *start*."""
        wide = np.full(len(start), np.inf)
        return levenberg_marquardt.minimise(
            lambda logs: self.left(logs).reshape(len(logs), -1),
            start,
            -wide,
            wide,
            converged=1e-6,
        )


def _axle(
    axle: str,
    windows: Sequence[Window],
    discs: Mapping[str, tuple[disc_loss.DiscLoss, float]],
) -> BrakedAxle:
    loss = next(iter(discs.values()))[0]
    speeds = np.concatenate([w.speed_ms for w in windows])
    low, high = (float(one) for one in np.quantile(speeds, ENDS))
    if high - low < _LEAST_SPAN_MS:
        msg = (
            f"{axle} discs: speeds from {3.6 * low:.0f} to "
            f"{3.6 * high:.0f} km/h only, too narrow for S over speed"
        )
        raise LogError(msg)
    ends = low, high
    first = np.maximum(loss.configured(np.array(ends)), _LEAST_PER_S)
    start = np.log([*first, 1.0, _START_RESIST])
    times = sorted({w.place for w in windows})
    number = np.array([times.index(w.place) for w in windows])
    whole = BrakedLanes(windows, discs, ends)
    joint = whole.fit(start)
    shape = whole.measured_k.shape
    fitted, held = 0.0, np.empty(shape)
    for half in (0, 1):
        inside = number % 2 == half
        chosen = [w for w, on in zip(windows, inside, strict=True) if on]
        own = BrakedLanes(chosen, discs, ends).fit(joint.x)
        fitted += 2.0 * own.cost
        held[:, ~inside] = whole.left(own.x[None])[0][:, ~inside]
    values = np.exp(joint.x)
    spread = _left_out(
        joint.residuals.reshape(shape),
        joint.jacobian.reshape(*shape, -1),
        number,
    ) * np.outer(values, values)
    errors = np.sqrt(np.diag(spread))
    return BrakedAxle(
        axle,
        loss,
        float(speeds.mean()),
        (low, high),
        values[:2],
        spread[:2, :2],
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

    A window counts once however many steps it has: its errors are
    correlated throughout.
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
