"""What forces alone show of a guessed car, before temperatures are matched.

Coast-downs give the resistances, stops the friction of the brakes: neither
needs a thermocouple, and what they settle the match need not guess. Only
guesses are replaced; a value that somebody measured stays.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from bstm_daemon.analysis.identify.brakes import identify_brakes
from bstm_daemon.analysis.identify.coastdown import NAMES, identify_coast_down
from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.identify.writing import (
    Change,
    brake_changes,
    coast_down_changes,
)
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError

BY_COASTING: Final = frozenset(f"vehicle.{name}" for name in NAMES)
BY_STOPS: Final = frozenset(
    {
        "corner.friction_coefficient",
        "corner.drum_brake_factor",
        "vehicle.front_share",
    }
)
BY_FORCES: Final = BY_COASTING | BY_STOPS


def identified_guesses(
    config: Config,
    guessed: frozenset[str],
    read: Callable[[], Sequence[Driving]],
) -> tuple[list[Change], list[str]]:
    """Identify what is *guessed* of *config* from coast-downs and stops.

    Args:
        config: the car as configured.
        guessed: keys whose values are guesses, ``section.key``.
        read: gives the drives; called only if anything can be identified.

    Returns:
        The changes of guessed keys, and in words why there are no others.
    """
    wanted = []
    if guessed & BY_COASTING:
        wanted.append((_coasting, BY_COASTING))
    if guessed & BY_STOPS and any("pressure" in one for one in config.signals):
        wanted.append((_stops, BY_STOPS))
    if not wanted:
        return [], []
    changes: list[Change] = []
    remarks = []
    try:
        drivings = read()
    except LogError as error:
        return [], [str(error)]
    for identify, keys in wanted:
        try:
            found = identify(drivings, config)
        except LogError as error:
            remarks.append(str(error))
            continue
        changes += [
            one
            for one in found
            if f"{one.section}.{one.key}" in guessed & keys
        ]
    return changes, remarks


def _coasting(drivings: Sequence[Driving], config: Config) -> list[Change]:
    return coast_down_changes(identify_coast_down(drivings, config))


def _stops(drivings: Sequence[Driving], config: Config) -> list[Change]:
    found = identify_brakes(drivings, config)
    # a weak law would hide from a search that the real one is missing
    bare = replace(found, lean_speed=None, lean_pressure=None)
    return brake_changes(bare, config)


def with_changes(config: Config, changes: Sequence[Change]) -> Config:
    """Return *config* with *changes* of ``[vehicle]`` and of corners."""
    of_car: dict[str, Any] = {}
    of_corner: dict[str, dict[str, Any]] = {}
    for one in changes:
        own = of_corner.setdefault(one.corner, {}) if one.corner else of_car
        own[one.key] = one.rounded()
    corners = [
        corner.model_copy(update=of_corner.get(corner.name, {}))
        for corner in config.corner
    ]
    vehicle = config.vehicle.model_copy(update=of_car)
    return config.model_copy(update={"vehicle": vehicle, "corner": corners})
