"""Constants of the vehicle observer: priors, noise, bounds, thresholds.

``docs/heat-input.md`` lists them in tables.
"""

from __future__ import annotations

from typing import Final

P0_STD: Final = (0.2, 0.15, 0.3, 0.02, 0.25, 0.08, 0.08, 0.02)
"""Prior standard deviations of the states: mass 20 %, bias 0.15 m/s2, drag
30 %, pitch 2 % of a change of speed, friction 25 %, its exponents 0.08, and
its drift 2 %."""

Q: Final = (1e-4, 3e-4, 2e-2, 1e-5, 5e-4, 1e-4, 1e-4, 0.0)
"""Process noise of each state (square root of the variance per second): a bend
turns the car against the wind, so that the drag changes within a minute; pads
bed in."""

MIN_STATE: Final = (0.5, -0.9, 0.2, -0.15, -1.1, -0.4, -0.4, -0.4)
MAX_STATE: Final = (2.0, 0.6, 3.0, 0.25, 0.7, 0.4, 0.4, 0.4)
"""Bounds of the states."""

PITCH: Final = 0.02
"""Share of a change of speed that the body pitch of a usual car adds."""

ROLLING_STD: Final = 0.02
"""Prior standard deviation of the configured g f_r [m/s2]: 0.002 of rolling
resistance."""

LOAD_STD: Final = 0.03
STOOD_S: Final = 30.0
"""Standard deviation of the mass ratio added by a stop of ``STOOD_S``."""

ACCEL_NOISE: Final = 0.05
TORQUE_NOISE: Final = 0.03
DRAG_TORQUE_NOISE: Final = 0.15
ASSUMED_TORQUE_STD: Final = 0.2
"""Standard deviations: of the acceleration over half a second [m/s2], of
driving torque and of engine drag [share], of an assumed torque [m/s2]."""

CORRELATED_WINDOWS: Final = 8.0
CORRELATED_GAIN_WINDOWS: Final = 30.0
"""Consecutive windows whose errors are correlated: gusts, bumps, torque maps;
for the gain more, as a road that levels off before a bend looks like one."""

WIND_SHARE: Final = 0.4
"""Standard deviation of the drag by gusts [share]."""

MODEL_NOISE: Final = 0.05
"""Standard deviation of ln friction in a window about the friction model."""

CAUTION: Final = 0.2
"""Share of the filter's variance that is published with the heat: the filters
take errors of drag and pitch as constant, while over a drive these change
sign. Fitted to the development cars of the population."""

OUTLIER: Final = 4.0
OUTLIER_MORE: Final = 0.405
OUTLIER_LESS: Final = 0.56
OUTLIER_S: Final = 5.0
OUTLIER_MOST_S: Final = 10.0
IDLE_OUTLIER: Final = 2.5
IDLE_DRIVE_MS2: Final = 0.15
HELD_BACK: Final = 0.3
EXTERNAL_MS2: Final = 0.35
"""Innovations beyond OUTLIER standard deviations are not learned from. With
less drive than IDLE_DRIVE_MS2 no slope makes the accelerometer measure a gain
of speed: there IDLE_OUTLIER are enough for an external force. Those of ln
friction by OUTLIER_MORE (1.5 times) or down by OUTLIER_LESS (1.75 times, as
linings fade) contradict from OUTLIER_S of braking on; and so do those of a
car that its drive moves by HELD_BACK of it less, from OUTLIER_S of drive."""

WINDOW_S: Final = 0.5
LEAST_SPEED_MS: Final = 4.0
MOST_LATERAL_MS2: Final = 2.0
CALM_S: Final = 1.0
RELEASED_S: Final = 0.7
PRESSED_S: Final = 0.4
LEAST_BRAKE_N: Final = 150.0
"""The filters use windows that follow CALM_S of calm driving (straight, no
gear change, slip, intervention or suspect input) with the brake off for
RELEASED_S or on for PRESSED_S, when chassis and tyres have settled."""

