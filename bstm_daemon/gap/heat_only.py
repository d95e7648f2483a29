"""The gap without a thermocouple: Feed-Forward against Feed-Back.

Effects on the heat input leave their trace in forces before they do in
temperatures. The residual is the force of the pressure less that of the
motion; friction as a whole, the resistances and the body's pitch are
integrated out as tunables are, and the rest is the naming of
:mod:`bstm_daemon.gap.naming`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.config import EffectConfig
from bstm_daemon.effects.catalogue import effect_class
from bstm_daemon.errors import LogError
from bstm_daemon.gap.comparison import with_effects
from bstm_daemon.gap.fitting import FORM_ERROR, effect_entries
from bstm_daemon.gap.force_balance import forces
from bstm_daemon.gap.force_paths import bedded_n, drag_n, unpressed_n
from bstm_daemon.gap.layout import Layout, Series
from bstm_daemon.gap.naming import Naming, name_effect
from bstm_daemon.gap.noise import NodeNoise
from bstm_daemon.gap.projector import FREE, Projector
from bstm_daemon.gap.signatures import Linearised, Signature, candidates
from bstm_daemon.heat.feed_back import Vehicle
from bstm_daemon.roles import CORNERS, ROLE_INDEX
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import Config
    from bstm_daemon.gap.force_balance import Forces
    from bstm_daemon.gap.recording import Recording
    from bstm_daemon.matching.drives import Column

PATHS: Final = {
    "residual_drag": drag_n,
    "friction_history": bedded_n,
    "brake_without_pressure": unpressed_n,
}
"""Effects whose force is not formed by the pass over samples."""

TELLING: Final = (
    "brake_switch",
    "primary_pressure",
    "secondary_pressure",
    *(f"wheel_pressure_{corner.lower()}" for corner in CORNERS),
)
"""Roles that tell whether the brake is released."""

NOTHING_SEEN: Final = (
    "no effect on the heat input changes the forces of these drives by more "
    "than they are uncertain, friction and resistances re-fitted"
)

SILENT_MS2: Final = 1e-3
"""An effect that nowhere changes the car's acceleration by more is silent."""

WEAK: Final = 2.0
"""From this strength on an effect counts as too weak for these drives."""

FRICTION: Final = 0.08
RESISTANCE: Final = 0.15
PITCH: Final = 0.03
ENGINE_MS2: Final = 0.3
"""Priors: friction from day to day, drag and rolling, pitch [rad/g], and
what an engine of unknown torque brakes."""

ENGINE_NM: Final = 3.0
LOW_GEAR: Final = 10.0
"""Error of the engine's torque, and wheel turns of the engine, at the most
while it coasts: what it may brake where only its own torque is known."""

DRIFT_MS2: Final = 0.03
LEAST_MS2: Final = 0.02
GRADE: Final = 0.02
"""Wind that comes and goes; accelerometer noise at the least; the road's
slope where nothing feels it."""

