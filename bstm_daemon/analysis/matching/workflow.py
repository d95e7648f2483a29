"""A match of recorded drives from first guess to last fit."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bstm_daemon.analysis.identify.driving import read_drivings
from bstm_daemon.analysis.identify.guessed import (
    identified_guesses,
    with_changes,
)
from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.coarse import (
    Reading,
    read_as_guessed,
    read_with_fade,
)
from bstm_daemon.analysis.matching.drives import Drive, read_drives
from bstm_daemon.analysis.matching.matcher import Match, match_drives
from bstm_daemon.analysis.matching.tunables import DRAG, Target
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.model.effects.catalogue import effects_of


class Matched(NamedTuple):
    """The matches, of ``config`` as the forces changed it before.

    ``by_forces`` are those changes, ``why_not`` why there are no others.
    """

    config: Config
    matches: list[Match]
    by_forces: list[Change]
    why_not: list[str]


def match_logs(  # noqa: PLR0913
    logs: Sequence[Path],
    config: Config,
    signal_map: SignalMap,
    guessed: frozenset[str] = frozenset(),
    *,
    overrides: Mapping[str, str] | None = None,
    only: str = "",
    each: bool = False,
    beside: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Matched:
    """Match *config* to *logs*, what is guessed of the forces first.

    Args:
        logs: drives with measured temperatures, in the order driven.
        config: the vehicle.
        signal_map: its extraction plan.
        guessed: keys whose configured values nobody has measured.
        overrides: interface of a log to the name of its bus.
        only: ``cooling`` for what another rim changes, else everything.
        each: match corners by themselves that are configured alike.
        beside: fit Table 4.1 alone, for comparison.
        progress: called with the share of a stage that is done.

    Raises:
        LogError: a log can not be used, or no corner has a thermocouple.
    """
    by_forces, why_not = identified_guesses(
        config,
        guessed,
        lambda: read_drivings(logs, config, signal_map, overrides, progress),
    )
    config = with_changes(config, by_forces)
    guessed -= {f"{one.section}.{one.key}" for one in by_forces}

    def drives_of(config: Config) -> list[Drive]:
        return read_drives(logs, config, signal_map, overrides, progress)

    def readings(
        of: Config, guessed: frozenset[str], near_m2: Sequence[float] = ()
    ) -> list[Reading]:
        return read_as_guessed(of, guessed, drives_of, near_m2)

    def matches(readings: list[Reading], *, last: bool) -> list[Match]:
        return match_drives(
            config,
            readings,
            guessed=guessed,
            only=only,
            each=each,
            beside=beside and last,
            progress=progress,
        )

    again = _follows_temperature(config)
    found = matches(readings(config, guessed), last=not again)
    near_m2 = [
        one.joint.values[DRAG] for one in found if DRAG in one.joint.values
    ]
    if near_m2:
        found = matches(readings(config, guessed, near_m2), last=True)
    if again:
        # friction is that at the temperatures of the matched model
        as_matched = _with_values(config, found)
        (reading,) = readings(as_matched, frozenset())
        if not only:
            linings = {one.before.linings for one in found}
            reading = read_with_fade(
                *(reading, as_matched, sorted(linings), drives_of)
            )
        found = matches([reading], last=True)
    return Matched(config, found, by_forces, why_not)


def _follows_temperature(config: Config) -> bool:
    """Whether heat comes from pressure by a friction that knows fade."""
    laws = [
        corner_model(config, one).friction for one in config.disc_corners()
    ]
    return config.heat.mode != "fb" and any(
        set(law.temperature) != {1.0} for law in laws
    )


def _with_values(config: Config, matches: list[Match]) -> Config:
    """Return *config* with what *matches* found and added."""
    for match in matches:
        after = match.after.config
        there = {one.name for one in effects_of(config)}
        added = [
            one
            for one in after.effect
            if one.corner in match.corners and one.name not in there
        ]
        config = config.model_copy(update={"effect": [*config.effect, *added]})
        config = (
            Target(config, match.corners).changed(match.joint.values).config
        )
        # its factors on the cooling are of the table that a search found
        own = {one.name: one for one in after.corner}
        corners = [
            own[one.name] if one.name in match.corners else one
            for one in config.corner
        ]
        config = config.model_copy(update={"corner": corners})
    return config
