"""What pressure and motion say of the car's brake force, side by side.

No thermocouple is needed: what the pressure says (Feed-Forward, Eq 4.1) and
what the motion says (Feed-Back, Eq 4.11) differ where either lacks something.
Friction as a whole, the resistances and the body's pitch are the tunables of
the residual. What differed on the drives of the car's match is taken off: its
linings have another law of friction, and its sensors their errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import trials
from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.forces import Forces, forces
from bstm_daemon.analysis.gap.form import DAILY
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.gap.signatures import candidates
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.matching.problem import Series
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.analysis.statistics.series import Column, Matrix, runs
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import LogError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.effects.catalogue import edited_inputs, effect_class
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.entries.friction_in_stop import RELEASE_S
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.model.heat.needs import INPUTS, check_inputs
from bstm_daemon.roles import CORNERS, ROLE_INDEX
from bstm_daemon.units import GRAVITY_MS2, KELVIN_OFFSET

COLD_C: Final = 20.0

PLAIN_MS2: Final = 0.1
SHORTEST: Final = 4.0
"""Braking that no pressure reports: so much, over so many windows, or harder
and shorter."""


def drag_n(
    effect: Effect, recording: Recording, part: Forces, config: Config
) -> Column:
    """Return the drag of released pads; hot ones rub more."""
    span = effect["hot_c"] - COLD_C
    total = np.zeros(len(part.speed_ms))
    for corner in config.disc_corners():
        program = compile_corner(config, corner)
        result = march([program], recording.drive, corner.name)
        pad_c = result["pad_back"][part.first, 0] - KELVIN_OFFSET
        hot = np.clip((pad_c - COLD_C) / span, 0.0, 1.0)
        cold = effect["cold_share"]
        total += cold + (1.0 - cold) * hot
    newton = effect.strength * effect["torque_nm"]
    newton /= config.vehicle.wheel_radius_m
    return np.asarray(newton * total * (1.0 - part.braked))


def bedded_n(
    effect: Effect,
    recording: Recording,  # noqa: ARG001
    part: Forces,
    config: Config,  # noqa: ARG001
) -> Column:
    """Return what friction loses while linings take up their first heat."""
    seconds = np.gradient(part.time_s)
    taken_j = np.cumsum(part.pressed_n * part.speed_ms * seconds, axis=1)
    drop = min(effect.strength * effect["drop"], 0.95)
    lost = drop * (1.0 - np.exp(-taken_j / effect["bedding_energy_j"]))
    return np.asarray(-(lost * part.pressed_n).sum(axis=0))


def unpressed_n(
    effect: Effect,
    recording: Recording,  # noqa: ARG001
    part: Forces,
    config: Config,
) -> Column:
    """Return the force of brakings that no pressure reports.

    A braking is a stretch of windows that are mostly released, with more force
    than usual then by :data:`PLAIN_MS2`, most of it not of the pressure, too
    long and too strong for noise, which so does not explain itself. The
    windows that it begins and ends in belong to it.
    """
    motion = np.nan_to_num(part.motion_n)
    known = (part.braked == 0.0) & np.isfinite(part.motion_n)
    # what the quietest quarter shows is the accelerometer's zero
    usual = float(np.quantile(motion[known], 0.25)) if known.any() else 0.0
    least = PLAIN_MS2 * config.vehicle.mass_kg
    beyond = motion - usual - 2.0 * part.whole_n
    own = (part.braked < 0.5) & (beyond > least)
    found = np.zeros(len(motion))
    for first, last in runs(own):
        if motion[first : last + 1].sum() >= SHORTEST * least:
            whole = slice(max(first - 1, 0), last + 2)
            released = 1.0 - part.braked[whole]
            found[whole] = np.maximum(motion[whole], 0.0) * released
    return np.asarray(effect.strength * found)


def held_n(
    effect: Effect,
    recording: Recording,  # noqa: ARG001
    part: Forces,
    config: Config,  # noqa: ARG001
) -> Column:
    """Return what friction gains while the brake is held.

    The memory of a window is that of its middle; a window that is braked in
    part holds and releases by its share.
    """
    seconds = np.gradient(part.time_s)
    rate = part.braked / effect["time_s"]
    fall = rate + (1.0 - part.braked) / RELEASE_S
    at_rest = rate / fall
    held = np.zeros(len(seconds))
    now = 0.0
    for i, (ends, half) in enumerate(
        zip(at_rest, np.exp(-0.5 * fall * seconds), strict=True)
    ):
        held[i] = ends + (now - ends) * half
        now = ends + (held[i] - ends) * half
    gained = effect.strength * effect["rise"]
    return np.asarray(gained * held * part.whole_n)


PATHS: Final = {
    "friction_in_stop": held_n,
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
"""Roles that show whether the brake is released."""

FRICTION: Final = 0.08
ENGINE_MS2: Final = 0.3
"""Priors: friction from day to day, and what an engine of unknown torque
brakes."""

WHOLE: Final = "friction"
STEADY: Final = {
    "air drag": (0.15, 0.15),
    "rolling resistance": (0.15, 0.15),
    "linear resistance": (0.3, 0.3),
    "pitch": (0.03, 0.01),
    "torque lag": (0.1, 0.02),
    WHOLE: (0.3, FRICTION),
}
"""Of the car, alike on all its drives: priors where no match knows it, and of
a drive about what a match knows. Shares of what is configured; of the pitch
[rad/g], and of the wheels behind the torque [s]."""

SCALE: Final = {"mass_error", "change.effect.mass_error.strength"}
"""What all forces are measured by. Were it free in a match, all of them would
shrink together to less than the noise of their signals."""

ENGINE_NM: Final = 3.0
LOW_GEAR: Final = 10.0
"""Error of the engine's torque, and wheel turns of the engine, at the most
while it coasts: what it may brake where only its own torque is known."""

DRIFT_MS2: Final = 0.03
LEAST_MS2: Final = 0.02
GRADE: Final = 0.02
"""Wind that comes and goes; accelerometer noise at the least; the road's
slope where no accelerometer measures it."""

SHARE: Final = 0.03
LAG_S: Final = 0.05
QUICK_S: Final = 0.1
"""Of a braking's force: scatter of friction, and timing of the signals."""


