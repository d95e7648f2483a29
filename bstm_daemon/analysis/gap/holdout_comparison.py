"""Before and after on drives that no fit has seen.

Four models: as configured; the baseline with its heat and its cooling scaled;
the baseline with all tunables re-fitted; and what is written: the effect or
change, tunables re-fitted too. A shrink factor is the error of one of the
first three over that of the fourth, the noise of the thermocouples taken off
both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import name_of
from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.fitting import Fit, fit, scale_basis
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.matching.structure import GROWN, has_grown
from bstm_daemon.analysis.statistics.resampling import bootstrap
from bstm_daemon.analysis.statistics.series import Column, rms, white_noise
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.units import KELVIN_OFFSET

CONFIGURED, SCALED, REFITTED, EXTENDED = (
    "as configured",
    "heat and cooling re-fitted",
    "all tunables re-fitted",
    "as written",
)
BASELINES: Final = (CONFIGURED, SCALED, REFITTED)

BLOCK_S: Final = 300.0
DRAWS: Final = 200
"""Blocks of time drawn anew for the interval of a shrink factor."""

CONFIRMED: Final = 1.1
"""Least shrink factor of held-out drives with which a name is given. It takes
two of three false names of pairs without an effect, at 1.05 and 1.07, and none
of another simulator's right ones, from 1.18 on; others fall on either side
(`docs/evidence-gap.md`)."""

NOISE_FLOOR: Final = 0.3
"""No error counts as smaller than this share of the thermocouples' noise."""


@dataclass(frozen=True, slots=True)
class Shrink:
    """Factor and its 90 % interval."""

    factor: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False)
