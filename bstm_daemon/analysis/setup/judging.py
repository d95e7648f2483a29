"""Whether a signal does in a recording what its role does.

Roles are judged in three stages: what is sure of one is known to the next, as
a pressure to the brake switch and the engine's speed to gear and clutch. It
does not matter whether a signal is of a DBC or a column of a table.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.setup.behaviour import Verdict, to_ms, to_si

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from bstm_daemon.analysis.setup.behaviour import Motion
    from bstm_daemon.analysis.setup.recording import Samples, Series

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
"""Roles of which a constant value is what a drive shows."""

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
_TURNING_RAD_S: Final = 0.05
_FOLLOWS: Final = 0.6
_ALONG: Final = 0.8
_TRACK_M: Final = (0.8, 2.5)
_AT_WHEELS_KG: Final = (400.0, 5000.0)
"""Torque at the wheels over radius and acceleration: the mass of a car."""

_BRAKED_MS2: Final = -1.5
_DRIVEN_MS2: Final = 0.5
_SHIFT_S: Final = 0.5
_IDLE_RAD_S: Final = 30.0


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
            return motion.pressure_verdict(samples)
        if unit and role.startswith((*SPEEDS, "gnss_speed")):
            return motion.speed_verdict(self.si(role, unit, samples))
        if unit and role == "acceleration_longitudinal":
            return motion.acceleration_verdict(to_si(samples, unit))
        return self._other(role, unit, samples)

    def _other(self, role: str, unit: str, samples: Samples) -> Verdict:
        low, high = float(samples.value.min()), float(samples.value.max())
        reason = f"{low:g} to {high:g} in the log"
        if low == high:
            fits = role in _MAY_STAY
            reason = f"always {low:g} in the log"
            if not fits:
                reason += ", which shows nothing of it"
                return Verdict(fits=False, reason=reason)
        if not unit:
            return Verdict(fits=True, reason=reason)
        si = to_si(samples, unit)
        inner = np.quantile(si.value, (0.01, 0.99))
        for start, (lowest, highest) in _RANGES.items():
            if role.startswith(start) and (
                inner[0] < lowest or inner[1] > highest
            ):
                return Verdict(fits=False, reason=f"{reason}: out of range")
        special = _SPECIAL.get(role)
        if special is None or not self.motion.known:
            return Verdict(fits=True, reason=reason)
        found = special(self, self.motion.on_grid(si))
        return replace(found, reason=f"{reason}; {found.reason}")

    def seconds(self, mask: Mask) -> float:
        """Return how long *mask*, on the grid, is true."""
        return float(np.count_nonzero(mask)) * self.motion.step_s

    def braking(self) -> tuple[str, Mask, Mask]:
        """Return what shows braking, where it is released and where not."""
        for role in ("primary_pressure", "brake_torque"):
            if role in self.known:
                value = self.known[role]
                low, high = np.quantile(value, 0.05), value.max()
                span = high - low
                return (
                    role,
                    value < low + 0.03 * span,
                    value > low + 0.1 * span,
                )
        change, moving = self.motion.change_ms2, self.motion.moving
        return (
            "deceleration",
            moving & (change > _DRIVEN_MS2),
            moving & (change < _BRAKED_MS2),
        )


def _brake_switch(judge: Judge, value: Series) -> Verdict:
    role, released, pressed = judge.braking()
    if min(judge.seconds(released), judge.seconds(pressed)) < _ENOUGH_S:
        return Verdict(fits=True, reason="too little braking to check it with")
    pressed_on = float(np.mean(value[pressed] > 0.5))
    released_on = float(np.mean(value[released] > 0.5))
    return Verdict(
        fits=pressed_on > 0.7 and released_on < 0.3,
        reason=f"on {100 * pressed_on:.0f} % of the time braked, "
        f"{100 * released_on:.0f} % released, by {role}",
    )


def _park_brake(judge: Judge, value: Series) -> Verdict:
    moving = judge.motion.moving
    share = float(np.mean(value[moving] > 0.5)) if moving.any() else 0.0
    return Verdict(
        fits=share < 0.02,
        reason=f"on {100 * share:.0f} % of the time on the move",
    )


def _intervention(judge: Judge, value: Series) -> Verdict:
    """Anti-lock, stability and traction control act now and then, moving."""
    moving, on = judge.motion.speed_ms > 0.5, value > 0.5
    share = float(np.mean(on[moving])) if moving.any() else 0.0
    standing = float(np.mean(~moving[on])) if on.any() else 0.0
    return Verdict(
        fits=share < 0.5 and standing < 0.5,
        reason=f"on {100 * share:.0f} % of the time on the move, "
        f"{100 * standing:.0f} % of it standing",
    )


def _ignition(judge: Judge, value: Series) -> Verdict:
    moving = judge.motion.moving
    share = float(np.mean(value[moving] > 0.5)) if moving.any() else 1.0
    return Verdict(
        fits=share > 0.9,
        reason=f"on {100 * share:.0f} % of the time on the move",
    )


def _gear(judge: Judge, value: Series) -> Verdict:
    """In a higher gear the engine turns fewer times a metre."""
    engine = judge.known.get("engine_speed")
    if engine is None:
        return Verdict(fits=True, reason="no engine speed to compare with")
    motion = judge.motion
    turns = engine / np.maximum(motion.speed_ms, 1.0)
    found = {}
    for gear in range(1, 11):
        here = motion.moving & (np.abs(value - gear) < 0.01)
        if judge.seconds(here) > _ENOUGH_S:
            found[gear] = float(np.median(turns[here]))
    if len(found) < 2:
        return Verdict(fits=True, reason="one gear only on the move")
    rising = np.diff(list(found.values())) > 0
    return Verdict(
        fits=float(np.mean(rising)) < 0.5,
        reason="engine speed over speed "
        + ", ".join(f"{one:.1f} in {gear}" for gear, one in found.items()),
    )


def _clutch_open(judge: Judge, value: Series) -> Verdict:
    """Gears change with the clutch open; closed, engine and car are one."""
    motion, known = judge.motion, judge.known
    on = value > 0.5
    words, fits = [], False
    if "gear" in known:
        steps = np.flatnonzero(np.abs(np.diff(known["gear"])) > 0.0)
        near = np.zeros(len(on), np.bool_)
        reach = round(_SHIFT_S / motion.step_s)
        for step in steps.tolist():
            near[max(step - reach, 0) : step + reach] = True
        here, else_ = near & motion.moving, ~near & motion.moving
        if here.any() and else_.any():
            at_shifts, between = (
                float(on[here].mean()),
                float(on[else_].mean()),
            )
            fits = at_shifts > max(0.3, 2.0 * between)
            words.append(
                f"open {100 * at_shifts:.0f} % of the time around gear "
                f"changes, {100 * between:.0f} % else"
            )
    if "engine_speed" in known and not fits:
        engine = np.log(np.maximum(known["engine_speed"], _IDLE_RAD_S))
        speed = np.log(np.maximum(motion.speed_ms, 1.0))
        slip = motion.smooth(engine - speed)
        slip_1_s = np.abs(np.gradient(slip, motion.step_s))
        here, else_ = on & motion.moving, ~on & motion.moving
        if min(judge.seconds(here), judge.seconds(else_)) > _ENOUGH_S:
            slipping = float(np.median(slip_1_s[here]))
            coupled = float(np.median(slip_1_s[else_]))
            fits = slipping > max(0.05, 3.0 * coupled)
            words.append(
                f"engine and wheels part by {slipping:.2f} a second while it "
                f"is open, {coupled:.2f} else"
            )
    none = "no change of gear or engine speed to check it with"
    return Verdict(fits=fits, reason="; ".join(words) or none)


def _torque(judge: Judge, value: Series) -> Verdict:
    """Torque at the wheels accelerates the car's mass."""
    motion = judge.motion
    _, _, pressed = judge.braking()
    here = motion.moving & ~pressed
    x, y = motion.smooth(value)[here], motion.change_ms2[here]
    if judge.seconds(here) < _BENDS_S or min(np.std(x), np.std(y)) == 0.0:
        return Verdict(fits=True, reason="too little driving to check it with")
    r = float(np.corrcoef(x, y)[0, 1])
    mass = float(np.std(x) / np.std(y)) / judge.radius_m
    return Verdict(
        fits=r > _FOLLOWS,
        reason=f"dv/dt follows it with r = {r:.2f}, as of {mass:.0f} kg if at "
        "the wheels",
        proven=r > _ALONG and _AT_WHEELS_KG[0] < mass < _AT_WHEELS_KG[1],
    )


