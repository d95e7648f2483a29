"""What a case of the gap benchmark came to, and whether that is right."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from math import nan
from typing import TYPE_CHECKING, Any, Final

import gap_limits
from gap_cars import FITTED, Garage
from gap_cases import (
    TWIN_NUMBERS,
    Case,
    Evidence,
    comparison_of,
    evidence,
    permuted,
    shuffled,
    without,
)
from gap_rivals import RIVALS

from bstm_daemon.analysis.gap.composing import with_composed
from bstm_daemon.analysis.gap.naming import ALIKE, cosine, name_effect
from bstm_daemon.analysis.gap.noise import calibrated, noise_of
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.model.effects.composed import PREFIX, is_composed, read
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.simulation.parameters import UNHEARD_NAMES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.gap.noise import Layout
    from bstm_daemon.analysis.gap.signatures import Linearised

DETECTABLE: Final = 30.0
"""Expected squared distance from the re-fitted baseline, whitened."""

PLACES: Final[dict[str, tuple[str, str]]] = {
    "friction_fade": ("Q", "B"),
    "friction_speed": ("Q", "B"),
    "friction_pressure": ("Q", "B"),
    "friction_history": ("Q", "B"),
    "pushout_pressure": ("Q", "B"),
    "hydraulic_lag": ("Q", "B"),
    "residual_drag": ("D", "V"),
    "contact_conductance": ("DP", "B"),
    "gap_conduction": ("DP", "VP"),
    "disc_capacity_hot": ("D", "BV"),
    "disc_radiation_driving": ("D", "BV"),
    "convection_exponent": ("D", "V"),
    "local_air": ("DBF", "VP"),
    "hub_conduction": ("D", "BVP"),
    "wet_disc": ("D", "V"),
    "disc_wear": ("D", "BV"),
    "disc_hat": ("D", "BVP"),
    "pad_conductivity": ("PB", "BP"),
    "pad_capacity": ("PB", "BVP"),
    "pad_pyrolysis": ("P", "B"),
    "pad_wear": ("PBF", "BVP"),
    "backplate_loss": ("B", "BVP"),
    "bracket_conduction": ("B", "BVP"),
    "caliper_bypass": ("BF", "BVP"),
    "shim_contact": ("BF", "VP"),
    "disc_caliper_radiation": ("DF", "VP"),
    "caliper_fluid_split": ("F", "BVP"),
    "caliper_radiation": ("F", "VP"),
    "fluid_exchange": ("F", "BP"),
    "fluid_latent_heat": ("F", "P"),
    "thermocouple_offset": ("DPBF", "BVP"),
    "thermocouple_lag": ("DPBF", "BV"),
    "accelerometer_bias": ("Q", "B"),
    "mass_error": ("Q", "B"),
    "brake_share": ("Q", "B"),
    "powertrain_torque_error": ("Q", "B"),
    "ambient_heat_soak": ("DPBF", "P"),
    "speed_dependent_convection": ("D", "BV"),
    "brake_without_pressure": ("Q", "B"),
    "hub_heat": ("D", "VP"),
    "engine_heat": ("F", "VP"),
    "layer_opening": ("BF", "BVP"),
    "cooling_band": ("D", "V"),
    "friction_in_stop": ("Q", "B"),
    "clock_offset": ("DPBF", "BV"),
    # in no catalogue
    "dust_shield": ("DF", "BVP"),
    "brake_duct": ("D", "BV"),
    "damper_heat": ("F", "BV"),
}
"""Nodes (heat input Q, disc D, front P and back B of the pads, fluid F) and
phases (braking, driving, parked) of each effect."""

DESCRIBED: Final = {"damper_heat": "engine_heat"}
"""The entry that describes an effect of no catalogue, which is taken out."""

_NODES: Final = {"disc": "D", "pad_front": "P", "pad_back": "B", "fluid": "F"}


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a case in one group."""

    group: str
    effects: list[str]
    strengths: list[float]
    number: int
    distance2: float
    answer: str
    names: list[str]
    probability: float
    gate_z: float
    place: str
    leading: list[str]
    twins: list[str] = field(default_factory=list)
    sensor_distance2: float = 0.0
    shown: dict[str, Any] = field(default_factory=dict)
    limit: float = nan

    @property
    def effect(self) -> str:
        """The hidden effect, empty if none."""
        return self.effects[0] if self.effects else ""

    @property
    def detectable(self) -> bool:
        """Whether the data could show it at all."""
        return self.distance2 >= DETECTABLE

    @property
    def score(self) -> float:
        """1 for the right name or a class of two with it, 1/size beyond."""
        if self.answer == "name":
            return float(set(self.names) == set(self.effects))
        if self.answer == "class" and set(self.effects) <= set(self.names):
            return 1.0 if len(self.names) <= 2 else 1.0 / len(self.names)
        return 0.0

    @property
    def wrong_name(self) -> bool:
        """Whether a name was given, not as a class, that is not hidden."""
        return self.answer == "name" and not set(self.names) <= set(
            self.effects
        )

    @property
    def right_place(self) -> bool:
        """Whether what was named acts on a node and in a phase of the truth.

        Without a name: where heat without a name was seen.
        """
        said = [
            composed_place(name) if is_composed(name) else PLACES[name]
            for name in self.names
        ]
        if self.answer == "unknown":
            # a reading is at none
            heat = self.place.removeprefix("heat at ")
            node, _, regime = heat.partition(", ")
            said = [(_NODES.get(node, "?"), _PHASES.get(regime, "?"))]
            if node == "disc" and regime == "braking":
                said = [("DQ", "B")]
        return bool(said) and all(
            any(
                set(nodes) & set(PLACES[e][0])
                and set(phases) & set(PLACES[e][1])
                for e in self.effects
            )
            for nodes, phases in said
        )


