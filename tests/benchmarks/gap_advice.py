"""The next drive: what the advised one tells, beside every other one.

A case is judged on ``simalp`` alone. What that leaves open is asked about,
a drive of the menu is advised, and then every drive of the menu is driven
with the hidden effect in the reality: how often is the effect named after
the advised drive, and how often after one drawn at random.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gap_cars import FITTED, Garage, keep, present
from gap_cases import Case, Evidence, evidence
from gap_judge import Judged, Result, judged

from bstm_daemon.analysis.gap.advising import (
    MENU,
    Prospect,
    advise,
    candidate_drive,
    members_of,
)
from bstm_daemon.analysis.gap.naming import name_effect
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Sensed,
    candidates,
    sensed,
)
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.gap.workflow import compare

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.matching.problem import Series

START: Final = "simalp"
OPEN: Final = ("nothing", "class", "undecided")
"""Answers on the first drive that leave something to ask about."""


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """One drive against the car's model: its series and sensitivities."""

    series: tuple[Series, ...]
    sensed: Sensed
    description: str
    duration_s: float


def next_drive(
    garage: Garage, case: Case, folder: Path, search: str
) -> list[Result]:
    """Return what comes of *case* after each drive; nothing if not open."""
    kept = folder / f"{case.key}-next.json"
    if kept.exists():
        data = json.loads(kept.read_text("utf-8"))
        if data["search"] == search:
            return [Result(**one) for one in data["results"]]
    found = _asked(garage, case, folder)
    data = {
        "search": search,
        "world": asdict(case.world),
        "results": [asdict(one) for one in found],
    }
    keep(kept, (json.dumps(data) + "\n").encode())
    return found


def _asked(garage: Garage, case: Case, folder: Path) -> list[Result]:
    whole = evidence(case, garage, folder)
    first = whole.of_drive(FITTED.index(START))
    one = judged(case, garage, first)
    naming = name_effect(one.layout, one.known)
    if naming.answer not in OPEN:
        return []
    members = members_of(naming, one.known.silent)
    prospects = [
        _prospect(garage, name, one, folder, members) for name in MENU
    ]
    advice = advise(one.known, one.layout.prior, members, prospects)
    after = {name: _answer(case, garage, first, name, folder) for name in MENU}
    shown: dict[str, Any] = {
        "advised": advice[0].drive,
        "expected": advice[0].named,
        "named": {
            name: answer.answer == "name" and answer.score == 1.0
            for name, answer in after.items()
        },
        "wrong": {name: answer.wrong_name for name, answer in after.items()},
    }
    return [replace(one.answer("AD"), shown=shown)]


def _prospect(
    garage: Garage,
    name: str,
    one: Judged,
    folder: Path,
    members: tuple[str, ...],
) -> Prospect:
    """Return what *name* would tell, as the model sees it before."""
    kept = folder / f"{garage.world}-menu-{name}-{garage.number}.pickle"
    if not kept.exists():
        couples = {
            corner: tuple(own)
            for corner, own in garage.driven(
                START
            ).recording.drive.measured.items()
            if corner in garage.target.corners
        }
        told = _told(
            garage,
            *candidate_drive(name, garage.target.config, present(), couples),
        )
        keep(kept, pickle.dumps(told))
    told = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
    layout = Layout(told.series, one.layout.noise, one.layout.prior, (name,))
    known = told.sensed.whitened(layout)
    return Prospect(
        name,
        told.description,
        told.duration_s,
        known.jacobian,
        {s.name: s for s in known.signatures if s.name in members},
    )


def _told(garage: Garage, recording: Recording, description: str) -> Told:
    comparison = compare(garage.target, [recording])
    return Told(
        comparison.series,
        sensed(comparison, candidates(garage.target.config)),
        description,
        recording.drive.duration_s,
    )


def _answer(
    case: Case, garage: Garage, first: Evidence, name: str, folder: Path
) -> Result:
    """Return the answer after the first drive and *name*."""
    kept = folder / f"{garage.world}-driven-{name}-{garage.number}.pickle"
    if not kept.exists():
        keep(
            kept,
            pickle.dumps(_told(garage, garage.driven(name).recording, "")),
        )
    told = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
    recording = garage.recording(name, case.strengths, case.draw)
    comparison = compare(garage.target, [recording])
    base_k = comparison.residuals_k(comparison.start[None])[:, 0]
    # heats follow what was measured without the effect: nearly the same
    second = replace(told.sensed, base_k=base_k)
    series = tuple(replace(s, drive=1) for s in comparison.series)
    both = Evidence(
        (*first.series, *series),
        first.prior,
        _stacked(first.sensed, second),
        np.zeros(len(first.change_k) + len(base_k)),
    )
    return judged(case, garage, both).answer("AD")


def _stacked(one: Sensed, two: Sensed) -> Sensed:
    """Return two drives as one, what one of them does not excite as 0."""
    sizes = len(one.base_k), len(two.base_k)
    names = [n for n in one.terms_k if n in two.terms_k]
    names += [n for n in one.terms_k if n not in two.terms_k]
    names += [n for n in two.terms_k if n not in one.terms_k]

    def terms(which: Mapping[str, np.ndarray], n: str, size: int) -> Any:
        return which.get(n, np.zeros((2, size)))

    heats = [{(h.place, h.when): h.change for h in s.unknown_k}
             for s in (one, two)]  # fmt: skip
    return Sensed(
        np.concatenate((one.base_k, two.base_k)),
        np.vstack((one.jacobian_k, two.jacobian_k)),
        {
            n: np.hstack(
                (
                    terms(one.terms_k, n, sizes[0]),
                    terms(two.terms_k, n, sizes[1]),
                )
            )
            for n in names
        },
        tuple(n for n in one.silent if n in two.silent),
        tuple(
            Unnamed(
                *place,
                np.concatenate(
                    [
                        own.get(place, np.zeros(size))
                        for own, size in zip(heats, sizes, strict=True)
                    ]
                ),
            )
            for place in dict.fromkeys((*heats[0], *heats[1]))
        ),
    )
