"""``bstm match`` to its end: match, search, add, match again while that helps.

Drives for a match may contain what the model lacks. A fit hides that in other
values, so the decision is made on what was left out of the fit; the strength
of an addition is fitted without that too.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import exp
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.adopting import written
from bstm_daemon.analysis.gap.changes import is_change
from bstm_daemon.analysis.gap.fitting import NINETY, askable, directions, fit
from bstm_daemon.analysis.gap.form import with_form
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.searching import search, starts
from bstm_daemon.analysis.gap.signatures import candidates, sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.identify.guessed import with_changes
from bstm_daemon.analysis.matching.changes import learned
from bstm_daemon.analysis.matching.learned import entry
from bstm_daemon.analysis.matching.structure import KEPT, share_left
from bstm_daemon.analysis.matching.tunables import strength_key
from bstm_daemon.analysis.matching.workflow import Matched, match_logs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.gap.naming import Naming
    from bstm_daemon.analysis.gap.signatures import Sensed
    from bstm_daemon.analysis.identify.writing import Change
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.estimates import MatchedConfig
    from bstm_daemon.config.sections import Config, CornerConfig, EffectConfig

MOST_ROUNDS: Final = 3
"""Additions that are tried, one after the other."""

WORSE: Final = 1.05
"""Times the error on any one drive that was left out, at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A search of the drives that corners were matched to.

    ``before_k`` is the RMS by node on what was left out, ``after_k`` that of
    the match with what was ``added``, the first of the names, both empty
    where nothing was tried. ``why`` says why it was dropped, empty where it
    was kept.
    """

    corners: tuple[str, ...]
    naming: Naming
    before_k: Mapping[str, float]
    added: str = ""
    after_k: Mapping[str, float] = field(default_factory=dict)
    why: str = ""

    @property
    def kept(self) -> bool:
        """Whether the model has what was named."""
        return bool(self.added) and not self.why


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """The last matches, the steps to them, and what was added on the way.

    ``effects`` are at their matched strengths, ``changes`` values that no
    match fits.
    """

    matched: Matched
    steps: tuple[Step, ...]
    effects: tuple[EffectConfig, ...]
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True)
class _Addition:
    """Effects, or corners whose values moved, with what no match fits."""

    effects: list[EffectConfig]
    moved: dict[str, CornerConfig] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)

    def within(self, config: Config) -> Config:
        """Return *config* with it."""
        new = {(one.name, one.corner) for one in self.effects}
        kept = [o for o in config.effect if (o.name, o.corner) not in new]
        corners = [self.moved.get(one.name, one) for one in config.corner]
        return config.model_copy(
            update={"effect": [*kept, *self.effects], "corner": corners}
        )

    def and_then(self, other: _Addition, match: Match) -> _Addition:
        """Return both, with the strengths that *match* fitted."""
        effects = [*self.effects, *other.effects]
        return _Addition(
            [_as_matched(one, match) for one in effects],
            {**self.moved, **other.moved},
            [*self.changes, *other.changes],
        )


class Calibration:
    """Matches of logs, and searches in them."""

    def __init__(
        self,
        logs: Sequence[Path],
        signal_map: SignalMap,
        overrides: Mapping[str, str] | None = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        """Take what is matched.

        Args:
            logs: drives with measured temperatures, in the order driven.
            signal_map: the vehicle's extraction plan.
            overrides: interface of a log to the name of its bus.
            progress: called with the share of a stage that is done, and what
                stage it is.
        """
        self._logs = logs
        self._signal_map = signal_map
        self._overrides = dict(overrides or {})
        self._progress = progress or (lambda *_: None)
        self._sensed: dict[Match, Sensed] = {}

    def run(
        self,
        config: Config,
        guessed: frozenset[str] = frozenset(),
        *,
        only: str = "",
        each: bool = False,
        plain: bool = False,
    ) -> Calibrated:
        """Match *config*, and again with what is named, while that helps.

        Args:
            config: the vehicle.
            guessed: keys whose configured values nobody has measured.
            only: ``cooling`` for what another rim changes; implies *plain*.
            each: match corners by themselves that are configured alike.
            plain: match once, without a search.

        Raises:
            LogError: a log can not be used, or no corner has a thermocouple.
        """

        def matched(
            config: Config, guessed: frozenset[str], stage: str = ""
        ) -> Matched:
            return match_logs(
                self._logs,
                config,
                self._signal_map,
                guessed,
                overrides=self._overrides,
                only=only,
                each=each,
                beside=not stage,
                progress=lambda share: self._progress(share, stage),
            )

        first = matched(config, guessed)
        by_forces = first.by_forces
        guessed -= {f"{one.section}.{one.key}" for one in by_forces}
        matches = {one.corners: one for one in first.matches}
        kept: dict[tuple[str, ...], _Addition] = {}
        steps: list[Step] = []
        base = first.config
        left = {} if plain or only else dict(matches)
        for _ in range(MOST_ROUNDS):
            trial, tried = base, {}
            for corners, match in left.items():
                alone = ("all",) if len(matches) == 1 else corners
                step, addition = self._searched(match, alone)
                if addition is None:
                    steps.append(step)
                else:
                    tried[corners] = step, addition
                    trial = addition.within(trial)
            left = {}
            if not tried:
                break
            keys = {strength_key(step.added) for step, _ in tried.values()}
            again = matched(trial, guessed | keys, "with what was named")
            for match in again.matches:
                if match.corners not in tried:
                    continue
                step, addition = tried[match.corners]
                before = matches[match.corners]
                why = _against(before, match)
                after_k = match.accuracy.rms_k
                steps.append(replace(step, after_k=after_k, why=why))
                if why:
                    continue
                old = kept.get(match.corners, _Addition([]))
                kept[match.corners] = old.and_then(addition, match)
                base = kept[match.corners].within(base)
                left[match.corners] = matches[match.corners] = replace(
                    match,
                    before=before.before,
                    table_4_1=before.table_4_1,
                    accuracy=replace(
                        match.accuracy, before_k=before.accuracy.before_k
                    ),
                )
            if left:
                by_forces = [*by_forces, *again.by_forces]
        return Calibrated(
            first._replace(
                matches=list(matches.values()), by_forces=by_forces
            ),
            tuple(steps),
            tuple(one for own in kept.values() for one in own.effects),
            tuple(one for own in kept.values() for one in own.changes),
        )

    def handed_on(self, match: Match) -> MatchedConfig:
        """Return what *match* learned, with what its form lacks."""
        known = learned(match)
        return with_form(
            known,
            self._comparison(match, known),
            lambda share: self._progress(share, "form"),
            self._sensed.get(match),
        )

    def _comparison(self, match: Match, known: MatchedConfig) -> Comparison:
        config = match.after.config.model_copy(update={"matched": [known]})
        return compare(
            replace(match.after, config=config),
            [
                read_recording(log, config, self._signal_map, self._overrides)
                for log in self._logs
            ],
        )

    def _searched(
        self, match: Match, corners: Sequence[str]
    ) -> tuple[Step, _Addition | None]:
        """Return what the drives of *match* lack, and that for *corners*."""
        comparison = self._comparison(match, _known_before(match))
        target = comparison.target
        simulated = sensed(
            comparison,
            askable(target, candidates(target.config)),
            lambda share: self._progress(share, "search"),
        )
        self._sensed[match] = simulated
        basis = directions(comparison)
        _, naming = search(comparison, simulated, basis)
        step = Step(match.corners, naming, match.accuracy.rms_k)
        if naming.answer != "name":
            return step, None
        # the first alone: the next search says what is missing beside it
        name = naming.names[0]
        start = {name: starts(naming)[name]}
        found = fit(comparison, start, basis, known_k=simulated.jacobian_k)
        changes, entries = written(comparison, found, naming)
        addition = _Addition(
            [
                one.model_copy(update={"corner": corner})
                for one in entries.effects
                for corner in corners
            ]
        )
        if is_change(name):
            friction = [
                one for one in changes if one.key == "friction_coefficient"
            ]
            moved = with_changes(comparison.config(found.written_x), friction)
            own: dict[str, CornerConfig] = {
                one.name: one
                for one in moved.corner
                if one.name in match.corners
            }
            addition = replace(addition, moved=own, changes=friction)
        return replace(step, added=name), addition


def _known_before(match: Match) -> MatchedConfig:
    """Return what *match* says of its own drives.

    How well they know the values would count them twice: the priors hold
    again. Where a part may be missing, what the fit leaves is not its form's.
    """
    known = learned(match)
    if match.verdict:
        known = known.model_copy(update={"form_k": {}, "form_share": {}})
    prior = np.array([match.after.tunable(one).prior for one in known.names])
    return entry(match.after, known.names, np.diag(prior**2), known)


def _as_matched(effect: EffectConfig, match: Match) -> EffectConfig:
    """Return *effect* at the strength that *match* fitted, if it did."""
    key = strength_key(effect.name)
    if key not in match.joint.values:
        return effect
    value = match.joint.values[key]
    sd = match.joint.standard_deviation(key)
    factor = exp(NINETY * sd / value)
    return effect.model_copy(
        update={
            "parameters": {**effect.parameters, "strength": value},
            "provenance": {
                **effect.provenance,
                "source": "bstm match",
                "strength_sd": round(sd, 3),
                "strength_90": [
                    round(value / factor, 3),
                    round(value * factor, 3),
                ],
            },
        }
    )


def _against(before: Match, after: Match) -> str:
    """Say why *after* is no gain on what was left out, nothing where it is."""
    old, new = before.accuracy, after.accuracy
    share = share_left(old.rms_k, new.rms_k)
    if share > KEPT:
        return f"leaves {share:.2f} times the error"
    for drive, old_k, new_k in zip(
        after.drives, old.each_k, new.each_k, strict=True
    ):
        worse = share_left(old_k, new_k)
        if worse > WORSE:
            return f"{worse:.2f} times the error on {drive.name}"
    return ""