SHARE: Final = 0.03
LAG_S: Final = 0.05
QUICK_S: Final = 0.1
"""Of a braking's force: scatter of friction, and timing of the signals."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceCurve:
    """Forces [N] over one drive, (n,) each; nan where not known."""

    drive: str
    time_s: Column
    pressed_n: Column
    motion_n: Column


@dataclass(frozen=True, slots=True, eq=False)
class ForceGap:
    """What forces alone tell.

    ``seen`` are strengths from which each effect shows, ``unseen`` why one
    does not. ``before`` and ``after`` are RMS errors of the acceleration
    [m/s2] on ``shown_on``, without and with ``strengths``; ``pressed_j`` and
    ``motion_j`` the work of pressure and motion while braking.
    """

    recordings: tuple[str, ...]
    windows: int
    naming: Naming
    strengths: dict[str, float]
    deviations: dict[str, float]
    seen: dict[str, float]
    unseen: dict[str, str]
    shown_on: tuple[str, ...]
    held_out: bool
    before_ms2: float
    after_ms2: float
    pressed_j: float
    motion_j: float
    curves: tuple[ForceCurve, ...] = ()

    def effects(self) -> list[EffectConfig]:
        """Return what can be adopted, with its provenance."""
        found = []
        for name, strength in self.strengths.items():
            found += effect_entries(
                {name: strength},
                {
                    "source": "bstm gap, forces",
                    "data": list(self.recordings),
                    "date": time.strftime("%Y-%m-%d"),
                    "strength_sd": round(self.deviations[name], 3),
                    **self.naming.provenance(name),
                },
            )
        return found


class ForceComparison:
    """Force residuals of recordings: pressure less motion.

    Only windows count in which both are known.
    """

    def __init__(
        self, config: Config, recordings: Sequence[Recording]
    ) -> None:
        """Take what is compared.

        Raises:
            LogError: no window in which the motion tells a force.
        """
        self.config, self.recordings = config, tuple(recordings)
        self.vehicle = Vehicle.of_config(config.vehicle)
        self.parts = [forces(one, config) for one in recordings]
        self.kept = [_kept(one) for one in self.parts]
        if not any(own.any() for own in self.kept):
            names = ", ".join(one.name for one in recordings)
            msg = (
                f"{names}: no brake force from the motion: this needs speed, "
                "and torque or [heat] assume_powertrain_torque_nm"
            )
            raise LogError(msg)
        self.base_n = self._residual(self.parts)
        columns, self.prior = self._tunables()
        self.layout = self._layout()
        self.jacobian_n = columns

    @property
    def knows_released(self) -> bool:
        """Whether the bus tells that the driver's brake is released."""
        return all(
            any(ROLE_INDEX[name] in one.present for name in TELLING)
            for one in self.recordings
        )

    def changed_n(self, effect: EffectConfig) -> Column:
        """Return what *effect* changes in the residual, (n,)."""
        path = PATHS.get(effect.name)
        if path is not None:
            typical = effect_class(effect.name)(effect.parameters)
            return np.concatenate(
                [
                    path(typical, one, part, self.config)[own]
                    for one, part, own in zip(
                        self.recordings, self.parts, self.kept, strict=True
                    )
                ]
            )
        config = with_effects(self.config, [effect])
        parts = [forces(one, config) for one in self.recordings]
        return self._residual(parts) - self.base_n

    def _residual(self, parts: Sequence[Forces]) -> Column:
        return np.concatenate(
            [
                (one.pressed_n.sum(axis=0) - one.motion_n)[own]
                for one, own in zip(parts, self.kept, strict=True)
            ]
        )

    def column(self, name: str) -> Column:
        """Return a column of the windows that count, (n,)."""
        return np.concatenate(
            [
                np.asarray(getattr(one, name))[own]
                for one, own in zip(self.parts, self.kept, strict=True)
            ]
        )

    def pressed_n(self) -> Column:
        """Return the force of the pressure, all corners, (n,)."""
        return np.concatenate(
            [
                one.pressed_n.sum(axis=0)[own]
                for one, own in zip(self.parts, self.kept, strict=True)
            ]
        )

    def _tunables(self) -> tuple[Column, Column]:
        speed, mass = self.column("speed_ms"), self.vehicle.mass_kg
        columns = [
            self.pressed_n(),
            self.vehicle.quadratic * speed**2,
            np.full(len(speed), self.vehicle.constant),
            self.vehicle.linear * speed,
        ]
        priors = [FRICTION, RESISTANCE, RESISTANCE, 2.0 * RESISTANCE]
        if self.parts[0].felt:
            columns.append(mass * self.column("rate_ms2"))
            priors.append(PITCH)
        if not self.parts[0].known_torque:
            columns.append(self._engine_n(mass))
            priors.append(1.0)
        return np.column_stack(columns), np.array(priors)

    def _engine_n(self, mass: float) -> Column:
        """Return what the engine may brake, one standard deviation, (n,)."""
        engine_nm = np.abs(self.column("engine_nm")) + ENGINE_NM
        known = engine_nm * LOW_GEAR / self.vehicle.wheel_radius_m
        unknown = ENGINE_MS2 * mass
        return np.where(np.isnan(known), unknown, np.minimum(known, unknown))

    def _layout(self) -> Layout:
        mass = self.vehicle.mass_kg
        white = LEAST_MS2 * mass
        series = []
        for number, (one, own) in enumerate(
            zip(self.parts, self.kept, strict=True)
        ):
            pressed = one.pressed_n.sum(axis=0)
            residual = (pressed - one.motion_n)[own]
            quiet = np.diff(residual[one.braked[own] == 0.0])
            if len(quiet) > 10:
                scatter = 1.05 * float(np.median(np.abs(quiet)))
                white = max(white, min(scatter, 0.3 * mass))
            size = np.maximum(pressed, np.nan_to_num(np.abs(one.motion_n)))
            series.append(
                Series(
                    number,
                    "force",
                    (),
                    one.first[own],
                    one.time_s[own],
                    residual,
                    np.gradient(size, one.time_s)[own],
                    size[own],
                )
            )
        if not self.parts[0].felt:
            white = max(white, GRADE * GRAVITY_MS2 * mass)
        if not self.parts[0].known_torque:
            white = max(white, 0.5 * float(np.mean(self._engine_n(mass))))
        noise = NodeNoise(white, DRIFT_MS2 * mass, SHARE, 0.0, LAG_S, QUICK_S)
        return Layout(
            [one for one in series if len(one.time_s)],
            {"force": noise},
            self.prior,
            [one.name for one in self.recordings],
        )