_PHASES: Final = {
    "braking": "B",
    "driving": "V",
    "parked": "P",
    "brake off": "VP",
}


def composed_place(name: str) -> tuple[str, str]:
    """Return nodes and phases that the composed term *name* acts on."""
    term = read(name.removeprefix(PREFIX))
    ends = {"Q"} if term.path.kind == "heat" else {term.path.a, term.path.b}
    phases = [
        _PHASES[form.words]
        for form, _ in term.clauses
        if form.words in _PHASES
    ]
    nodes = "".join(_NODES.get(end, end[:1]) for end in sorted(ends))
    return nodes.replace("a", ""), "".join(phases) or "BVP"


COMPOSING: Final = frozenset({"S0", "S1", "SO", "SU"})
"""Groups that are judged with composed effects."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A case whitened: what the answers of all its groups share."""

    case: Case
    layout: Layout
    known: Linearised
    distance2: float
    sensor_distance2: float
    twins: tuple[str, ...]
    jacobian_k: np.ndarray
    change: np.ndarray
    compared: Callable[[], Comparison]

    def answer(self, group: str, known: Linearised | None = None) -> Result:
        """Return what the search answers, told *known* instead."""
        case = self.case
        known = known or self.known
        found = name_effect(self.layout, known)
        if found.found and group in COMPOSING:
            comparison = self.compared()
            comparison.set_noise(self.layout.noise)
            _, found = with_composed(comparison, self.layout, known, found)
        return Result(
            group,
            list(case.effects),
            [case.strengths[name] for name in case.effects],
            case.number,
            self.distance2,
            found.answer,
            list(found.names),
            found.probability,
            found.gate_z,
            found.unknown_place,
            [one.name for one in found.candidates[:3]],
            list(self.twins),
            self.sensor_distance2,
            limit=self._limit(group, known),
        )

    def _limit(self, group: str, known: Linearised) -> float:
        """Return what could be right at all, nan where that is not asked."""
        project = Projector(known.jacobian, self.layout.prior)
        if group in {"SO", "SU"}:
            return gap_limits.without_name(project, self.change, known)
        if group in {"S1", "ST"}:
            hidden = self.case.effects
            others = [s for s in known.signatures if s.name not in hidden]
            return gap_limits.named(project, self.change, others, self.twins)
        return nan


