"""What a match changes in the configuration, each value saying its origin."""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

import numpy as np

from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.effect_values import split_key
from bstm_daemon.analysis.matching.learned import (
    entry,
    known_covariance,
    known_keys,
    short,
)
from bstm_daemon.analysis.matching.matcher import Match
from bstm_daemon.analysis.matching.tunables import EFFECT, FADE
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.sections import Config


def changes_of(
    matches: Sequence[Match], config: Config, origin: str
) -> list[Change]:
    """Return what *matches* change in *config*, each saying *origin*."""
    changes = []
    for match in matches:
        settings = match.settings()
        corners = (*match.corners, *match.after.alike)
        notes = {}
        for key in settings:
            sd = match.deviation(key)
            notes[key] = origin if isnan(sd) else f"{origin}, sd {sd:.2g}"
            if key == "cooling.s_per_s":
                notes[key] = f"{origin}, sd {100.0 * sd:.2g} %"
        changes += value_changes(
            *(settings, notes, config, corners, match.after.linings)
        )
    changes += _accuracy(matches, origin)
    # what is the car's own, each of its matches says
    return list(dict.fromkeys(changes))


def learned(match: Match) -> MatchedConfig:
    """Return the table of *match*.

    What it did not fit stays as known as it was.
    """
    joint = match.joint
    covariance = joint.misfit * joint.covariance
    if len(match.accuracy.shifts):
        shifts = match.accuracy.shifts
        covariance = covariance + shifts.T @ shifts / len(shifts)
    beyond = np.sqrt(np.diag(covariance)) / joint.prior
    scale = 1.0 / np.maximum(beyond, 1.0)
    others = [key for key in known_keys(match.after) if key not in joint.keys]
    keys = [*joint.keys, *others]
    whole = known_covariance(match.after, keys)
    count = len(joint.keys)
    whole[:count], whole[:, :count] = 0.0, 0.0
    whole[:count, :count] = covariance * np.outer(scale, scale)
    return entry(
        match.after,
        keys,
        whole,
        MatchedConfig(
            corners=list(match.corners),
            alike=list(match.after.alike),
            names=[],
            values=[],
            factor=[],
            form_k={n: short(a.floor_k) for n, a in match.form.items()},
            form_share={n: short(a.share) for n, a in match.form.items()},
            drives=len(match.drives),
            left_out=match.accuracy.left_out,
        ),
    )


def value_changes(
    settings: Mapping[str, Any],
    notes: Mapping[str, str],
    config: Config,
    corners: Sequence[str],
    linings: Sequence[str] = (),
) -> list[Change]:
    """Return *settings* of *corners*, each with its note.

    The fade is that of *linings*, if there are any.

    A value goes where the configuration has it: to ``[thermal]`` or
    ``[cooling]`` where only *corners* read it there, else to the corners
    themselves.
    """
    changes = []
    for key, value in settings.items():
        section, name = split_key(key)
        note = notes[key]
        if section == EFFECT:
            of = linings if key == FADE and linings else corners
            changes += _of_effect(name, value, note, config, of)
        elif section in {"vehicle", "heat"} or (
            section in {"thermal", "cooling"}
            and _shared(section, name, config, corners)
        ):
            changes.append(Change(section, name, value, note=note))
        else:
            changes += [
                Change("corner", key, value, corner, note)
                for corner in corners
            ]
    return changes


def _of_effect(
    name: str, value: float, note: str, config: Config, matched: Sequence[str]
) -> list[Change]:
    """Return entries of ``[[effect]]``: one for all corners, or each its."""
    effect, parameter = split_key(name)
    every = {corner.name for corner in config.disc_corners()}
    corners = ("all",) if set(matched) == every else matched
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