def find_force_gap(
    config: Config,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
) -> ForceGap:
    """Search *recordings* for effects on the heat input, by forces alone.

    Raises:
        LogError: the motion tells no force.
    """
    comparison = ForceComparison(config, recordings)
    known, unseen = _linearised(comparison)
    naming = name_effect(comparison.layout, known)
    if naming.answer == "nothing":
        naming = replace(naming, reason=NOTHING_SEEN)
    seen = {}
    for one in naming.candidates:
        if one.reach <= WEAK:
            seen[one.name] = one.reach
        else:
            unseen[one.name] = (
                f"too weak in these drives: from a strength of {one.reach:.1f}"
            )
    names: tuple[str, ...] = ()
    if naming.answer in {"name", "class"}:
        names = naming.names if naming.answer == "name" else naming.names[:1]
    strengths, deviations = _strengths(comparison, known, names)
    possible = tuple(n for n in names if not _at_bound(n, strengths[n]))
    if naming.answer == "name" and 0 < len(possible) < len(names):
        # beside the first, what no car has is a leftover of its form
        naming = replace(naming, names=possible)
        strengths, deviations = _strengths(comparison, known, possible)
    others = held_out or recordings
    before, after = _errors(config, others, strengths)
    pressed, motion = _work(comparison)
    return ForceGap(
        tuple(one.name for one in recordings),
        len(comparison.base_n),
        naming,
        strengths,
        deviations,
        dict(sorted(seen.items(), key=lambda item: item[1])),
        unseen,
        tuple(one.name for one in others),
        bool(held_out),
        before,
        after,
        pressed,
        motion,
        tuple(
            ForceCurve(
                one.name,
                part.time_s,
                part.pressed_n.sum(axis=0),
                part.motion_n,
            )
            for one, part in zip(recordings, comparison.parts, strict=True)
        ),
    )


def _kept(part: Forces) -> Column:
    """Return which windows count: where the motion tells the brakes' force.

    With an unknown torque, a car that is driven tells nothing.
    """
    known = np.isfinite(part.motion_n)
    if part.known_torque:
        return known
    return np.asarray(known & (np.nan_to_num(part.motion_n) > 0.0))