def _wheel_torque(judge: Judge, value: Series) -> Verdict:
    found = _torque(judge, value)
    if "kg" not in found.reason:
        return found
    return replace(found, fits=found.proven)


def _yaw_rate(judge: Judge, value: Series) -> Verdict:
    """To the left, the right wheels are the faster ones by yaw times track."""
    known, motion = judge.known, judge.motion
    pairs = [
        known[f"wheel_speed_{axle}r"] - known[f"wheel_speed_{axle}l"]
        for axle in "fr"
        if {f"wheel_speed_{axle}r", f"wheel_speed_{axle}l"} <= known.keys()
    ]
    here = motion.moving & (np.abs(value) > _TURNING_RAD_S)
    if not pairs or judge.seconds(here) < _BENDS_S:
        return Verdict(fits=True, reason="no bends of wheels to compare with")
    x = motion.smooth(value)[motion.moving]
    y = motion.smooth(np.mean(pairs, axis=0))[motion.moving]
    r = float(np.corrcoef(x, y)[0, 1])
    track = float(np.std(y) / np.std(x))
    words = f"right minus left wheels is {np.sign(r) * track:.2f} m x value"
    if abs(r) < _FOLLOWS:
        return Verdict(fits=True, reason=f"{words}, r = {r:.2f}: not clear")
    if r < 0:
        words += ": positive to the right"
    fits = _TRACK_M[0] < track < _TRACK_M[1]
    return Verdict(fits=fits, reason=words, sign=1 if r > 0 else -1)


