"""Residuals without a thermocouple: force of the pressure, of the motion.

Friction as a whole, the resistances and the body's pitch are their tunables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.effects.catalogue import effect_class
from bstm_daemon.errors import LogError
from bstm_daemon.gap.comparison import with_effects
from bstm_daemon.gap.force_balance import forces
from bstm_daemon.gap.force_paths import bedded_n, drag_n, unpressed_n
from bstm_daemon.gap.layout import Layout, Series
from bstm_daemon.gap.noise import NodeNoise
from bstm_daemon.heat.feed_back import Vehicle
from bstm_daemon.roles import CORNERS, ROLE_INDEX
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import Config, EffectConfig
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


def _kept(part: Forces) -> Column:
    """Return which windows count: where the motion tells the brakes' force.

    With an unknown torque, a car that is driven tells nothing.
    """
    known = np.isfinite(part.motion_n)
    if part.known_torque:
        return known
    return np.asarray(known & (np.nan_to_num(part.motion_n) > 0.0))
