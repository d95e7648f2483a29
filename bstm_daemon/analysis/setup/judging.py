"""Whether a signal does in a recording what its role does.

Roles are judged in three stages: what is sure of one is known to the next, as
a pressure to the brake switch and the engine's speed to gear and clutch. It
does not matter whether a signal is of a DBC or a column of a table.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.bends import fit_in_bends, follows_bends
from bstm_daemon.analysis.quality.comparison import Fit
from bstm_daemon.analysis.setup.behaviour import Motion, Verdict, to_ms, to_si
from bstm_daemon.analysis.setup.recording import Samples, Series
from bstm_daemon.roles import CORNERS, GROUND_LAG_S

Mask = npt.NDArray[np.bool_]

SPEEDS: Final = ("wheel_speed_", "vehicle_speed")
_BRAKING: Final = (
    *("primary_pressure", "secondary_pressure", "wheel_pressure_"),
    *("brake_torque", "brake_pedal_travel"),
)
_FIRST: Final = (
    *(*SPEEDS, *_BRAKING),
    *("acceleration_longitudinal", "engine_speed"),
)
_MAY_STAY: Final = ("ambient_temperature", "ignition")
_STILL: Final = ", which shows nothing of it"
"""Roles of which a constant value is what a drive shows; said of others."""

_ON_THE_MOVE: Final = {
    "park_brake": (0.0, 0.02),
    "ignition": (0.9, 1.0),
    "abs_active": (0.0, 0.5),
    "esc_active": (0.0, 0.5),
    "tc_active": (0.0, 0.5),
}
"""Share of the time on the move in which a flag is on."""

_RANGES: Final = {
    "engine_speed": (-1.0, 2100.0),
    "acceleration_": (-30.0, 30.0),
    "yaw_rate": (-3.0, 3.0),
    "pitch": (-0.6, 0.6),
    "altitude": (-500.0, 9000.0),
    "ambient_temperature": (213.0, 343.0),
    "temp_": (200.0, 1500.0),
}
"""Range [SI] of the middle 98 % of the values of roles of this beginning."""

_ENOUGH_S: Final = 1.0
_BENDS_S: Final = 5.0
_FOLLOWS: Final = 0.6
_ALONG: Final = 0.8
_TRACK_M: Final = (0.8, 2.5)
_AT_WHEELS_KG: Final = (400.0, 5000.0)
"""Torque at the wheels over radius and acceleration: the mass of a car."""

_BRAKED_MS2: Final = -1.5
_DRIVEN_MS2: Final = 0.5
_HEATING_K_S: Final = 1.0
_SHIFT_S: Final = 0.5
_IDLE_RAD_S: Final = 30.0
_APART_1_S: Final = 0.2
"""Relative change of engine speed over speed that no gear gives."""


def stage_of(role: str) -> int:
    """Return the stage, 0 to 2, in which *role* is judged."""
    if role.startswith(_FIRST):
        return 0
    return 1 if role in ("yaw_rate", "gear") else 2


class Judge:
    """The verdicts on the signals of one recording.

    ``known`` has the sure roles of earlier stages, SI, on the grid of
    ``motion``; ``radius_m`` is that of a wheel, for angular speeds.
    """

    def __init__(self, motion: Motion, radius_m: float) -> None:
        """Judge by *motion*, with no role known."""
        self.motion = motion
        self.radius_m = radius_m
        self.known: dict[str, Series] = {}

    def si(self, role: str, unit: str, samples: Samples) -> Samples:
        """Return *samples* in SI, angular speeds of wheels in m/s."""
        if role.startswith(SPEEDS):
            return to_ms(samples, unit, self.radius_m)
        return to_si(samples, unit)

    def verdict(self, role: str, unit: str, samples: Samples) -> Verdict:
        """Judge *samples* in *unit* ("" where it is not known) for *role*."""
        motion = self.motion
        if role.startswith(_BRAKING):
            found = motion.pressure_verdict(samples)
            # that of one axle or wheel needs corners that use it
            shown = found.proven and role == "primary_pressure"
            return replace(found, proven=shown)
        if unit and role.startswith((*SPEEDS, *GROUND_LAG_S)):
            return motion.speed_verdict(self.si(role, unit, samples))
        if unit and role == "acceleration_longitudinal":
            return motion.acceleration_verdict(to_si(samples, unit))
        return self._other(role, unit, samples)

    def _other(self, role: str, unit: str, samples: Samples) -> Verdict:
        low, high = float(samples.value.min()), float(samples.value.max())
        reason = f"{low:g} to {high:g} in the log"
        if low == high:
            fits, what = role in _MAY_STAY, "" if role in _MAY_STAY else _STILL
            return Verdict(
                fits=fits, reason=f"always {low:g} in the log{what}"
            )
        if not unit:
            return Verdict(fits=True, reason=reason)
        si = to_si(samples, unit)
        least, most = np.quantile(si.value, (0.01, 0.99))
        for start, (lowest, highest) in _RANGES.items():
            if role.startswith(start) and (least < lowest or most > highest):
                return Verdict(fits=False, reason=f"{reason}: out of range")
        value = self.motion.on_grid(si)
        if role in _ON_THE_MOVE and self.motion.moving.any():
            lowest, highest = _ON_THE_MOVE[role]
            share = float(np.mean(value[self.motion.moving] > 0.5))
            found = Verdict(
                fits=lowest <= share <= highest,
                reason=f"on {100 * share:.0f} % of the time on the move",
            )
        elif role in _SPECIAL and self.motion.known:
            found = _SPECIAL[role](self, value)
        else:
            return Verdict(fits=True, reason=reason)
        return replace(found, reason=f"{reason}; {found.reason}")

    def seconds(self, mask: Mask) -> float:
        """Return how long *mask*, on the grid, is true."""
        return float(np.count_nonzero(mask)) * self.motion.step_s

    def share_on(self, value: Series, where: Mask) -> float:
        """Return the share of *where* in which a flag is on, NaN if short."""
        long = self.seconds(where) > _ENOUGH_S
        return float(np.mean(value[where] > 0.5)) if long else np.nan

    def follows(
        self, value: Series, other: Series, where: Mask
    ) -> tuple[float, float] | None:
        """Return correlation and ratio of the spreads of *other* to *value*.

        In *where*, both smoothed; None where that is short or one is still.
        """
        x, y = (
            self.motion.smooth(value)[where],
            self.motion.smooth(other)[where],
        )
        if self.seconds(where) < _BENDS_S or min(np.std(x), np.std(y)) == 0.0:
            return None
        r = float(np.corrcoef(x, y)[0, 1])
        return r, float(np.std(y) / np.std(x))

    def turning_s(self, yaw_rad_s: Series) -> float:
        """Return how long the car is in a bend."""
        fast = self.motion.speed_ms > limits.BEND_MS
        turning = np.abs(yaw_rad_s) > limits.YAW_SPREAD_RAD_S
        return self.seconds(fast & turning)

    def in_bends(
        self, yaw_rad_s: Series, other: Series, floor: float
    ) -> Fit | None:
        """Return :func:`fit_in_bends` of *other*, where the car is seen."""
        motion = self.motion
        speed_ms = np.where(motion.seen, motion.speed_ms, 0.0)
        return fit_in_bends(yaw_rad_s, speed_ms, other, floor, motion.step_s)

    def braking(self) -> tuple[str, Mask, Mask]:
        """Return what shows braking, where it is released and where not."""
        for role in ("primary_pressure", "brake_torque"):
            if role in self.known:
                value = self.known[role]
                low, high = np.quantile(value, 0.05), value.max()
                part = (value - low) / max(high - low, 1e-9)
                return role, part < 0.01, part > 0.1
        change, moving = self.motion.change_ms2, self.motion.moving
        driven = moving & (change > _DRIVEN_MS2)
        return "deceleration", driven, moving & (change < _BRAKED_MS2)


def _brake_switch(judge: Judge, value: Series) -> Verdict:
    role, released, pressed = judge.braking()
    on, off = judge.share_on(value, pressed), judge.share_on(value, released)
    return Verdict(
        fits=not (on < 0.7 or off > 0.3),
        reason=f"on {100 * on:.0f} % of the time braked and {100 * off:.0f} % "
        f"released, by {role}",
    )


def _gear(judge: Judge, value: Series) -> Verdict:
    """In a higher gear the engine turns fewer times a metre."""
    motion = judge.motion
    if "engine_speed" not in judge.known:
        words = "no engine speed to compare it with"
        return Verdict(fits=True, reason=words)
    turns = judge.known["engine_speed"] / np.maximum(motion.speed_ms, 1.0)
    found = {
        gear: float(np.median(turns[here]))
        for gear in range(1, 11)
        for here in (motion.moving & (np.abs(value - gear) < 0.01),)
        if judge.seconds(here) > _ENOUGH_S
    }
    rising = np.diff(list(found.values())) > 0.0
    return Verdict(
        fits=int(np.count_nonzero(rising)) * 2 <= len(rising),
        reason="engine speed over speed "
        + ", ".join(f"{one:.1f} in {gear}" for gear, one in found.items()),
    )


def _clutch_open(judge: Judge, value: Series) -> Verdict:
    """Gears change and the car stands with the clutch open.

    Closed, engine and wheels turn together.
    """
    motion, known = judge.motion, judge.known
    moving, still = motion.moving, np.zeros_like(value)
    gear, engine = known.get("gear", still), known.get("engine_speed", still)
    reach = 2 * round(_SHIFT_S / motion.step_s) + 1
    changing = np.abs(np.gradient(gear)) > 0.0
    near = np.convolve(changing, np.ones(reach), "same") > 0.5
    running = engine > _IDLE_RAD_S
    slip = np.log(np.maximum(engine, 1.0) / np.maximum(motion.speed_ms, 1.0))
    slip_1_s = np.abs(np.gradient(motion.smooth(slip), motion.step_s))
    apart = running & moving & (slip_1_s > _APART_1_S)
    shares = {
        "around gear changes": judge.share_on(value, near & moving),
        "while engine and wheels part": judge.share_on(value, apart),
        "standing": judge.share_on(value, running & (motion.speed_ms < 0.3)),
    }
    else_ = judge.share_on(value, moving & ~near & ~apart)
    words = ", ".join(
        f"{100 * share:.0f} % of the time {when}"
        for when, share in shares.items()
        if np.isfinite(share)
    )
    return Verdict(
        fits=any(
            share > max(least, 2.5 * else_)
            for least, share in zip(
                (0.3, 0.3, 0.7), shares.values(), strict=True
            )
        ),
        reason=f"open {words}, {100 * else_:.0f} % else"
        if words
        else "no change of gear or engine speed to check it with",
    )


def _torque(judge: Judge, value: Series) -> Verdict:
    """Torque at the wheels accelerates the mass of a car."""
    # with the grade in it, where it is known
    change_ms2 = judge.motion.change_ms2
    accel = judge.known.get("acceleration_longitudinal", change_ms2)
    free = judge.motion.moving & ~judge.braking()[2]
    found = judge.follows(value, accel, free)
    if found is None:
        return Verdict(fits=True, reason="too little driving to check it with")
    r, ratio = found
    mass_kg = 1.0 / (ratio * judge.radius_m)
    return Verdict(
        fits=r > _FOLLOWS,
        reason=f"acceleration follows it, r = {r:.2f}, as of {mass_kg:.0f} "
        "kg if at the wheels",
        proven=r > _ALONG and _AT_WHEELS_KG[0] < mass_kg < _AT_WHEELS_KG[1],
    )


def _wheel_torque(judge: Judge, value: Series) -> Verdict:
    found = _torque(judge, value)
    return replace(found, fits=found.proven) if "kg" in found.reason else found


def _yaw_rate(judge: Judge, value: Series) -> Verdict:
    """To the left, the right wheels are the faster ones by yaw times track."""
    known = judge.known
    pairs = [
        known[f"wheel_speed_{axle}r"] - known[f"wheel_speed_{axle}l"]
        for axle in "fr"
        if {f"wheel_speed_{axle}r", f"wheel_speed_{axle}l"} <= known.keys()
    ]
    if not pairs or judge.turning_s(value) < limits.ENOUGH_S:
        return Verdict(fits=True, reason="the wheels show no bends")
    fit = judge.in_bends(value, np.sum(pairs, axis=0), limits.SPEED_FLOOR_MS)
    if fit is None or not follows_bends(fit):
        return Verdict(fits=True, reason="the wheels do not follow it")
    track_m = fit.scale / len(pairs)
    return Verdict(
        fits=_TRACK_M[0] < abs(track_m) < _TRACK_M[1],
        reason=f"right minus left wheels is {track_m:.2f} m x value",
        sign=1 if track_m > 0.0 else -1,
    )


def _lateral(judge: Judge, value: Series) -> Verdict:
    """Speed times yaw rate; what follows dv/dt lies along the car."""
    motion = judge.motion
    along = judge.follows(value, motion.change_ms2, motion.moving)
    if along is not None and abs(along[0]) > _ALONG:
        words = f"along the car: dv/dt follows it with r = {along[0]:.2f}"
        return Verdict(fits=False, reason=words)
    yaw = judge.known.get("yaw_rate", np.zeros_like(value))
    fit = judge.in_bends(
        yaw * motion.speed_ms, value, limits.ACCELERATION_FLOOR_MS2
    )
    if fit is None or judge.turning_s(yaw) < limits.ENOUGH_S:
        return Verdict(fits=True, reason="no bends to compare it in")
    return Verdict(
        fits=abs(fit.correlation) >= limits.UNRELATED,
        reason=f"it follows v x yaw rate with r = {fit.correlation:.2f}",
        sign=-1 if fit.scale < 0.0 and follows_bends(fit) else 1,
    )


def _disc_temperature(judge: Judge, value: Series) -> Verdict:
    """A disc gets hotter while the car is braked, on the whole colder else.

    That shows it; a disc that hardly got warm shows nothing.
    """
    _, _, pressed = judge.braking()
    moving = judge.motion.moving
    rise_k_s = np.gradient(value, judge.motion.step_s)
    if (
        min(judge.seconds(pressed), judge.seconds(moving & ~pressed))
        < _BENDS_S
    ):
        return Verdict(fits=True, reason="hardly any braking")
    braked = float(np.mean(rise_k_s[pressed]))
    free = float(np.mean(rise_k_s[moving & ~pressed]))
    return Verdict(
        fits=True,
        reason=f"{braked:+.1f} K/s braked, {free:+.1f} K/s else",
        proven=braked > _HEATING_K_S and free < 0.0,
    )


_SPECIAL: Final[dict[str, Callable[[Judge, Series], Verdict]]] = {
    **{f"temp_{one.lower()}_disc": _disc_temperature for one in CORNERS},
    "brake_switch": _brake_switch,
    "gear": _gear,
    "clutch_open": _clutch_open,
    "powertrain_torque": _wheel_torque,
    "motor_torque": _torque,
    "engine_torque": _torque,
    "yaw_rate": _yaw_rate,
    "acceleration_lateral": _lateral,
}
