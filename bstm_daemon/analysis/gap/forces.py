"""The car's brake force by pressure and by motion, drive by drive.

Motion counts with the brakes released, too: there both must be nothing, which
is what parts an error of the motion from one of the friction.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.statistics.series import Column, Indices
from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import Config
from bstm_daemon.model.effects.catalogue import edited_inputs
from bstm_daemon.model.effects.model import corrections_by_role
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.roles import ROLE_INDEX

WINDOW_S: Final = 1.0
MOST_WINDOWS: Final = 1500
SLOWEST_MS: Final = 3.0
"""Below, wheel speeds are coarse and the last jolt of a stop is in them."""

DRIVEN_NM: Final = 10.0
"""Where only the engine's torque is on the bus, more of it drives the car."""

AIDS: Final = ("abs_active", "esc_active", "tc_active")
"""While one of these acts, wheels slip and no force is read from them."""


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """Mean forces [N] over windows, (n,) each, positive for braking.

    ``pressed_n`` is of the pressure by corner, (corners, n), ``motion_n`` of
    the motion, nan where it is not known, ``inertia_n`` what of the motion
    accelerates or lifts the car; ``first`` is the step that a window
    begins at, ``braked`` the share of the window with the pressure on,
    ``rate_ms2`` the change of the speed, ``driven_n`` the force of the torque
    at the wheels, nan where it is not known, ``engine_nm`` what is known of
    the engine there, else nan, ``known_torque`` whether the bus has the
    drive's torque, ``has_accelerometer`` whether it counts.
    """

    drive: str
    first: Indices
    time_s: Column
    speed_ms: Column
    rate_ms2: Column
    braked: Column
    pressed_n: Column
    motion_n: Column
    inertia_n: Column
    driven_n: Column
    engine_nm: Column
    known_torque: bool
    has_accelerometer: bool

    @property
    def whole_n(self) -> Column:
        """The force of the pressure, all corners, (n,)."""
        return np.asarray(self.pressed_n.sum(axis=0))

    @property
    def metres(self) -> Column:
        """How far the car goes, by window, (n,)."""
        return np.asarray(self.speed_ms * np.gradient(self.time_s))


def forces(recording: Recording, config: Config) -> Forces:
    """Return the forces of *recording* as *config* with its effects has them.

    The windows of a recording are the same for every configuration.
    """
    inputs = recording.thin_inputs_of(config)
    steps = len(recording.drive)
    speed = inputs[:, 0, CHANNELS.index("speed_ms")]
    every = round(
        max(WINDOW_S, recording.drive.duration_s / MOST_WINDOWS) / GRID_S
    )
    motion, inertia, driven, has_accelerometer, known = _motion_n(
        recording, config, speed
    )
    engine = np.full(len(speed), np.nan)
    if not known and ROLE_INDEX["engine_torque"] in recording.present:
        read = recording.step_means(ROLE_INDEX["engine_torque"])
        engine = engine if read is None else read
        motion = np.where(engine > DRIVEN_NM, np.nan, motion)
    # running sums: both sides then have the same averaging
    distance = _running(speed)
    edges = np.arange(0, steps, every)
    if len(edges) < 2:
        edges = np.array([0, steps - 1])
    first, last = edges[:-1], edges[1:]
    length = np.maximum(distance[last] - distance[first], 1e-3)
    energy = inputs[:, :, CHANNELS.index("brake_energy_ff_j")]
    missing = _running(np.isnan(motion).astype(float))
    slow = _running((speed < SLOWEST_MS).astype(float))
    bad = (missing[last] > missing[first]) | (slow[last] > slow[first])
    brake_on = inputs[:, :, CHANNELS.index("brake_on")].max(axis=1)
    switch = ROLE_INDEX["brake_switch"]
    if switch in recording.present:
        on = recording.step_means(switch)
        if on is not None:
            brake_on = np.maximum(brake_on, np.nan_to_num(on))

    def mean(column: Column) -> Column:
        total = _running(column)
        return np.asarray((total[last] - total[first]) / (every * GRID_S))

    def by_way(column: Column) -> Column:
        work = _running(np.nan_to_num(column) * speed)
        found = (work[last] - work[first]) / length
        return np.where(bad, np.nan, found)

    return Forces(
        recording.name,
        first,
        recording.drive.time_s[first],
        mean(speed),
        (speed[last] - speed[first]) / (every * GRID_S),
        mean(brake_on),
        ((energy[last] - energy[first]) / length[:, None]).T,
        by_way(motion),
        by_way(inertia),
        mean(driven),
        mean(engine),
        known,
        has_accelerometer,
    )


def _running(rate: Column) -> Column:
    """Integrate *rate* to the middle of each step."""
    return np.asarray((np.cumsum(rate) - 0.5 * rate) * GRID_S)


def _motion_n(
    recording: Recording, config: Config, speed: Column
) -> tuple[Column, Column, Column, bool, bool]:
    """Return Eq 4.11 whether the brake is on or not, (steps,).

    And its inertia, the force of the torque, whether the accelerometer is
    used, and whether torque is known.
    """
    edited = edited_inputs(config)
    vehicle = Vehicle.of_config(edited.config.vehicle)
    corrections = corrections_by_role(edited.corrections)
    heat = edited.config.heat

    def held(role: str) -> Column | None:
        number = ROLE_INDEX[role]
        if number not in recording.present:
            return None
        gain, offset = corrections.get(number, (1.0, 0.0))
        found = recording.step_means(number)
        return None if found is None else gain * found + offset

    torque, accel_ms2 = held("powertrain_torque"), None
    if heat.slope == "accelerometer":
        accel_ms2 = held("acceleration_longitudinal")
    external = held("external_force")
    known = torque is not None
    if torque is None:
        assumed = heat.assume_powertrain_torque_nm
        torque = np.full(len(speed), np.nan if assumed is None else assumed)
    rate = np.gradient(speed, GRID_S) if len(speed) > 1 else 0.0 * speed
    drag = (vehicle.quadratic * speed + vehicle.linear) * speed
    driven = torque / vehicle.wheel_radius_m
    force = driven - drag - vehicle.constant
    if external is not None:
        force = force + external
    if accel_ms2 is None:
        inertia = vehicle.effective_mass_kg * rate
    else:
        inertia = vehicle.mass_kg * accel_ms2 + vehicle.rotating_mass_kg * rate
    force = force - inertia
    for role in AIDS:
        acting = held(role)
        if acting is not None:
            force = np.where(acting > 0.0, np.nan, force)
    return force, inertia, driven, accel_ms2 is not None, known
