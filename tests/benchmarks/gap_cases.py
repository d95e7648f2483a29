"""Cases of the gap benchmark and what their drives show, kept to be judged.

What is kept of a case, residuals and sensitivities in kelvin, does not depend
on how a name is found, so a change of the method is judged anew in moments,
and groups that differ only in what the search is told share it.
"""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from gap_cars import FITTED, Garage, World

from bstm_daemon.gap.layout import Layout
from bstm_daemon.gap.signatures import Sensed, candidates, sensed
from bstm_daemon.gap.unknown import UnknownHeat, unknown_heats
from bstm_daemon.gap.workflow import compare

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from bstm_daemon.gap.comparison import Comparison
    from bstm_daemon.gap.layout import Series
    from bstm_daemon.gap.noise import NodeNoise

CARS: Final = 12
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


@dataclass(frozen=True, slots=True)
class Case:
    """A case; no effects in an effect-free one."""

    world: World
    effects: tuple[str, ...]
    number: int

    @property
    def seed(self) -> int:
        """Seed of what is drawn for it."""
        text = f"{self.world} {' '.join(self.effects)} {self.number}"
        digest = hashlib.sha256(text.encode()).hexdigest()
        return int(digest[:8], 16)

    @property
    def car(self) -> int:
        """Number of its car."""
        if not self.effects:
            return self.number // DRAWS
        return self.seed % CARS

    @property
    def draw(self) -> int:
        """Number of its thermocouples' errors."""
        return self.number % DRAWS if not self.effects else 0

    @property
    def strengths(self) -> dict[str, float]:
        """Strength by hidden effect: log-uniform from 0.3 to 2."""
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
        effects = "+".join(self.effects) or "none"
        return f"{self.world}-{effects}-{self.number}"


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a case's drives show; ``change_k`` (n,) is what was hidden."""

    series: tuple[Series, ...]
    prior: np.ndarray
    sensed: Sensed
    change_k: np.ndarray

    def layout(self, noise: dict[str, NodeNoise]) -> Layout:
        """Return where its residuals are and how they err."""
        return Layout(self.series, noise, self.prior, FITTED)

    def changed(self, change: Callable[[Sensed], Sensed]) -> Evidence:
        """Return it with what the search is told changed."""
        return replace(self, sensed=change(self.sensed))

    def of_drive(self, drive: int) -> Evidence:
        """Return what one drive alone shows."""
        sizes = [len(one.time_s) for one in self.series]
        own = np.repeat([one.drive == drive for one in self.series], sizes)
        whole = self.sensed
        return Evidence(
            tuple(
                replace(one, drive=0)
                for one in self.series
                if one.drive == drive
            ),
            self.prior,
            Sensed(
                whole.base_k[own],
                whole.jacobian_k[own],
                {n: terms[:, own] for n, terms in whole.terms_k.items()},
                whole.silent,
                tuple(
                    UnknownHeat(one.node, one.regime, one.change[own])
                    for one in whole.unknown_k
                ),
            ),
            self.change_k[own],
        )


def without(*names: str) -> Callable[[Sensed], Sensed]:
    """Return what takes *names* out of the catalogue."""

    def change(one: Sensed) -> Sensed:
        kept = {n: t for n, t in one.terms_k.items() if n not in names}
        return replace(one, terms_k=kept)

    return change


def shuffled(seed: int) -> Callable[[Sensed], Sensed]:
    """Return what puts the catalogue into another order."""

    def change(one: Sensed) -> Sensed:
        names = list(one.terms_k)
        np.random.default_rng(seed).shuffle(names)
        return replace(one, terms_k={n: one.terms_k[n] for n in names})

    return change


def permuted(seed: int) -> Callable[[Sensed], Sensed]:
    """Return what gives each effect the signature of another."""

    def change(one: Sensed) -> Sensed:
        names = list(one.terms_k)
        order = np.random.default_rng(seed).permutation(len(names))
        # no name keeps its own
        order = np.roll(np.argsort(order), 1)[order]
        return replace(
            one,
            terms_k={
                name: one.terms_k[names[i]]
                for name, i in zip(names, order, strict=True)
            },
        )

    return change


def evidence(case: Case, garage: Garage, folder: Path) -> Evidence:
    """Return what is kept of *case*, or make it."""
    kept = folder / f"{case.key}.pickle"
    if not kept.exists():
        series, own, base_k, unknown = _made(case, garage)
        kept.write_bytes(pickle.dumps((series, own, base_k, unknown)))
    series, own, base_k, unknown = pickle.loads(  # noqa: S301  (own)
        kept.read_bytes()
    )
    shared = garage.sensed
    whole = own or replace(shared, base_k=base_k, unknown_k=unknown)
    return Evidence(series, garage.prior, whole, whole.base_k - shared.base_k)


def comparison_of(case: Case, garage: Garage) -> Comparison:
    """Return the model against the drives of *case*."""
    drives = [
        garage.recording(name, case.strengths, case.draw) for name in FITTED
    ]
    return compare(garage.target, drives)


def _made(
    case: Case, garage: Garage
) -> tuple[
    Sequence[Series],
    Sensed | None,
    np.ndarray | None,
    tuple[UnknownHeat, ...],
]:
    comparison = comparison_of(case, garage)
    shared = all(
        one.events is garage.driven(one.name).recording.events
        for one in comparison.recordings
    )
    if not shared:
        names = candidates(garage.target.config)
        return comparison.series, sensed(comparison, names), None, ()
    base_k = comparison.apart_k(comparison.start[None])[:, 0]
    unknown = unknown_heats(comparison, base_k)
    return comparison.series, None, base_k, unknown