def judged(case: Case, garage: Garage, kept: Evidence) -> Judged:
    """Return *kept* whitened, with what could be seen of the effect."""
    noise = {
        node: noise_of(garage.target.config, node) for node in MEASURED_NODES
    }
    layout = kept.layout(noise)
    sensed = kept.sensed
    layout.set_noise(calibrated(layout, sensed.base_k, sensed.columns_k()))
    known = kept.sensed.whitened(layout)
    project = Projector(known.jacobian, layout.prior)
    change = layout.whiten(kept.change_k)
    own = next((s for s in known.signatures if s.name in case.effects), None)
    twins = []
    if own is not None:
        for other in known.signatures:
            alike = abs(cosine(project, own, other)) > ALIKE
            if alike and other.name != own.name:
                twins.append(other.name)
    distance2 = float(change @ project(change))
    if len(case.effects) > 1:
        distance2 = min(_beside(case, layout, known))
    return Judged(
        case,
        layout,
        known,
        distance2,
        gap_limits.of_sensors(case.world.sensors, kept, layout),
        tuple(twins),
        kept.sensed.jacobian_k,
        change,
        cache(lambda: comparison_of(case, garage)),
    )


def _rivals(one: Judged, kept: Evidence) -> list[Result]:
    """Return what other ways answer."""
    found = []
    for label, ask in RIVALS.items():
        names = ask(kept)
        found.append(
            Result(
                label,
                list(one.case.effects),
                list(one.case.strengths.values()),
                one.case.number,
                one.distance2,
                "name" if names else "nothing",
                names,
                0.0,
                0.0,
                "",
                names[:3],
                list(one.twins),
            )
        )
    return found


def _beside(case: Case, layout: Layout, known: Linearised) -> list[float]:
    """Return what each effect alone would show, the others free."""
    by_name = {one.name: one for one in known.signatures}
    tunables = Projector(known.jacobian, layout.prior)
    found = []
    for name, strength in case.strengths.items():
        if name not in by_name:  # these drives do not excite it
            return [0.0]
        others = [by_name[n].at(1.0) for n in case.effects if n != name]
        project = tunables.beside(others)
        change = by_name[name].at(strength)
        found.append(float(change @ project(change)))
    return found


def group_of(case: Case) -> str:
    """Return the group that *case* is of."""
    for group, belongs in (
        ("RT", bool(case.world.always_on)),
        ("S0", not case.effects),
        ("absent", case.absent),
        ("S2", len(case.effects) > 1),
        ("SU", set(case.effects) <= set(UNHEARD_NAMES)),
        ("ST", case.number >= TWIN_NUMBERS),
    ):
        if belongs:
            return group
    return "S1"


def results_of(
    case: Case, garage: Garage, folder: Path, *, controls: bool = False
) -> list[Result]:
    """Return the results of *case* in all groups that its drives serve."""
    kept = evidence(case, garage, folder)
    one = judged(case, garage, kept)
    group = group_of(case)
    if group == "S0":
        return [one.answer(group), *_rivals(one, kept)]
    if group != "S1":
        described = [DESCRIBED.get(name, name) for name in case.effects]
        known = without(one.known, described) if group == "SU" else one.known
        return [one.answer(group, known)]
    alone = judged(case, garage, kept.of_drive(FITTED.index("simalp")))
    found = [
        one.answer(group),
        one.answer("SO", without(one.known, case.effects)),
        alone.answer("SX"),
        *_rivals(one, kept),
    ]
    if controls:
        found += [
            one.answer("shuffled", shuffled(one.known, case.seed)),
            one.answer("permuted", permuted(one.known, case.seed)),
        ]
    return found
