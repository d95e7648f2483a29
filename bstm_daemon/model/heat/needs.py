"""Inputs that a heat mode needs of a recorded drive.

The estimator continues without speed or pressure, as it must in a car, and
marks the result as degraded. A comparison with measurements would attribute
the difference to something else, so it refuses such a drive.
"""

from collections.abc import Container, Iterable
from typing import Final

from bstm_daemon.errors import LogError
from bstm_daemon.roles import GROUND_SPEED_ROLES, ROLES

INPUTS: Final = {
    "ff": ("speed", "pressure"),
    "fb": ("speed",),
    "fused": ("speed", "pressure"),
    "measured": ("speed", "pressure"),
}
"""Inputs without which a heat mode has to make assumptions."""


def check_inputs(
    log: str,
    seen: Container[int],
    mapped: Iterable[int],
    names: Iterable[str],
    user: str,
) -> None:
    """Refuse *log* where all roles of an input are *mapped* and none *seen*.

    Both are numbers of roles; *names* are of :data:`INPUTS`, *user* is what
    needs them.

    Raises:
        LogError: an input is missing.
    """
    # a speed over ground only checks
    mapped = sorted(set(mapped).difference(GROUND_SPEED_ROLES))
    for name in names:
        own = [n for n in mapped if name in ROLES[n].quantities]
        if own and not any(n in seen for n in own):
            roles = ", ".join(ROLES[n].name for n in own)
            msg = (
                f"{log}: no {name} in this log (roles {roles}), which {user} "
                "needs"
            )
            raise LogError(msg)


def check_heat_inputs(
    log: str, seen: Container[int], mapped: Iterable[int], heat_mode: str
) -> None:
    """Refuse *log* if an input that *heat_mode* needs is missing.

    Raises:
        LogError: an input is missing.
    """
    user = f'heat mode "{heat_mode}"'
    check_inputs(log, seen, mapped, INPUTS[heat_mode], user)
