"""What a match changes in the configuration, each value saying its origin."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.tunables import EFFECT, split_key

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.config.sections import Config


def changes_of(
    matches: Sequence[Match], config: Config, origin: str
) -> list[Change]:
    """Return what *matches* change in *config*, each saying *origin*.

    A value goes where the configuration has it: to ``[thermal]`` or
    ``[cooling]`` where every corner that reads it there was matched alike,
    else to the corners themselves.
    """
    changes = []
    for match in matches:
        for key, value in match.settings().items():
            section, name = split_key(key)
            sd = match.deviation(key)
            note = origin if isnan(sd) else f"{origin}, sd {sd:.2g}"
            if key == "cooling.s_per_s":
                note = f"{origin}, sd {100.0 * sd:.2g} %"
            if section == EFFECT:
                changes += _of_effect(name, value, note, config, match)
                continue
            if section in {"vehicle", "heat"}:
                changes.append(Change(section, name, value, note=note))
                continue
            if section in {"thermal", "cooling"} and _shared(
                section, name, config, match.corners
            ):
                changes.append(Change(section, name, value, note=note))
                continue
            changes += [
                Change("corner", key, value, corner, note)
                for corner in match.corners
            ]
    changes += _accuracy(matches, origin)
    return changes


def _of_effect(
    name: str, value: float, note: str, config: Config, match: Match
) -> list[Change]:
    """Return entries of ``[[effect]]``: one for all corners, or each its."""
    effect, parameter = split_key(name)
    every = {corner.name for corner in config.disc_corners()}
    corners = ("all",) if set(match.corners) == every else match.corners
    return [
        Change(EFFECT, parameter, value, corner, note, effect)
        for corner in corners
    ]


def _shared(
    section: str, name: str, config: Config, matched: Sequence[str]
) -> bool:
    """Whether only matched corners read the value of the section itself."""
    readers = {
        corner.name
        for corner in config.disc_corners()
        if name not in getattr(corner, section)
    }
    return readers == set(matched)


def _accuracy(matches: Sequence[Match], origin: str) -> list[Change]:
    """Return ``[accuracy]``: the largest of the matched corners."""
    changes = []
    for node in ("disc", "pad_front", "pad_back", "fluid"):
        found = [
            (one.floor_k, one.share, match.accuracy.left_out)
            for match in matches
            if (one := match.accuracy.nodes.get(node)) is not None
        ]
        if not found:
            continue
        floor, share, left_out = max(found)
        note = f"{origin}, residual on what was left out"
        if not left_out:
            note = f"{origin}, residual on the drive itself: too small"
        changes += [
            Change("accuracy", f"{node}_k", floor, note=note),
            Change("accuracy", f"{node}_share", share, note=note),
        ]
    return changes
