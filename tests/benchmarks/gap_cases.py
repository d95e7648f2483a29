"""Cases of the gap benchmark and what their drives show, kept to be judged.

What is kept of a case, residuals and sensitivities in kelvin, does not depend
on how a name is found, so a change of the method is judged anew in moments,
and groups that differ only in what the search is told share it.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from gap_cars import FITTED, OF_TEMPERATURES, Garage, World, keep

from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Sensed,
    candidates,
    sensed,
)
from bstm_daemon.analysis.gap.unnamed import (
    SILENT_K,
    Unnamed,
    unnamed_heats,
)
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.drives import NODE_OF

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy.typing as npt

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.matching.problem import Series
    from bstm_daemon.analysis.statistics.whitening import SensorNoise

CARS: Final = 6
"""Cars of the cases with a hidden effect."""

DRAWS: Final = 8
"""Effect-free cases of one car: other errors of the thermocouples."""

BROAD: Final = frozenset({"thermocouple_offset", "thermocouple_lag"})
"""As cases they have three times what every sensor has."""

PAIRS: Final = (
    ("gap_conduction", "hub_conduction"),
    ("disc_hat", "bracket_conduction"),
    ("caliper_fluid_split", "gap_conduction"),
    ("shim_contact", "disc_radiation_driving"),
    ("local_air", "contact_conductance"),
    ("wet_disc", "backplate_loss"),
    ("disc_caliper_radiation", "hub_conduction"),
    ("residual_drag", "gap_conduction"),
    ("friction_fade", "gap_conduction"),
    ("friction_history", "bracket_conduction"),
    ("pad_wear", "disc_hat"),
    ("pushout_pressure", "caliper_fluid_split"),
    # of the same node
    ("hub_conduction", "disc_radiation_driving"),
    ("shim_contact", "bracket_conduction"),
    ("caliper_radiation", "disc_caliper_radiation"),
    ("disc_hat", "wet_disc"),
)
"""Two effects at once; the last four act on one node."""


TWINS: Final = (
    *("backplate_loss", "bracket_conduction"),
    *("residual_drag", "convection_exponent"),
    *("friction_speed", "friction_pressure"),
)
"""Pairs of structural twins: hidden in the cases of ST."""

TWIN_NUMBERS: Final = 100
"""Numbers of the cases of ST begin here."""


@dataclass(frozen=True, slots=True)
class Case:
    """A case; no effects in an effect-free one. ``cars`` are drawn from.

    ``absent`` is the same case with its effects at strength 0.
    """

    world: World
    effects: tuple[str, ...]
    number: int
    cars: int = CARS
    absent: bool = False

    @property
    def seed(self) -> int:
        """Seed of what is drawn for it."""
        text = f"{self.world.driven} {' '.join(self.effects)} {self.number}"
        digest = hashlib.sha256(text.encode()).hexdigest()
        return int(digest[:8], 16)

    @property
    def car(self) -> int:
        """Number of its car."""
        if not self.effects:
            return self.number // DRAWS
        return self.seed % self.cars

    @property
    def draw(self) -> int:
        """Number of its thermocouples' errors."""
        return 1 + self.seed % 9973

    @property
    def strengths(self) -> dict[str, float]:
        """Strength by hidden effect: log-uniform from 0.3 to 2."""
        if self.absent:
            return dict.fromkeys(self.effects, 0.0)
        rng = np.random.default_rng(self.seed)
        drawn = np.exp(
            rng.uniform(np.log(0.3), np.log(2.0), len(self.effects))
        )
        return {
            name: max(float(a), 1.0) if name in BROAD else float(a)
            for name, a in zip(self.effects, drawn, strict=True)
        }

    @property
    def key(self) -> str:
        """Name of what is kept of it."""
        return f"{self.world}-{self._name}"

    @property
    def driven_key(self) -> str:
        """Name of what is kept of its drives."""
        return f"{self.world.driven}-{self._name}"

    @property
    def _name(self) -> str:
        effects = "+".join(self.effects) or "none"
        name = f"car{self.car}-{effects}-{self.number}"
        return f"{name}-absent" if self.absent else name


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a case's drives show; ``change_k`` (n,) is what was hidden."""

    series: tuple[Series, ...]
    prior: np.ndarray
    sensed: Sensed
    change_k: np.ndarray

    def layout(self, noise: dict[str, SensorNoise]) -> Layout:
        """Return where its residuals are and how they err."""
        drives = sorted({one.drive for one in self.series})
        return Layout(
            self.series, noise, self.prior, [FITTED[i] for i in drives]
        )

    def of_drive(self, drive: int) -> Evidence:
        """Return what one drive alone shows."""
        found = self._of([one.drive == drive for one in self.series])
        alone = tuple(replace(one, drive=0) for one in found.series)
        return replace(found, series=alone)

    def of_nodes(self, nodes: Sequence[str]) -> Evidence:
        """Return what thermocouples at *nodes* alone show."""
        found = self._of([one.node in nodes for one in self.series])
        whole = found.sensed
        silent = {
            name
            for name, terms in whole.terms_k.items()
            if float(np.abs(terms.sum(axis=0)).max()) < SILENT_K
        }
        return replace(
            found,
            sensed=replace(
                whole,
                terms_k={
                    name: terms
                    for name, terms in whole.terms_k.items()
                    if name not in silent
                },
                silent=(*whole.silent, *sorted(silent)),
                unknown_k=tuple(
                    one for one in whole.unknown_k if one.place in nodes
                ),
            ),
        )

    def _of(self, kept: Sequence[bool]) -> Evidence:
        """Return what is left of the series, by their number *kept*."""
        sizes = [len(one.time_s) for one in self.series]
        own: npt.NDArray[np.bool_] = np.repeat(kept, sizes)
        whole = self.sensed
        return Evidence(
            tuple(one for one, k in zip(self.series, kept, strict=True) if k),
            self.prior,
            Sensed(
                whole.base_k[own],
                whole.jacobian_k[own],
                {n: terms[:, own] for n, terms in whole.terms_k.items()},
                whole.silent,
                tuple(
                    replace(one, change=one.change[own])
                    for one in whole.unknown_k
                ),
            ),
            self.change_k[own],
        )