def _lateral(judge: Judge, value: Series) -> Verdict:
    """Speed times yaw rate; what follows dv/dt lies along the car."""
    motion = judge.motion
    column, moving = motion.smooth(value), motion.moving
    if judge.seconds(moving) > _BENDS_S and np.std(column[moving]) > 0.0:
        along = float(
            np.corrcoef(column[moving], motion.change_ms2[moving])[0, 1]
        )
        if abs(along) > _ALONG:
            words = f"follows dv/dt with r = {along:.2f}: it is along the car"
            return Verdict(fits=False, reason=words)
    yaw = judge.known.get("yaw_rate")
    if yaw is None:
        return Verdict(fits=True, reason="no yaw rate to compare it with")
    here = moving & (np.abs(yaw) > _TURNING_RAD_S)
    if judge.seconds(here) < _BENDS_S or np.std(column[here]) == 0.0:
        return Verdict(fits=True, reason="no bends to compare it in")
    r = float(
        np.corrcoef(column[moving], (yaw * motion.speed_ms)[moving])[0, 1]
    )
    words = f"follows v x yaw rate with r = {r:.2f}"
    if abs(r) < _FOLLOWS:
        return Verdict(fits=True, reason=f"{words}: not clear")
    return Verdict(fits=True, reason=words, sign=1 if r > 0 else -1)


_SPECIAL: Final[dict[str, Callable[[Judge, Series], Verdict]]] = {
    "brake_switch": _brake_switch,
    "park_brake": _park_brake,
    "abs_active": _intervention,
    "esc_active": _intervention,
    "tc_active": _intervention,
    "ignition": _ignition,
    "gear": _gear,
    "clutch_open": _clutch_open,
    "powertrain_torque": _wheel_torque,
    "motor_torque": _torque,
    "engine_torque": _torque,
    "yaw_rate": _yaw_rate,
    "acceleration_lateral": _lateral,
}
