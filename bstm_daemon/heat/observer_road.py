"""The road as it is felt: its grade, and its height against the bias."""

from __future__ import annotations

from math import exp, isnan, sqrt
from typing import TYPE_CHECKING

from bstm_daemon.heat import observer_rules as rules
from bstm_daemon.heat.learned import BIAS, GAIN, clipped
from bstm_daemon.heat.observer_doubts import strange_gain
from bstm_daemon.heat.observer_layout import STATES
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.heat.learned import Learned
    from bstm_daemon.heat.observer_layout import Step


def follow_grade(
    m: dict[str, float], known: Learned, rolling: float, s: Step
) -> None:
    """Filter the sine of the road; learn bias and g f_r from its height.

    *rolling* is the configured g f_r [m/s2]. The balance of forces tells the
    bias less g f_r; the height that was climbed tells the bias alone.
    """
    bias = known.x[BIAS] + rolling + known.rolling_error
    gain = 1.0 + known.x[GAIN]
    upward = m["felt"] - gain * m["rate"] - bias
    sine = clipped(upward / GRAVITY_MS2, -0.5, 0.5)
    m["sine"] += (1.0 - exp(-s.dt_s / rules.GRADE_S)) * (sine - m["sine"])
    if isnan(s.height) or m["external_held_s"] > 0.0 or strange_gain(m):
        m["height_path"] = 0.0
        return
    if m["height_path"] <= 0.0:
        m["height_last"] = s.height
        m["height_work"] = 0.0
    path = s.speed * s.dt_s
    m["height_work"] += (upward + known.rolling_error) * path
    m["height_path"] += path
    if m["height_path"] < rules.HEIGHT_PATH_M:
        return
    climbed = GRAVITY_MS2 * (s.height - m["height_last"])
    error = (m["height_work"] - climbed) / m["height_path"]
    sd = 1.5 * GRAVITY_MS2 * rules.HEIGHT_NOISE_M / m["height_path"]
    apart = error - known.rolling_error
    rolling_var = known.rolling_var
    spread = known.cov[BIAS * STATES + BIAS] + rolling_var + sd * sd
    m["height_path"] = 0.0
    if abs(apart) > rules.OUTLIER * sqrt(spread):
        return
    # who is surer of himself moves less; without torque the bias is free
    h = [0.0] * STATES
    h[BIAS] = 1.0
    known.update(0, h, apart, rolling_var + sd * sd)
    share = rolling_var / spread
    known.rolling_error += share * apart
    known.rolling_var *= 1.0 - share
    known.rolling_var += 1e-6
