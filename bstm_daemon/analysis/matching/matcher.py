"""``bstm match``: stages, then the joint refinement, corner by corner.

And what comes of it: changes of the configuration file, curves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.matching.phases import HARD_MS2, hard_stops
from bstm_daemon.analysis.matching.refine import (
    Accuracy,
    Refinement,
    held_out,
    refine,
)
from bstm_daemon.analysis.matching.stages import StageResult, run_stages
from bstm_daemon.analysis.matching.tunables import (
    COOLING,
    EFFECT,
    S_SPEEDS_MS,
    TABLE_4_1,
    Target,
    measured_targets,
    over_targets,
    refined_keys,
    split_key,
    usable,
)
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config

MUCH_LESS: Final = 0.8
"""A form is worth a word where it leaves so much less of the error."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """The match of corners that are alike.

    ``before`` and ``after`` are the configurations; ``table_4_1`` is the
    refinement of the thesis's own parameters alone, from the same start.
    ``accuracy`` is what the fit leaves over on drives that it did not see,
    where there are two or more.
    """

    corners: tuple[str, ...]
    before: Target
    after: Target
    stages: tuple[StageResult, ...]
    joint: Refinement
    table_4_1: Refinement | None
    accuracy: Accuracy
    remarks: tuple[str, ...]

    def settings(self) -> dict[str, Any]:
        """Return the keys of the configuration and their matched values."""
        corner = self.after.corner
        cooling = self.after.config.cooling_of(corner)
        found: dict[str, Any] = {
            key: value
            for key, value in self.joint.values.items()
            if key not in S_SPEEDS_MS
        }
        if S_SPEEDS_MS.keys() & self.joint.values.keys():
            found["cooling.s_per_s"] = tuple(cooling.s_per_s)
        return found

    def deviation(self, key: str) -> float:
        """Return the standard deviation of a key of :meth:`settings`.

        That of the S-table is relative, its larger factor's.
        """
        if key == "cooling.s_per_s":
            return max(
                self.joint.standard_deviation(one) / self.joint.values[one]
                for one in S_SPEEDS_MS
                if one in self.joint.values
            )
        return self.joint.standard_deviation(key)


def match_drives(
    config: Config,
    drives: Sequence[Drive],
    *,
    only: str = "",
    each: bool = False,
    beside: bool = True,
    progress: Callable[[float], None] | None = None,
) -> list[Match]:
    """Match *config* to *drives*, all corners with thermocouples.

    Args:
        config: the vehicle.
        drives: what was recorded.
        only: ``cooling`` for what another rim changes, else everything.
        each: match corners by themselves that are configured alike.
        beside: fit Table 4.1 alone, for comparison.
        progress: called with the share that is done.

    Raises:
        LogError: no corner has a thermocouple.
    """
    targets = measured_targets(config, drives, each=each)
    return over_targets(
        targets,
        lambda target, show: _match(
            target, drives, only, show, beside=beside and not only
        ),
        progress,
    )


def _other_form(
    target: Target, drives: Sequence[Drive], joint: Refinement
) -> str:
    """Say where the other form of cooling leaves much less of the disc."""
    if "disc" not in joint.rms_k:
        return ""
    form = target.config.cooling_of(target.corner).form
    other = "conductance" if form == "rate" else "rate"
    fit = refine(
        target.with_cooling_form(other), drives, joint.keys,
        start=joint.values, noise=joint.noise, rounds=1,
    )  # fmt: skip
    before, after = joint.rms_k["disc"], fit.rms_k["disc"]
    if after > MUCH_LESS * before:
        return ""
    return (
        f'cooling.form = "{other}" would leave {after:.1f} K of the disc '
        f"instead of {before:.1f} K: set it and match again"
    )


def _no_hard_stop(target: Target, drives: Sequence[Drive]) -> str:
    """Say where the drives have no hard stop: drags alone fit wrongly."""
    if any(
        hard_stops(drive, corner)
        for drive in drives
        for corner in target.corners
        if corner in drive.corners
    ):
        return ""
    return (
        f"no hard stop ({HARD_MS2:g} m/s2) in these drives: the values fit "
        "drags and may be wrong in stops"
    )


def _match(
    target: Target,
    drives: Sequence[Drive],
    only: str,
    show: Callable[[float], None],
    *,
    beside: bool,
) -> Match:
    keys, remarks = usable(
        target, COOLING if only == "cooling" else refined_keys(target)
    )
    start, stages = run_stages(
        target,
        drives,
        COOLING if only == "cooling" else None,
        lambda share: show(0.3 * share),
    )
    joint = refine(
        target,
        drives,
        keys,
        lambda share: show(0.3 + 0.3 * share),
        start=start,
    )
    thesis = None
    if beside:
        own, _ = usable(target, TABLE_4_1)
        thesis = refine(
            target,
            drives,
            own,
            lambda share: show(0.6 + 0.2 * share),
            start=start,
        )
    accuracy = held_out(
        target, drives, joint, lambda share: show(0.8 + 0.2 * share)
    )
    if not only:
        found = (
            _other_form(target, drives, joint),
            _no_hard_stop(target, drives),
        )
        remarks += [remark for remark in found if remark]
    return Match(
        target.corners,
        target,
        target.changed(joint.values),
        tuple(stages),
        joint,
        thesis,
        accuracy,
        tuple(remarks),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """A thermocouple over a drive, (n,) each: temperatures [degC]."""

    couple: str
    measured_c: Column
    before_c: Column
    after_c: Column


def curves_of(match: Match, drive: Drive, corner: str) -> list[Curves]:
    """Return each thermocouple of *corner*, and the model as it was and is."""
    programs = [
        compile_corner(one.config, one.corner)
        for one in (match.before, match.after)
    ]
    couples = drive.couples(
        corner, {node.name for node in programs[0].network.nodes}
    )
    if not couples:
        return []
    result = march(programs, drive, corner)
    return [
        Curves(
            name,
            drive.measured[corner][name].at(drive.time_s) - KELVIN_OFFSET,
            *(result[node] - KELVIN_OFFSET).T,
        )
        for name, node in couples
    ]


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
            note = f"{origin}, sd {sd:.2g}"
            if isinstance(value, tuple):
                note = f"{origin}, sd {100.0 * sd:.2g} %"
            if section == EFFECT:
                changes += _of_effect(name, value, note, config, match)
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
            (one.floor_k, one.share, match.accuracy.drives)
            for match in matches
            if (one := match.accuracy.nodes.get(node)) is not None
        ]
        if not found:
            continue
        floor, share, drives = max(found)
        note = f"{origin}, residual on held-out drives"
        if not drives:
            note = f"{origin}, residual on the drive itself: too small"
        changes += [
            Change("accuracy", f"{node}_k", floor, note=note),
            Change("accuracy", f"{node}_share", share, note=note),
        ]
    return changes
