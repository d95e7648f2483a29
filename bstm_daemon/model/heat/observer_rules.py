"""Constants of the observer of the car, and of what it learns.

``docs/heat.md`` has them in tables.
"""

from __future__ import annotations

from typing import Final

P0_STD: Final = (0.2, 0.15, 0.3, 0.02, 0.25, 0.08, 0.08, 0.02)
"""Standard deviations of the states before anything is learned: mass 20 %,
bias 0.15 m/s2, drag 30 %, pitch 2 % of a change of speed, friction 25 %, its
exponents 0.08, and what of it passes 2 %."""

Q: Final = (1e-4, 3e-4, 2e-2, 1e-5, 5e-4, 1e-4, 1e-4, 0.0)
"""Process noise: by how much each may change within a second (square root of
the variance a second): wind turns with the road, which by drag is another one
within the minute; pads bed in."""

MIN_STATE: Final = (0.5, -0.9, 0.2, -0.15, -1.1, -0.4, -0.4, -0.4)
MAX_STATE: Final = (2.0, 0.6, 3.0, 0.25, 0.7, 0.4, 0.4, 0.4)
"""Bounds of the states."""

PITCH: Final = 0.02
"""Body pitch of a usual car: measured beyond a change of speed."""

ROLLING_STD: Final = 0.02
"""Error of the configured g f_r: 0.002 of rolling resistance [m/s2]."""

LOAD_STD: Final = 0.03
STOOD_S: Final = 30.0
"""After so long a stand the mass may have changed by so much."""

ACCEL_NOISE: Final = 0.05
TORQUE_NOISE: Final = 0.03
DRAG_TORQUE_NOISE: Final = 0.15
ASSUMED_TORQUE_STD: Final = 0.2
"""Noise of half a second [m/s2], of driving torque and of engine drag
[share]; how wrong an assumed torque may be [m/s2]."""

CORRELATED_WINDOWS: Final = 8.0
CORRELATED_GAIN_WINDOWS: Final = 30.0
"""Windows in a row that share one error: gusts, bumps, torque maps; and where
roads level off before a bend, so does the scale seem to change."""

WIND_SHARE: Final = 0.4
"""Of the drag, which a gust may add or take."""

MODEL_NOISE: Final = 0.05
"""How far a window of braking is from the form of the friction."""

CAUTION: Final = 0.2
"""Share of the learned variance that the heat has: the filters take the errors
of drag and pitch for lasting ones, while over a drive these change sign. From
the development cars of the population."""

OUTLIER: Final = 4.0
IDLE_OUTLIER: Final = 2.5
IDLE_DRIVE_MS2: Final = 0.15
EXTERNAL_MS2: Final = 0.35
"""Beyond so many standard deviations nothing is learned. Without torque
(less than IDLE_DRIVE_MS2) no slope makes the accelerometer show a gain of
speed: there fewer suffice for a push."""

WINDOW_S: Final = 0.5
LEAST_SPEED_MS: Final = 4.0
MOST_LATERAL_MS2: Final = 2.0
CALM_S: Final = 1.0
RELEASED_S: Final = 0.7
PRESSED_S: Final = 0.4
LEAST_BRAKE_N: Final = 150.0
"""Learned from is what is calm for CALM_S (straight, no gear change, no slip,
no intervention, nothing suspect) and unbraked for RELEASED_S, or braked for
PRESSED_S: by then chassis and tyres are wound up."""

RATE_S: Final = 0.5
SLOW_RATE_S: Final = 4.0
RESTART_S: Final = 12.0
ROUGHNESS_S: Final = 10.0
ROUGHNESS_MS2: Final = 1.5
GAIN_RATE_MS2: Final = 0.4
GAIN_NOISE: Final = 0.12
"""Filters between which a change of speed is compared with what is measured,
and how long they must have run: begun in mid-braking they differ by
themselves. A speed whose steps are rougher (whole mph, once a second) shows
nothing."""

GAIN_LOW: Final = -0.2
GAIN_HIGH: Final = 0.2
UNMEASURED: Final = -0.6
GAIN_SQUARE_LEAST: Final = 20.0
GAIN_SQUARE_MOST: Final = 60.0
"""The share measured beyond a change of speed: outside GAIN_LOW and GAIN_HIGH
the scale is wrong, below UNMEASURED it is not measured at all. Least and most
sum of squares [m2/s4] that it rests on."""

DRIFT_S: Final = 60.0
COPY_S: Final = 60.0
"""Memory of what passes of the friction; age of the copies that a suspicion
goes back to, once to twice as old."""

EXTERNAL_S: Final = 2.0
EXTERNAL_HOLD_S: Final = 30.0
EXTERNAL_SHARE: Final = 0.4
"""Contradiction until an external force is suspected, agreement until it no
longer is; braking surely below this share of what the pressure says."""

GRADE_S: Final = 0.3
HEIGHT_PATH_M: Final = 1000.0
HEIGHT_NOISE_M: Final = 2.0

REFERENCE_SPEED_MS: Final = 10.0
REFERENCE_PRESSURE_PA: Final = 1e6
FORM_LIMIT: Final = 1.5

RADIUS_S: Final = 60.0
RADIUS_LIMIT: Final = 0.05
"""Wheels and a speed over ground disagree by more."""

DEAD_MS2: Final = 2.0
DEAD_S: Final = 6.0
"""Braked as hard for so long, and no pressure in between."""

EXTERNAL_SUSPECTED: Final = 1
OBSERVER_RESET: Final = 2
GAIN_SUSPECT: Final = 4
RADIUS_SUSPECT: Final = 8
PRESSURE_DEAD: Final = 16
"""What the observer finds in a step, bits."""
