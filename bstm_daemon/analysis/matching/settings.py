"""Matched values as changes of the configuration file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.tunables import EFFECT, split_key

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.config.sections import Config, CornerConfig


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
            section, name = key.split(".", maxsplit=1)
            sd = match.deviation(key)
            note = f"{origin}, sd {sd:.2g}"
            if isinstance(value, tuple):
                note = f"{origin}, sd {100.0 * sd:.2g} %"
            if section == EFFECT:
                changes += _of_effect(name, value, note, config, match)
                continue
            own = [
                corner
                for corner in config.corner
                if corner.name in match.corners
            ]
            if section in {"thermal", "cooling"} and _shared(
                section, name, config, match.corners
            ):
                changes.append(Change(section, name, value, note=note))
                continue
            changes += [
                Change("corner", key, value, corner.name, note)
                for corner in own
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
        if name not in _overrides(corner, section)
    }
    return readers == set(matched)


def _overrides(corner: CornerConfig, section: str) -> dict[str, Any]:
    return corner.thermal if section == "thermal" else corner.cooling


def _accuracy(matches: Sequence[Match], origin: str) -> list[Change]:
    """Return ``[accuracy]``: the largest of the matched corners."""
    changes = []
    nodes: dict[str, list[tuple[float, float, int]]] = {}
    for match in matches:
        for node, one in match.accuracy.nodes.items():
            nodes.setdefault(node, []).append(
                (one.floor_k, one.share, match.accuracy.drives)
            )
    for node in ("disc", "pad_front", "pad_back", "fluid"):
        if node not in nodes:
            continue
        floor, share, drives = max(nodes[node])
        note = f"{origin}, left over on held-out drives"
        if not drives:
            note = f"{origin}, left over on the drive itself: too small"
        changes += [
            Change("accuracy", f"{node}_k", floor, note=note),
            Change("accuracy", f"{node}_share", share, note=note),
        ]
    return changes
