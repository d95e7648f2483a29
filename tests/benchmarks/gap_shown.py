"""What a name is worth on held-out drives, beside what it could be worth.

The effect as answered and the true one are fitted with all tunables, and
compared on drives of another kind. Beside them stand two limits: the shrink
with the true kind known, and the floor, what the same model leaves on the
same drives of the same car with nothing hidden. Tunables are held against
those that the same fit finds on the same drives with nothing hidden: a model
that was mistuned moves back in every fit, and that is no bending.
"""

from __future__ import annotations

import hashlib
import json
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gap_cars import FITTED, HELD_OUT, Garage, keep
from gap_cases import comparison_of, seen

import bstm_daemon
from bstm_daemon.analysis.gap.evidence import weigh
from bstm_daemon.analysis.gap.fitting import Fit, fit
from bstm_daemon.analysis.gap.holdout_comparison import (
    EXTENDED,
    REFITTED,
    baseline_fits,
    show,
)
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.analysis.statistics.series import white_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gap_cases import Case
    from gap_judge import Judged, Result

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.gap.holdout_comparison import Shown

TRUE: Final = "with the true effect"
FLOOR: Final = "nothing hidden"


@cache
def fits_fingerprint() -> str:
    """Return what tells one state of fit and comparison from another."""
    package = Path(bstm_daemon.__file__).parent
    files = sorted((package / "analysis" / "gap").glob("*.py"))
    files += sorted((package / "model" / "effects").rglob("*.py"))
    digest = hashlib.sha256()
    for file in (*files, Path(__file__)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def answered(result: Result) -> list[str]:
    """Return the effects that *result* leads to adopt."""
    if result.answer == "name":
        return result.names
    return result.names[:1] if result.answer == "class" else []


def shown(
    case: Case, garage: Garage, one: Judged, result: Result, folder: Path
) -> dict[str, Any]:
    """Return fits and held-out figures of *result* and of the truth."""
    names = answered(result)
    kept = folder / f"{case.key}-shown-{'+'.join(names) or 'none'}.json"
    if kept.exists():
        whole: dict[str, Any] = json.loads(kept.read_text("utf-8"))
        if whole.get("fits") == fits_fingerprint():
            return whole
    whole = {"fits": fits_fingerprint(), **_made(case, garage, one, names)}
    keep(kept, (json.dumps(whole) + "\n").encode())
    return whole


def _made(
    case: Case, garage: Garage, one: Judged, names: Sequence[str]
) -> dict[str, Any]:
    comparison = comparison_of(case, garage)
    comparison.set_noise(one.layout.noise)
    held_out = [
        seen(case, garage.recording(name, case.strengths)) for name in HELD_OUT
    ]
    begin = time.process_time()
    known_k = one.jacobian_k
    baselines = baseline_fits(comparison, known_k)
    start = started(one, case.effects)
    # what these drives do not excite can not be fitted
    true = baselines[REFITTED]
    if start:
        true = fit(comparison, start, known_k=known_k)
    own = true
    if names and set(names) != set(case.effects):
        own = fit(comparison, started(one, names), known_k=known_k)
    figures = show(comparison, own, held_out, baselines)
    seconds = time.process_time() - begin
    there = compare(garage.target, held_out)
    squares, noise, points = _squares(figures)
    squares[TRUE] = _by_node(
        there, there.residuals_k(true.x[None], true.entries)
    )
    reference = _nothing_hidden(case, garage, one)
    clear = compare(
        garage.target,
        [seen(case, garage.recording(name, {})) for name in HELD_OUT],
    )
    squares[FLOOR] = _by_node(clear, clear.residuals_k(reference.x[None]))
    if not names:
        own = baselines[REFITTED]
        squares[EXTENDED] = squares[REFITTED]
    return {
        "strengths": own.strengths,
        "noise_deviations": own.noise_deviations,
        "true_strengths": true.strengths,
        "true_noise_deviations": true.noise_deviations,
        "squares_k2": squares,
        "noise_k2": noise,
        "points": points,
        "bias": {
            label: _apart(comparison, found, reference)
            for label, found in (
                (REFITTED, baselines[REFITTED]),
                (EXTENDED, own),
                (TRUE, true),
            )
        },
        "seconds": seconds,
    }


def _nothing_hidden(case: Case, garage: Garage, one: Judged) -> Fit:
    """Return the tunables fitted to the same drives with nothing hidden."""
    drives = [
        seen(case, garage.recording(name, {}, case.draw)) for name in FITTED
    ]
    clear = compare(garage.target, drives)
    clear.set_noise(one.layout.noise)
    return fit(clear, {}, known_k=garage.sensed.jacobian_k)


def _apart(comparison: Comparison, one: Fit, other: Fit) -> float:
    """Return how far tunables are apart, in deviations of their priors."""
    apart = (one.x - other.x) / comparison.prior
    return float(np.sqrt(np.mean(apart**2)))


def _squares(
    figures: Shown,
) -> tuple[dict[str, dict[str, float]], dict[str, float], dict[str, int]]:
    """Return squares [K2] by model and node, what is noise, and points."""
    squares: dict[str, dict[str, float]] = {}
    noise: dict[str, float] = {}
    points: dict[str, int] = {}
    for curve in figures.errors:
        count = len(curve.measured_c)
        own = white_noise(curve.measured_c) ** 2 * count
        noise[curve.node] = noise.get(curve.node, 0.0) + own
        points[curve.node] = points.get(curve.node, 0) + count
        for model, values in curve.model_c.items():
            nodes = squares.setdefault(model, {})
            error = float(np.sum((values - curve.measured_c) ** 2))
            nodes[curve.node] = nodes.get(curve.node, 0.0) + error
    return squares, noise, points


def _by_node(there: Comparison, apart_k: np.ndarray) -> dict[str, float]:
    found: dict[str, float] = {}
    for i, one in enumerate(there.series):
        own = apart_k[there.edges[i] : there.edges[i + 1], 0]
        found[one.node] = found.get(one.node, 0.0) + float(own @ own)
    return found


def started(one: Judged, names: Sequence[str]) -> dict[str, float]:
    """Return the strength at which each of *names* alone fits best.

    Those that these drives excite.
    """
    project = Projector(one.known.jacobian, one.layout.prior)
    by_name = {s.name: s for s in one.known.signatures}
    return {
        name: weigh(project, one.known.residual, by_name[name]).strength
        for name in names
        if name in by_name
    }
