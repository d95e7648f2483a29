"""What speaks against the observer's inputs, as its memory shows it.

Each is named and learned from by nobody: an accelerometer of a wrong scale,
a wheel radius that is not that of the satellites, a pressure that never is.
"""

from __future__ import annotations

from math import exp, isnan
from typing import TYPE_CHECKING

from bstm_daemon.heat import observer_rules as rules

if TYPE_CHECKING:
    from bstm_daemon.heat.learned import Learned
    from bstm_daemon.heat.observer_layout import Step

    Memory = dict[str, float]


def doubts(m: Memory) -> int:
    """Return the bits of what is in doubt."""
    found = 0
    if m["external_held_s"] > 0.0:
        found |= rules.EXTERNAL_SUSPECTED
    if strange_gain(m):
        found |= rules.GAIN_SUSPECT
    if strange_radius(m):
        found |= rules.RADIUS_SUSPECT
    if m["unpressed_s"] > rules.DEAD_S:
        found |= rules.PRESSURE_DEAD
    return found


def strange_gain(m: Memory) -> bool:
    """Whether what is felt is not the change of speed in its size."""
    changed, alike = m["changed"], m["alike"]
    return changed > rules.CHANGED_LEAST and (
        alike < rules.GAIN_LOW * changed or alike > rules.GAIN_HIGH * changed
    )


def strange_radius(m: Memory) -> bool:
    """Whether wheels and satellites disagree on the speed."""
    return abs(m["radius_ratio"] - 1.0) > rules.RADIUS_LIMIT


def unfelt(m: Memory) -> bool:
    """Whether changes of speed are not felt: wheels on a stand."""
    changed = m["changed"]
    return (
        changed > rules.CHANGED_LEAST and m["alike"] < rules.UNFELT * changed
    )


def compare_radius(m: Memory, s: Step) -> None:
    """Follow the wheels' speed over that of the satellites."""
    if (
        isnan(s.gnss_speed)
        or s.gnss_speed < rules.REFERENCE_SPEED_MS
        or not s.steady
    ):
        return
    share = 1.0 - exp(-s.dt_s / rules.RADIUS_S)
    m["radius_ratio"] += share * (s.speed / s.gnss_speed - m["radius_ratio"])


def watch_pressure(m: Memory, known: Learned, s: Step) -> None:
    """Count hard braking again and again without pressure, ever."""
    if s.brake_n > 0.0:
        m["unpressed_s"] = 0.0
        return
    braking, spread = known.braking(m["felt"], s.push, s.drag, m["rate"])
    if (
        s.brake_switch != 0.0
        and s.torque_known
        and s.pressure_known
        and s.steady
        and s.speed > rules.LEAST_SPEED_MS
        and -m["rate"] > rules.DEAD_MS2
        and braking - 2.5 * spread > rules.DEAD_MS2
    ):
        m["unpressed_s"] += s.dt_s