class NodeErrors:
    """One node over one drive: measured and, by model, modelled [degC].

    Series are (n,); RMS and errors at the peak are by model too.
    """

    drive: str
    node: str
    time_s: Column
    measured_c: Column
    model_c: Mapping[str, Column]
    rms_k: Mapping[str, float]
    peak_error_k: Mapping[str, float]
    peak_late_s: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the effect does on drives that were not fitted.

    ``shrinks`` and ``fluid_shrinks`` by baseline; ``moved`` (p,) are the
    changes of the tunables' logarithms by model. Where there was no held-out
    drive, ``held_out`` is false and all of it is of the fitted drives.
    """

    held_out: bool
    shrinks: Mapping[str, Shrink]
    fluid_shrinks: Mapping[str, Shrink]
    errors: tuple[NodeErrors, ...]
    moved: Mapping[str, Column]
    bends: Mapping[str, float]
    keys: tuple[str, ...]

    @property
    def better(self) -> bool:
        """Whether what is written errs less than what is configured.

        On held-out drives clearly less.
        """
        least = CONFIRMED if self.held_out else 1.0
        return self.shrinks[CONFIGURED].factor > least

    def against(self, noise: Mapping[str, SensorNoise]) -> NodeErrors | None:
        """Return what contradicts what is written most, if anything does.

        Where it is held out and errs clearly more than with heat and cooling
        re-fitted: by more than the drift that *noise* has by node, too. Not
        where over all nodes it errs clearly less, in kelvin or in drifts:
        heat and cooling may serve one node and leave the others.
        """
        gained = max(
            self.shrinks[SCALED].lower,
            self._in_drifts(SCALED, noise) / self._in_drifts(EXTENDED, noise),
        )
        found = [
            one
            for one in self.errors
            if self.held_out
            and gained < GROWN
            and has_grown(
                one.rms_k[SCALED], one.rms_k[EXTENDED], noise[one.node].drift_k
            )
        ]
        return max(
            found,
            key=lambda one: one.rms_k[EXTENDED] / one.rms_k[SCALED],
            default=None,
        )

    def _in_drifts(
        self, model: str, noise: Mapping[str, SensorNoise]
    ) -> float:
        """Return the RMS of *model* over all, each node by its own drift."""
        share = [
            (len(one.time_s), one.rms_k[model] / noise[one.node].drift_k)
            for one in self.errors
        ]
        points = sum(count for count, _ in share)
        return sqrt(sum(n * size**2 for n, size in share) / points)


def baseline_fits(
    comparison: Comparison, known_k: Column | None = None
) -> dict[str, Fit]:
    """Return the models without the effect, fitted to *comparison*."""
    return {
        CONFIGURED: Fit(comparison.start, {}, {}, np.nan),
        SCALED: fit(
            comparison,
            {},
            scale_basis(comparison),
            priors=False,
            known_k=known_k,
        ),
        REFITTED: fit(comparison, {}, known_k=known_k),
    }


def show(
    comparison: Comparison,
    extended: Fit,
    held_out: Sequence[Recording],
    baselines: Mapping[str, Fit] | None = None,
    *,
    known_k: Column | None = None,
) -> Shown:
    """Compare the models on *held_out*, or on what was fitted.

    *baselines* are models fitted before, by :func:`baseline_fits`;
    *known_k* (n, p) is as for :func:`fit`.
    """
    fits = {
        **(baselines or baseline_fits(comparison, known_k)),
        EXTENDED: replace(extended, x=extended.written_x),
    }
    there = Comparison(
        comparison.target,
        held_out or comparison.recordings,
        comparison.keys[:-1],
        comparison.noise,
    )
    apart = {
        name: there.residuals_k(one.x[None], one.entries)[:, 0]
        for name, one in fits.items()
    }
    everything = list(range(len(there.series)))
    fluid = [i for i in everything if there.series[i].node == "fluid"]
    return Shown(
        bool(held_out),
        {name: _shrink(there, apart, name, everything) for name in BASELINES},
        {
            name: _shrink(there, apart, name, fluid)
            for name in BASELINES
            if fluid
        },
        tuple(_errors(there, apart, i) for i in everything),
        {name: one.x - comparison.start for name, one in fits.items()},
        {name: one.bend(comparison) for name, one in fits.items()},
        comparison.keys,
    )


def fitted_and_shown(
    naming: Naming,
    start: Mapping[str, float],
    comparison: Comparison,
    basis: Column,
    held_out: Sequence[Recording],
    *,
    known_k: Column,
) -> tuple[Naming, Fit, Shown]:
    """Fit what *naming* adopts, and show it on *held_out*.

    Of several names as many, best first, as held-out drives gain by.

    Args:
        naming: the answer.
        start: strengths that the fit begins at, by name.
        comparison: the drives that are fitted.
        basis: directions (p, q) in which the tunables may move.
        held_out: drives that are not.
        known_k: sensitivities of the tunables (n, p), as for :func:`fit`.
    """
    baselines = baseline_fits(comparison, known_k)
    names = naming.adoptable
    several = held_out and naming.answer == "name"
    fits = [
        fit(
            comparison,
            {name: a for name, a in start.items() if name in names[:count]},
            basis,
            known_k=known_k,
        )
        for count in range(1 if several else len(names), len(names) + 1)
    ]
    shown = [
        show(comparison, one, held_out, baselines, known_k=known_k)
        for one in fits
    ]
    # of the same, the first: the fewest
    best = int(np.argmax([one.shrinks[CONFIGURED].factor for one in shown]))
    if best < len(fits) - 1:
        rest = ", ".join(map(name_of, names[best + 1 :]))
        naming = replace(
            naming,
            names=names[: best + 1],
            reason=f"{naming.reason}; held-out drives gain nothing by {rest}",
        )
    return naming, fits[best], shown[best]


def contradicted(
    naming: Naming, names: Sequence[str], by: NodeErrors
) -> Naming:
    """Return *naming* without a name: held-out errors contradict *names*.

    *by* are those of the last one, or of all together.
    """
    what = ", ".join(map(name_of, names))
    reason = (
        f"{by.drive}, held out, contradicts {what}: {by.node} is "
        f"{by.rms_k[EXTENDED]:.1f} K off, {by.rms_k[SCALED]:.1f} K with "
        f"{SCALED} instead"
    )
    return naming.answered("unknown", (), 1.0 - naming.odds[""], reason)


def confirmed(
    naming: Naming, shown: Shown, noise: Mapping[str, SensorNoise]
) -> Naming:
    """Return *naming* as held-out drives leave it, if *shown* is of any.

    Without a name where they contradict it, undecided where they gain nothing
    by what is written. *noise* is what the match handed on by node.
    """
    if by := shown.against(noise):
        return contradicted(naming, naming.names, by)
    if shown.better or not shown.held_out:
        return naming
    factor = shown.shrinks[CONFIGURED].factor
    reason = (
        f"with it the error of held-out drives is {factor:.2f} times smaller, "
        f"and a name needs {CONFIRMED}"
    )
    return naming.answered(
        "undecided", naming.names, naming.probability, reason
    )


def _shrink(
    there: Comparison,
    apart: Mapping[str, Column],
    baseline: str,
    which: Sequence[int],
) -> Shrink:
    """Return the factor over *which* series, blocks drawn for its interval."""
    before, after, noise = [], [], []
    for i in which:
        one = there.series[i]
        part = slice(there.edges[i], there.edges[i + 1])
        variance = white_noise(one.measured_k) ** 2
        block = (one.time_s // BLOCK_S).astype(int)
        for number in np.unique(block):
            own = block == number
            before.append(np.sum(apart[baseline][part][own] ** 2))
            after.append(np.sum(apart[EXTENDED][part][own] ** 2))
            noise.append(variance * np.count_nonzero(own))
    sums = np.column_stack((before, after, noise))
    interval = bootstrap(sums, _factor, draws=DRAWS, seed=3)
    return Shrink(_factor(sums.sum(axis=0)), *interval)


def _factor(sums: Column) -> float:
    before, after, noise = sums
    least = NOISE_FLOOR * noise
    return float(
        np.sqrt(max(before - noise, least) / max(after - noise, least))
    )


def _errors(
    there: Comparison, apart: Mapping[str, Column], which: int
) -> NodeErrors:
    one = there.series[which]
    part = slice(there.edges[which], there.edges[which + 1])
    top = int(np.argmax(one.measured_k))
    peak, late = {}, {}
    for name, error in apart.items():
        model = one.measured_k + error[part]
        at = int(np.argmax(model))
        peak[name] = float(model[at] - one.measured_k[top])
        late[name] = float(one.time_s[at] - one.time_s[top])
    measured = one.measured_k - KELVIN_OFFSET
    return NodeErrors(
        there.recordings[one.drive].name,
        one.node,
        one.time_s,
        measured,
        {name: measured + error[part] for name, error in apart.items()},
        {name: rms(error[part]) for name, error in apart.items()},
        peak,
        late,
    )
