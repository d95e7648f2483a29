"""``bstm match`` to its end: match, search, add, match again while that helps.

Drives for a match may contain what the model lacks. A fit hides that in other
values, so the decision is made on what was left out of the fit; the strength
of an addition is fitted without that too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp
from pathlib import Path
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.adopting import written
from bstm_daemon.analysis.gap.changes import is_change, of_sensor
from bstm_daemon.analysis.gap.comparison import Comparison, with_effects
from bstm_daemon.analysis.gap.fitting import NINETY, askable, directions, fit
from bstm_daemon.analysis.gap.form import with_form
from bstm_daemon.analysis.gap.heat_only import learned_forces
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.searching import search, starts
from bstm_daemon.analysis.gap.signatures import Sensed, candidates, sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.identify.guessed import BY_FORCES
from bstm_daemon.analysis.matching.changes import learned
from bstm_daemon.analysis.matching.learned import entry
from bstm_daemon.analysis.matching.matcher import Match
from bstm_daemon.analysis.matching.structure import KEPT, has_grown, share_left
from bstm_daemon.analysis.matching.tunables import DRAG, strength_key
from bstm_daemon.analysis.matching.workflow import Matched, match_logs
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.sections import Config, EffectConfig

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

    ``effects`` are at their matched strengths.
    """

    matched: Matched
    steps: tuple[Step, ...]
    effects: tuple[EffectConfig, ...]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Matches of ``logs``, and searches in them.

    ``overrides`` maps the interface of a log to the name of its bus,
    ``progress`` is called with the share of a stage that is done, and what
    stage it is.
    """

    logs: Sequence[Path]
    signal_map: SignalMap
    overrides: Mapping[str, str] = field(default_factory=dict)
    progress: Callable[[float, str], None] = lambda *_: None
    _sensed: dict[Match, Sensed] = field(default_factory=dict)

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
                *(self.logs, config, self.signal_map, guessed),
                overrides=self.overrides,
                only=only,
                each=each,
                beside=not stage,
                progress=lambda share: self.progress(share, stage),
            )

        first = matched(config, guessed)
        settled = {f"{one.section}.{one.key}" for one in first.by_forces}
        # what forces did not settle at first, they do not settle later
        guessed -= settled | (BY_FORCES - {DRAG})
        matches = {one.corners: one for one in first.matches}
        kept: dict[tuple[str, str], EffectConfig] = {}
        steps: list[Step] = []
        left = {
            corners: match
            for corners, match in matches.items()
            if match.accuracy.left_out and not (plain or only)
        }
        for _ in range(MOST_ROUNDS):
            found = {
                corners: self._searched(match, alone=len(matches) == 1)
                for corners, match in left.items()
            }
            left = {}
            steps += [step for step, effects in found.values() if not effects]
            new = [one for _, effects in found.values() for one in effects]
            if not new:
                break
            trial = kept | {(one.name, one.corner): one for one in new}
            again = matched(
                with_effects(first.config, list(trial.values())),
                guessed | {strength_key(one.name) for one in new},
                "with what was named",
            )
            for match in again.matches:
                step, effects = found.get(match.corners, (None, []))
                if step is None or not effects:
                    continue
                before = matches[match.corners]
                after_k = match.accuracy.rms_k
                why = _against(before, match)
                step = replace(step, after_k=after_k, why=why)
                steps.append(step)
                if step.kept:
                    for one in [*kept.values(), *effects]:
                        if one.corner in {"all", *match.corners}:
                            kept[one.name, one.corner] = _as_matched(
                                one, match
                            )
                    after = match.in_place_of(before)
                    left[match.corners] = matches[match.corners] = after
        last = first._replace(matches=list(matches.values()))
        return Calibrated(last, tuple(steps), tuple(kept.values()))

    def handed_on(self, match: Match) -> MatchedConfig:
        """Return what *match* learned, with what its form lacks."""
        known = learned(match)
        comparison = self._comparison(match, known)
        # of effects alone, where nothing was simulated for a search
        comparison.trials = {}
        known = with_form(
            known, comparison, self._simulated(match, comparison)
        )
        forces = learned_forces(
            comparison.target.config, comparison.recordings
        )
        return known.model_copy(
            update={
                "forces": {name: a for name, (a, _) in forces.items()},
                "forces_sd": {name: sd for name, (_, sd) in forces.items()},
            }
        )

    def _comparison(self, match: Match, known: MatchedConfig) -> Comparison:
        config = match.after.config.model_copy(update={"matched": [known]})
        return compare(
            replace(match.after, config=config),
            [
                read_recording(log, config, self.signal_map, self.overrides)
                for log in self.logs
            ],
        )

    def _simulated(self, match: Match, comparison: Comparison) -> Sensed:
        """Return *comparison* of *match* as simulated, which takes long."""
        if match not in self._sensed:
            target = comparison.target
            self._sensed[match] = sensed(
                comparison,
                askable(target, candidates(target.config)),
                lambda share: self.progress(share, "search"),
            )
        return self._sensed[match]

    def _searched(
        self, match: Match, *, alone: bool
    ) -> tuple[Step, list[EffectConfig]]:
        """Return what the drives of *match* lack, and that as effects.

        They are of all corners where no others are matched.
        """
        corners = ("all",) if alone else match.corners
        comparison = self._comparison(match, _known_before(match))
        simulated = self._simulated(match, comparison)
        basis = directions(comparison)
        _, naming = search(comparison, simulated, basis)
        step = Step(match.corners, naming, match.accuracy.rms_k)
        if naming.answer != "name":
            return step, []
        # the first alone: the next search says what is missing beside it
        name = naming.names[0]
        if of_sensor(name):
            return step, []
        start = {name: starts(naming)[name]}
        found = fit(comparison, start, basis, known_k=simulated.jacobian_k)
        _, entries = written(comparison, found, naming)
        # a value that changed is the match's own to fit, and has no effect
        effects = [
            one.model_copy(update={"corner": corner})
            for one in entries.effects
            for corner in ((one.corner,) if is_change(name) else corners)
        ]
        return replace(step, added=name if effects else ""), effects


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
    value = match.joint.values.get(key)
    if value is None:
        return effect
    sd = match.joint.standard_deviation(key)
    ends = [value * exp(sign * NINETY * sd / value) for sign in (-1.0, 1.0)]
    own = {
        "source": "bstm match",
        "strength_sd": round(sd, 3),
        "strength_90": [round(end, 3) for end in ends],
    }
    return effect.model_copy(
        update={
            "parameters": {**effect.parameters, "strength": value},
            "provenance": {**effect.provenance, **own},
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
    for drive, old_k, new_k in zip(
        after.drives, old.peaks_k, new.peaks_k, strict=True
    ):
        for node, most_k in new_k.items():
            was_k = old_k[node]
            if has_grown(was_k, most_k):
                return (
                    f"{node} up to {most_k:.0f} K off on {drive.name}, "
                    f"{was_k:.0f} K before"
                )
    return ""