def _linearised(
    comparison: ForceComparison,
) -> tuple[Linearised, dict[str, str]]:
    layout, mass = comparison.layout, comparison.vehicle.mass_kg
    found, unseen = [], {}
    for name in candidates(comparison.config):
        cls = effect_class(name)
        if cls.kind != "heat":
            unseen[name] = "moves temperatures only: needs a thermocouple"
            continue
        if name == "brake_without_pressure" and not comparison.knows_released:
            unseen[name] = "neither pressure nor brake switch on the bus"
            continue
        effect = EffectConfig(name=name, parameters={"strength": 1.0})
        change = comparison.changed_n(effect)
        if float(np.abs(change).max()) < SILENT_MS2 * mass:
            unseen[name] = "changes no force of these drives"
            continue
        white = layout.whiten(change)
        found.append(
            Signature(name, white, 0.0 * white, change, cls.either_sign)
        )
    return (
        Linearised(
            layout.whiten(comparison.base_n),
            layout.whiten(comparison.jacobian_n),
            tuple(found),
            tuple(n for n, why in unseen.items() if why.startswith("changes")),
            (),
        ),
        unseen,
    )


def _strengths(
    comparison: ForceComparison, known: Linearised, names: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return strengths of *names* fitted together, and their deviations.

    What their forms are off by is in the deviations.
    """
    if not names:
        return {}, {}
    by_name = {one.name: one for one in known.signatures}
    columns = np.column_stack([by_name[name].linear for name in names])
    project = Projector(known.jacobian, comparison.prior)
    projected = project(columns)
    normal = columns.T @ projected + np.eye(len(names)) / FREE**2
    covariance = np.linalg.inv(normal)
    best = -covariance @ (projected.T @ known.residual)
    strengths, deviations = {}, {}
    for i, name in enumerate(names):
        bounds = effect_class(name).parameters()[0]
        strengths[name] = float(np.clip(best[i], bounds.lower, bounds.upper))
        deviations[name] = float(
            np.hypot(covariance[i, i] ** 0.5, FORM_ERROR * strengths[name])
        )
    return strengths, deviations


def _at_bound(name: str, strength: float) -> bool:
    bounds = effect_class(name).parameters()[0]
    return not bounds.lower < strength < bounds.upper


def _errors(
    config: Config,
    recordings: Sequence[Recording],
    strengths: dict[str, float],
) -> tuple[float, float]:
    """Return RMS errors of the acceleration [m/s2], without and with.

    The nuisances are fitted in both; white noise is taken off.
    """
    comparison = ForceComparison(config, recordings)
    mass = comparison.vehicle.mass_kg
    white = comparison.layout.noise["force"].white_k
    project = Projector(
        comparison.layout.whiten(comparison.jacobian_n), comparison.prior
    )
    residual = comparison.base_n
    found = []
    for effects in ({}, strengths):
        apart = residual.copy()
        for name, strength in effects.items():
            one = EffectConfig(name=name, parameters={"strength": 1.0})
            apart = apart + strength * comparison.changed_n(one)
        tunables = project.tunables(comparison.layout.whiten(apart))
        left = apart + comparison.jacobian_n @ tunables
        power = float(np.mean(left**2)) - white**2
        found.append(max(power, 0.0) ** 0.5 / mass)
    return found[0], found[1]


def _work(comparison: ForceComparison) -> tuple[float, float]:
    """Return the work of pressure and of motion while braking [J]."""
    pressed = comparison.pressed_n()
    motion = comparison.column("motion_n")
    braked = (comparison.column("braked") > 0.0) | (
        motion > comparison.config.heat.brake_on_force_n
    )
    metres = np.concatenate(
        [
            (one.speed_ms * np.gradient(one.time_s))[own]
            for one, own in zip(comparison.parts, comparison.kept, strict=True)
        ]
    )
    return (
        float(np.sum((pressed * metres)[braked])),
        float(np.sum((motion * metres)[braked])),
    )
