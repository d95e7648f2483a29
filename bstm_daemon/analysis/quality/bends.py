"""Bends: their rule, and that the outer wheel is the faster one in them."""

from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.finding import Checks
from bstm_daemon.analysis.statistics.series import Column, running_mean

_AXLES: Final = (
    ("front", "wheel_speed_fl", "wheel_speed_fr"),
    ("rear", "wheel_speed_rl", "wheel_speed_rr"),
)


def fit_in_bends(
    yaw_rad_s: Column,
    speed_ms: Column,
    channel: Column,
    floor: float,
    step_s: float = limits.GRID_S,
) -> Fit | None:
    """Fit *channel* to *yaw_rad_s*, or to what is made of it, in bends.

    The one rule by which ``init`` chooses and ``check`` judges wheels, yaw
    rate and lateral acceleration by each other.

    Args:
        yaw_rad_s: the reference, (n,), NaN where absent.
        speed_ms: of the car, (n,).
        channel: what is to follow it, (n,).
        floor: of :func:`fit_channels`.
        step_s: of all three; a lag is sought on the usual grid only.

    Returns:
        The fit where the car goes forward; None where that is too little.
    """
    half = round(0.5 * limits.BEND_SMOOTH_S / step_s)
    forward = speed_ms > limits.BEND_MS
    x, y = (
        running_mean(np.where(forward, one, np.nan), half)[0]
        for one in (yaw_rad_s, channel)
    )
    return fit_channels(
        *(x, y, floor, forward), lagged=step_s == limits.GRID_S
    )


def follows_bends(fit: Fit | None) -> bool:
    """Whether *fit* shows one motion."""
    return fit is not None and abs(fit.correlation) >= limits.SIDE_CORRELATION


def compare_sides(channels: Checks) -> None:
    """Compare the wheels' differences with the yaw rate.

    Yaw rate is positive to the left, so right minus left is yaw rate times
    track. One axle with the opposite sign has its wheels swapped; both axles
    may as well be a yaw rate that counts the other way.
    """
    pairs = [
        (name, left, right)
        for name, left, right in _AXLES
        if len(channels.alive((left, right))) == 2
    ]
    if not pairs:
        return
    if not channels.alive(["yaw_rate"]):
        channels.skip(
            "left and right wheels: no yaw rate, swapping is not detected"
        )
        return
    yaw = channels.value("yaw_rate")
    turning = np.abs(yaw) > limits.YAW_SPREAD_RAD_S
    turning &= channels.speed > limits.BEND_MS
    if np.count_nonzero(turning) * limits.GRID_S < limits.ENOUGH_S:
        channels.skip(
            "left and right wheels: hardly a bend in this log, swapping is "
            "not detected"
        )
        return
    signs: dict[str, tuple[float, tuple[str, str]]] = {}
    for name, left, right in pairs:
        difference = channels.value(right) - channels.value(left)
        fit = fit_in_bends(
            yaw, channels.speed, difference, limits.SPEED_FLOOR_MS
        )
        clear = (
            fit is not None
            and follows_bends(fit)
            and abs(fit.scale_low) < limits.WIDEST_TRACK_M
        )
        verdict = "not judged: the difference does not follow the yaw rate"
        agrees = None
        if fit is not None and clear:
            signs[name] = (fit.scale, (left, right))
            agrees = fit.scale > 0.0
            verdict = (
                f"agrees, track {fit.scale:.2f} m" if agrees else "swapped"
            )
        else:
            channels.skip(f"left and right {name} wheels: {verdict[12:]}")
        channels.compare(
            f"{name} wheels, right minus left, against yaw rate",
            ("yaw rate", f"{right} - {left}"),
            (yaw, difference),
            (verdict, agrees, fit),
            "rad/s, m/s",
        )
    _name_swapped(channels, signs)


def _name_swapped(
    channels: Checks, signs: dict[str, tuple[float, tuple[str, str]]]
) -> None:
    turned = {name for name, (scale, _) in signs.items() if scale < 0.0}
    if not turned:
        return
    if len(turned) == len(signs):
        wheels = tuple(w for _, pair in signs.values() for w in pair)
        channels.fault(
            "swapped",
            ("yaw_rate", *wheels),
            "left and right wheels swapped, or the yaw rate is positive "
            "to the right: the right wheels are the faster ones as it "
            "goes negative",
            wrong=False,
        )
        return
    for name in sorted(turned):
        channels.fault(
            "swapped",
            signs[name][1],
            f"left and right {name} wheels are swapped: the inner one "
            "is the faster in bends, the other axle is right",
        )


def compare_axles(channels: Checks) -> None:
    """Compare front with rear wheels in tight bends.

    The front axle runs on the larger circle, ``v_f^2 = v_r^2 + (yaw L)^2``
    with the wheelbase L; a share of ``v^2`` takes up unequal tyres.
    """
    wheels = [wheel for _, left, right in _AXLES for wheel in (left, right)]
    if len(channels.alive(wheels)) < 4:
        return
    subject = "front and rear wheels"
    if not channels.alive(["yaw_rate"]):
        channels.skip(f"{subject}: no yaw rate, swapping is not detected")
        return
    fl, fr, rl, rr = (channels.value(wheel) for wheel in wheels)
    front, rear = 0.5 * (fl + fr), 0.5 * (rl + rr)
    yaw = channels.value("yaw_rate")
    excess = front**2 - rear**2
    known = np.isfinite(excess) & np.isfinite(yaw) & (rear > limits.MOVING_MS)
    tight = known & (np.abs(yaw) > limits.TIGHT_YAW_RAD_S)
    if np.count_nonzero(tight) * limits.GRID_S < limits.ENOUGH_S:
        channels.skip(
            f"{subject}: no tight bend in this log, swapping is not detected"
        )
        return
    # medians: in a bend one axle may spin or slide
    straight = known & (np.abs(yaw) < limits.YAW_SPREAD_RAD_S)
    share = np.median(excess[straight] / rear[straight] ** 2)
    turned = excess[tight] - np.nan_to_num(share) * rear[tight] ** 2
    wheelbase2 = float(np.median(turned / yaw[tight] ** 2))
    same = float(np.mean(np.sign(turned) == np.sign(wheelbase2)))
    clear = same >= limits.SAME_SIGN and 1.0 < abs(wheelbase2) < 36.0
    if not clear:
        channels.skip(
            f"{subject}: no difference in bends, swapping is not detected"
        )
    elif wheelbase2 < 0.0:
        channels.fault(
            "swapped",
            tuple(wheels),
            "front and rear wheels are swapped: the rear ones run on "
            "the larger circle in bends",
        )