def without(known: Linearised, names: Sequence[str]) -> Linearised:
    """Return *known* with *names* out of the catalogue."""
    kept = tuple(s for s in known.signatures if s.name not in names)
    return replace(known, signatures=kept)


def shuffled(known: Linearised, seed: int) -> Linearised:
    """Return *known* with the catalogue in another order."""
    order = np.random.default_rng(seed).permutation(len(known.signatures))
    return replace(known, signatures=tuple(known.signatures[i] for i in order))


def permuted(known: Linearised, seed: int) -> Linearised:
    """Return *known* with each effect's signature under another's name."""
    order = np.random.default_rng(seed).permutation(len(known.signatures))
    own = [known.signatures[i] for i in order]
    # a ring: none keeps its own
    theirs = [*own[1:], own[0]]
    return replace(
        known,
        signatures=tuple(
            replace(b, name=a.name) for a, b in zip(own, theirs, strict=True)
        ),
    )


def evidence(case: Case, garage: Garage, folder: Path) -> Evidence:
    """Return what is kept of *case*, or make it."""
    kept = folder / f"{case.driven_key}.pickle"
    if not kept.exists():
        # what the cases of its car share is no cost of this one
        shared = (garage.sensed, garage.comparison)
        begin_s = time.process_time()
        keep(kept, pickle.dumps(_made(case, garage)))
        del shared
        cost = json.dumps(time.process_time() - begin_s)
        keep(cost_file(case, folder), cost.encode())
    series, own, base_k, unknown, change_k = pickle.loads(  # noqa: S301  (own)
        kept.read_bytes()
    )
    whole = own or replace(garage.sensed, base_k=base_k, unknown_k=unknown)
    found = Evidence(series, garage.prior, whole, change_k)
    return found.of_nodes(case.world.nodes) if case.world.nodes else found


def cost_file(case: Case, folder: Path) -> Path:
    """Return where the CPU time [s] of its drives is kept."""
    return folder / f"{case.driven_key}.seconds"


def seen(case: Case, recording: Recording) -> Recording:
    """Return *recording* with the thermocouples of the case's world."""
    nodes = case.world.nodes
    if not nodes:
        return recording
    drive = recording.drive
    measured = {
        corner: {
            couple: series
            for couple, series in couples.items()
            if NODE_OF.get(couple, couple) in nodes
        }
        for corner, couples in drive.measured.items()
    }
    return replace(recording, drive=replace(drive, measured=measured))


def comparison_of(case: Case, garage: Garage) -> Comparison:
    """Return the model against the drives of *case*."""
    drives = [
        seen(case, garage.recording(name, case.strengths, case.draw))
        for name in FITTED
    ]
    return compare(garage.target, drives)


def _made(
    case: Case, garage: Garage
) -> tuple[
    tuple[Series, ...],
    Sensed | None,
    np.ndarray | None,
    tuple[Unnamed, ...],
    np.ndarray,
]:
    comparison = comparison_of(replace(case, world=case.world.driven), garage)
    shared = set(case.effects) <= OF_TEMPERATURES
    own, unknown = None, ()
    base_k = comparison.residuals_k(comparison.start[None])[:, 0]
    if shared:
        unknown = unnamed_heats(comparison, base_k)
    else:
        own = sensed(comparison, candidates(garage.target.config))
    # the same errors of the thermocouples with nothing hidden
    nothing = [garage.recording(name, {}, case.draw) for name in FITTED]
    clear = compare(garage.target, nothing)
    # and the same start, which is what they have read
    change_k = base_k - clear.residuals_k(clear.start[None])[:, 0]
    return comparison.series, own, base_k, unknown, change_k
