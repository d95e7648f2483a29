"""Which corners are matched together."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from bstm_daemon.analysis.matching.effect_values import effect_value
from bstm_daemon.analysis.matching.tunables import FADE_STRENGTH, Target
from bstm_daemon.errors import LogError
from bstm_daemon.model.effects.catalogue import effects_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.config.sections import Config

T = TypeVar("T")


def targets_of(
    config: Config,
    measured: Sequence[str],
    *,
    each: bool = False,
    guessed: frozenset[str] = frozenset(),
) -> list[Target]:
    """Return the corners with thermocouples, those alike together.

    A right and a left corner of one axle are alike where their disc, pads
    and models are configured the same; with *each* none are. One without a
    thermocouple gets what is found of the other.
    """
    groups: dict[str, list[str]] = {}
    for corner in config.disc_corners():
        looks = corner.model_dump(
            exclude={
                "name": True,
                "side": True,
                "axle": True,
                "circuit": True,
                "friction_coefficient": True,
                # what wear starts from, no part of the model
                "pad": {"new_thickness_m", "measured"},
            }
        )
        looks["effect"] = {
            one.name: dict(one.parameters)
            for one in effects_of(config)
            if one.corner in {"all", corner.name}
        }
        group = corner.name if each else repr(looks)
        groups.setdefault(group, []).append(corner.name)
    held = {
        own: tuple(
            name
            for name in names
            if name not in measured and name[0] in {one[0] for one in own}
        )
        for names in groups.values()
        if (own := tuple(name for name in names if name in measured))
    }
    return [
        Target(
            *(config, own, guessed),
            linings=_linings(config, own, [*held]),
            alike=alike,
        )
        for own, alike in held.items()
    ]


def _linings(
    config: Config, own: tuple[str, ...], groups: Sequence[tuple[str, ...]]
) -> tuple[str, ...]:
    """Return the corners that have linings as *own*, one of *groups*, have.

    A corner without a thermocouple has those of its axle, else of the first
    group, if it is configured to fade like them.
    """

    def fade(corner: str) -> float:
        return effect_value(config, corner, FADE_STRENGTH)

    found = []
    for corner in config.disc_corners():
        holds = [one for one in groups if corner.name in one]
        axle = [one for one in groups if one[0].startswith(corner.name[0])]
        first = [*holds, *axle, *groups][0]
        if own == first and (holds or fade(corner.name) == fade(first[0])):
            found.append(corner.name)
    return tuple(found)


def measured_targets(
    config: Config,
    drives: Sequence[Drive],
    *,
    each: bool = False,
    guessed: frozenset[str] = frozenset(),
) -> list[Target]:
    """Return :func:`targets_of` the corners that *drives* measure.

    Raises:
        LogError: no corner has a thermocouple.
    """
    measured = {corner for drive in drives for corner in drive.measured}
    targets = targets_of(config, sorted(measured), each=each, guessed=guessed)
    if not targets:
        names = ", ".join(drive.name for drive in drives)
        msg = (
            f"{names}: no measured temperature of a disc brake: this needs "
            "roles temp_<corner>_<node>"
        )
        raise LogError(msg)
    return targets


def over_targets(
    targets: Sequence[Target],
    work: Callable[[Target, Callable[[float], None]], T],
    progress: Callable[[float], None] | None,
) -> list[T]:
    """Return what *work* makes of each target and its share of *progress*."""
    found = []
    for number, target in enumerate(targets):

        def show(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(targets))

        found.append(work(target, show))
        show(1.0)
    return found