RATE_S: Final = 0.5
SLOW_RATE_S: Final = 4.0
RESTART_S: Final = 12.0
ROUGHNESS_S: Final = 10.0
ROUGHNESS_MS2: Final = 1.5
GAIN_RATE_MS2: Final = 0.4
GAIN_NOISE: Final = 0.12
"""Time constants of the band-pass in which the rate of speed is compared with
the accelerometer, and how long it must have run, as a start in mid-braking
leaves a transient. A speed with coarser steps than ROUGHNESS_MS2 (whole mph,
once a second) is not used."""

GAIN_LOW: Final = -0.2
GAIN_HIGH: Final = 0.2
UNMEASURED: Final = -0.6
GAIN_SQUARE_LEAST: Final = 20.0
GAIN_SQUARE_MOST: Final = 60.0
"""The gain is measured over actual change of speed, less 1: outside GAIN_LOW
to GAIN_HIGH the scale is wrong, below UNMEASURED nothing is measured. Least
and most sum of squares [m2/s4] that it is computed from."""

DRIFT_S: Final = 60.0
COPY_S: Final = 60.0
"""Time constant of the friction's drift; interval of the copies to which a
suspicion rolls back, which makes them one to two intervals old."""

EXTERNAL_S: Final = 2.0
EXTERNAL_HOLD_S: Final = 30.0
PROOF_S: Final = 5.0
EXTERNAL_SHARE: Final = 0.4
"""Time of contradiction that sets the suspicion of an external force, and of
agreement that clears it; the braking contradicts if it is significantly below
this share of Feed-Forward's. After an external force the pressure is proven
by PROOF_S of braking that is significantly above that share."""

GRADE_S: Final = 0.3
HEIGHT_PATH_M: Final = 1000.0
HEIGHT_NOISE_M: Final = 2.0

REFERENCE_SPEED_MS: Final = 10.0
REFERENCE_PRESSURE_PA: Final = 1e6
FORM_LIMIT: Final = 1.5

RADIUS_S: Final = 60.0
RADIUS_LIMIT: Final = 0.05
RADIUS_RATE_MS2: Final = 0.5
"""Relative difference of wheel and ground speed above which they disagree. A
receiver filters: while the speed changes faster, it is behind by as much."""

DEAD_MS2: Final = 2.0
DEAD_S: Final = 6.0
"""Least deceleration and its duration without any pressure."""

BALANCE_WINDOWS: Final = 120.0
BALANCE_LEAST: Final = 20.0
BALANCE_SPREAD_MS2: Final = 0.25
BALANCE_MS2: Final = 0.15
BALANCE_SHARE: Final = 0.15
BALANCE_MORE_MS2: Final = 0.3
BALANCE_MORE_SHARE: Final = 0.35
BALANCE_STEEP: Final = 1.4
BALANCE_MORE_FLAT: Final = 0.8
BALANCE_STDS: Final = 2.0
"""Braking by motion is a straight line over that by pressure, with a memory of
BALANCE_WINDOWS. Where the line is known (windows, spread of the braking by
pressure) and at no pressure is below 0 by more than BALANCE_MS2 and
BALANCE_SHARE of the mean braking by pressure, torque or accelerometer have an
offset and hide heat: a push-out of 1 bar makes 0.1 m/s2. Above 0 by the second
pair it is the pressure that lacks something: linings that lose friction under
pressure make 0.2 of the mean. A line too steep or too flat for sound linings
is none: their friction changed from stop to stop, as it fades and recovers."""

LEAST_MASS: Final = 0.65
MASS_STDS: Final = 2.0
"""A car without its load has 0.7 of the configured mass or more; a lower one
is learned from a torque that reads too little."""

EXTERNAL_SUSPECTED: Final = 1
OBSERVER_RESET: Final = 2
GAIN_SUSPECT: Final = 4
RADIUS_SUSPECT: Final = 8
PRESSURE_DEAD: Final = 16
FORCES_CONTRADICT: Final = 128
FORCES_UNPROVEN: Final = 4096
"""Bits of what the observer finds in a step."""
