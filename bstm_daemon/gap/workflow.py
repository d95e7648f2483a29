"""``bstm gap run``: locate, gate, name, fit, show, corner by corner."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bstm_daemon.errors import LogError
from bstm_daemon.gap.calibration import calibrated
from bstm_daemon.gap.comparison import Comparison, heats
from bstm_daemon.gap.fitting import Fit, effect_entries, fit
from bstm_daemon.gap.locating import Located, locate
from bstm_daemon.gap.naming import Naming, name_effect
from bstm_daemon.gap.noise import noise_of
from bstm_daemon.gap.showing import Shown, show
from bstm_daemon.gap.signatures import candidates, sensed
from bstm_daemon.matching.tunables import REFINED, targets_of, usable
from bstm_daemon.roles import MEASURED_NODES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config import Config, EffectConfig
    from bstm_daemon.gap.recording import Recording
    from bstm_daemon.matching.tunables import Target

STEPS = ("locate", "gate", "name", "adopt", "show")


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """What was found on corners that are alike.

    ``before`` and ``after`` are the maps of the drives that ``shown`` is of,
    as configured and with the effect. ``silent`` are candidates that the
    drives do not excite. ``fit`` and ``shown`` are None where nothing was
    named, ``located`` and ``naming`` where they were not asked for.
    """

    corners: tuple[str, ...]
    recordings: tuple[str, ...]
    points: int
    located: Located | None = None
    naming: Naming | None = None
    silent: tuple[str, ...] = ()
    fit: Fit | None = None
    shown: Shown | None = None
    before: Located | None = None
    after: Located | None = None

    def effects(self) -> list[EffectConfig]:
        """Return what can be adopted, with its provenance."""
        if self.fit is None or self.naming is None:
            return []
        found = []
        for name, strength in self.fit.strengths.items():
            evidence = next(
                one.log_evidence
                for one in self.naming.candidates
                if one.name == name
            )
            provenance: dict[str, Any] = {
                "source": "bstm gap",
                "data": list(self.recordings),
                "date": time.strftime("%Y-%m-%d"),
                "strength_sd": round(self.fit.deviations[name], 3),
                "probability": round(self.naming.probability, 4),
                "log_bayes_factor": round(evidence, 1),
            }
            found += effect_entries({name: strength}, provenance)
        return found


def find_gap(
    config: Config,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    until: str = "show",
    progress: Callable[[float], None] | None = None,
) -> list[Gap]:
    """Search *recordings* for what *config* lacks.

    Args:
        config: the vehicle, matched to it as well as may be.
        recordings: drives with thermocouples.
        held_out: drives to show before and after on.
        until: the last step taken: locate, gate, name, adopt or show.
        progress: told the share that is done.

    Raises:
        LogError: no corner with a thermocouple.
    """
    measured = {corner for one in recordings for corner in one.drive.measured}
    targets = targets_of(config, sorted(measured))
    if not targets:
        msg = "no measured temperature of a disc brake in these recordings"
        raise LogError(msg)

    found = []
    for number, target in enumerate(targets):

        def told(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(targets))

        found.append(_gap(target, recordings, held_out, until, told))
    return found


def compare(target: Target, recordings: Sequence[Recording]) -> Comparison:
    """Return *target* against *recordings* with the noise of its nodes."""
    keys, _ = usable(target, REFINED)
    noise = {node: noise_of(target.config, node) for node in MEASURED_NODES}
    return Comparison(target, recordings, keys, noise)


def _gap(
    target: Target,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    until: str,
    told: Callable[[float], None],
) -> Gap:
    located = locate(target.config, recordings, target.corners)
    told(0.1)
    names = tuple(one.name for one in recordings)
    comparison = compare(target, recordings)
    points = int(comparison.edges[-1])
    if until == "locate":
        return Gap(target.corners, names, points, located)
    simulated = sensed(
        comparison,
        candidates(target.config),
        lambda share: told(0.1 + 0.6 * share),
    )
    comparison.set_noise(calibrated(comparison, simulated))
    known = simulated.whitened(comparison)
    naming = name_effect(comparison, known)
    plain = Gap(target.corners, names, points, located, naming, known.silent)
    if until in {"gate", "name"} or naming.answer not in {"name", "class"}:
        return plain
    best = naming.names if naming.answer == "name" else naming.names[:1]
    start = {
        one.name: one.strength for one in naming.candidates if one.name in best
    }
    extended = fit(comparison, start)
    told(0.85)
    shown = None
    maps: tuple[Located | None, Located | None] = (None, None)
    if until == "show":
        shown = show(comparison, extended, held_out)
        maps = _maps(comparison, extended, held_out or recordings)
    return Gap(
        target.corners,
        names,
        points,
        located,
        naming,
        known.silent,
        extended,
        shown,
        *maps,
    )


def _maps(
    comparison: Comparison, extended: Fit, recordings: Sequence[Recording]
) -> tuple[Located, Located]:
    """Return the maps of *recordings* before and after."""
    target = comparison.target
    after = comparison.config(extended.x, extended.effects())
    heat = any(heats(effect, target.config) for effect in extended.effects())
    scale = float(np.exp(extended.x[-1]))
    heated = []
    for one in recordings:
        drive = one.heated_by(after) if heat else one.drive
        power = {
            corner: scale * drive.channel(corner, "brake_power_w")
            for corner in drive.corners
        }
        heated.append(replace(one, drive=drive.with_power(power)))
    return (
        locate(target.config, recordings, target.corners),
        locate(after, heated, target.corners),
    )
