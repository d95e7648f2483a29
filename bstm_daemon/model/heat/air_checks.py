"""Checks of the air temperature: its lowest code, and its own history.

The pure-Python form of what ``native/heat/checks.c`` does; both do the same
operations in the same order.
"""

from __future__ import annotations

from math import isnan

from bstm_daemon.model.heat.check_rules import (
    AIR_FALL_K_S,
    AIR_FELL,
    AIR_FELL_K,
    AIR_NIGHT_K_S,
    LOWEST_CODE,
    LOWEST_CODE_K,
    LOWEST_CODE_WITHIN_K,
)
from bstm_daemon.model.heat.memory import CheckMemory
from bstm_daemon.model.heat.readings import Readings


def compare_air(m: CheckMemory, now: Readings) -> None:
    """Follow the air through a step."""
    failed = None
    if not isnan(now.ambient_k):
        above_k = now.ambient_k - LOWEST_CODE_K
        failed = abs(above_k) < LOWEST_CODE_WITHIN_K
    m.lowest_code_s = LOWEST_CODE.advance(
        m.lowest_code_s, now.dt_s, failed=failed
    )
    failed = None
    if isnan(now.ambient_k):
        m.air_k -= AIR_NIGHT_K_S * now.dt_s
    else:
        if m.air_fault_s < AIR_FELL.comes_s:
            m.air_k -= AIR_FALL_K_S * now.dt_s
        m.air_k = max(m.air_k, now.ambient_k)
        failed = now.ambient_k < m.air_k - AIR_FELL_K
    m.air_fault_s = AIR_FELL.advance(m.air_fault_s, now.dt_s, failed=failed)


def air_suspect(m: CheckMemory) -> bool:
    """Whether the air may be warmer than it reads."""
    return (
        m.lowest_code_s >= LOWEST_CODE.comes_s
        or m.air_fault_s >= AIR_FELL.comes_s
    )