CHANGE: Final = 0.5
"""Strength that the change of an effect of the model is tried at."""


@dataclass(frozen=True, slots=True, eq=False)
class Tunable:
    """What may differ beside an effect.

    ``change_n`` (n,) is what it changes in the residual [N], ``prior`` its
    standard deviation; it has no name if it is of some drives alone.
    """

    name: str
    change_n: Column
    prior: float


class ForceComparison:
    """Force residuals of recordings: pressure less motion.

    Only windows count in which both are known. ``trials`` are effects of a
    matched model that may have changed, by name.
    """

    def __init__(
        self, config: Config, recordings: Sequence[Recording]
    ) -> None:
        """Take what is compared.

        Raises:
            LogError: a drive has no pressure or speed, or there is no window
                in which the motion shows a force.
        """
        what = "pressure against motion"
        for one in recordings:
            have = one.drive.roles, one.present
            check_inputs(one.name, *have, INPUTS["ff"], what)
        self.config, self.recordings = config, tuple(recordings)
        self.known = next((m for m in config.matched if m.forces), None)
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
        self._columns: dict[str, Column] = {}
        self._raw_n = self._residual(self.parts)
        self.noise_n = np.zeros(len(self._raw_n))
        """What the tunables leave of the residual, (n,)."""
        self.trials = trials(config, ()) if config.matched else {}
        self.steady_n = self._steady()
        self.tunables = self._tunables()
        known_n, unsure = self._known()
        self.base_n = self._raw_n + known_n
        self.tunables += unsure
        self.noise_n = self._left_n()
        if self.known:
            self.tunables += self._daily()
        self.layout = self._layout()

    @property
    def knows_released(self) -> bool:
        """Whether the bus reports that the driver's brake is released."""
        return all(
            any(ROLE_INDEX[name] in one.present for name in TELLING)
            for one in self.recordings
        )

    def changed_n(self, name: str) -> Column:
        """Return what *name* at strength 1 changes in the residual, (n,).

        Args:
            name: an effect, or one of the changes in ``trials``.
        """
        if name not in self._columns:
            self._columns[name] = self._changed_n(name)
        return self._columns[name]

    def _changed_n(self, name: str) -> Column:
        path = PATHS.get(name)
        if path is not None:
            typical = effect_class(name)({"strength": 1.0})
            pairs = zip(self.recordings, self.parts, strict=True)
            return self._counted(
                [path(typical, one, part, self.config) for one, part in pairs]
            )
        trial, step = self.trials.get(name), 1.0
        effects = [EffectConfig(name=name, parameters={"strength": 1.0})]
        if trial is not None:
            effects, step = trial.effects_at(CHANGE), CHANGE
        config = with_effects(self.config, effects)
        parts = [forces(one, config) for one in self.recordings]
        changed_n = self._residual(parts) - self._raw_n
        # a smaller mass has less noise too: that is not less of a gap
        more = _mass_kg(config) / _mass_kg(self.config) - 1.0
        return np.asarray((changed_n - more * self.noise_n) / step)

    def _known(self) -> tuple[Column, list[Tunable]]:
        """Return what the match knows of the residual, less than nothing.

        And what it does not know of that.
        """
        found = np.zeros(len(self._raw_n))
        unsure = []
        if known := self.known:
            for name, column in self.steady_n.items():
                found = found + known.forces.get(name, 0.0) * column
            there = {*candidates(self.config), *self.trials} - SCALE
            for name in sorted(there.intersection(known.forces)):
                column = self.changed_n(name)
                found = found + known.forces[name] * column
                unsure.append(Tunable(name, column, known.forces_sd[name]))
        return found, unsure

    def _daily(self) -> list[Tunable]:
        """Return by what drives of one car differ."""
        return [
            Tunable(name, column, DAILY[name])
            for name in sorted(DAILY)
            if name in candidates(self.config)
            and effect_class(name).kind == "heat"
            for column in self._each_day(self.changed_n(name))
        ]

    def _left_n(self) -> Column:
        """Return what the tunables leave of the residual, (n,): noise."""
        noise_n = LEAST_MS2 * self.vehicle.mass_kg
        jacobian = self.jacobian_n / noise_n
        project = Projector(jacobian, self.prior)
        found = project.nuisance(self.base_n / noise_n)
        return np.asarray(self.base_n + self.jacobian_n @ found)

    @property
    def jacobian_n(self) -> Matrix:
        """What the tunables change in the residual, (n, p)."""
        return np.column_stack([one.change_n for one in self.tunables])

    @property
    def prior(self) -> Column:
        """Standard deviations of the tunables, (p,)."""
        return np.array([one.prior for one in self.tunables])

    def _residual(self, parts: Sequence[Forces]) -> Column:
        return self._counted([one.whole_n - one.motion_n for one in parts])

    def _counted(self, columns: Sequence[Column]) -> Column:
        """Return of *columns*, one a recording, the windows that count."""
        pairs = zip(columns, self.kept, strict=True)
        return np.concatenate([one[own] for one, own in pairs])

    def column(self, name: str) -> Column:
        """Return a column of the windows that count, (n,)."""
        return self._counted([getattr(one, name) for one in self.parts])

    def _steady(self) -> dict[str, Column]:
        """Return each of :data:`STEADY` that acts here, (n,), by name."""
        speed, vehicle = self.column("speed_ms"), self.vehicle
        found = {
            "air drag": vehicle.quadratic * speed**2,
            "rolling resistance": np.full(len(speed), vehicle.constant),
            "linear resistance": vehicle.linear * speed,
        }
        if self.parts[0].has_accelerometer:
            found["pitch"] = vehicle.mass_kg * self.column("rate_ms2")
        if self.parts[0].known_torque:
            found["torque lag"] = self._counted(
                [
                    np.nan_to_num(np.gradient(one.driven_n, one.time_s))
                    for one in self.parts
                ]
            )
        return found | {WHOLE: self.column("whole_n")}

    def _tunables(self) -> list[Tunable]:
        """Return friction drive by drive, resistances and the engine."""
        found = [
            Tunable("", day, FRICTION)
            for day in self._each_day(self.steady_n[WHOLE])
        ]
        learned = self.known.forces if self.known else {}
        found += [
            Tunable(name, column, STEADY[name][name in learned])
            for name, column in self.steady_n.items()
            if name != WHOLE
        ]
        if not self.parts[0].known_torque:
            engine_n = self._engine_n(self.vehicle.mass_kg)
            found.append(Tunable("", engine_n, 1.0))
        return found

    def _each_day(self, column: Column) -> list[Column]:
        """Return *column* (n,) for each drive alone."""
        count = [int(own.sum()) for own in self.kept]
        drive = np.repeat(np.arange(len(count)), count)
        return [np.where(drive == i, column, 0.0) for i in range(len(count))]

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
            pressed = one.whole_n
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
        if not self.parts[0].has_accelerometer:
            white = max(white, GRADE * GRAVITY_MS2 * mass)
        if not self.parts[0].known_torque:
            white = max(white, 0.5 * float(np.mean(self._engine_n(mass))))
        noise = SensorNoise(
            white, DRIFT_MS2 * mass, SHARE, 0.0, LAG_S, QUICK_S
        )
        return Layout(
            [one for one in series if len(one.time_s)],
            {"force": noise},
            self.prior,
            [one.name for one in self.recordings],
        )


def _mass_kg(config: Config) -> float:
    return edited_inputs(config).config.vehicle.mass_kg


def _kept(part: Forces) -> Column:
    """Return which windows count: where the motion tells the brakes' force.

    With an unknown torque, a car that is driven shows nothing.
    """
    known = np.isfinite(part.motion_n)
    if part.known_torque:
        return known
    return np.asarray(known & (np.nan_to_num(part.motion_n) > 0.0))
