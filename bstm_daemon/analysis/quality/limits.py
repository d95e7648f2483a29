"""The thresholds of every verdict, each with its reason.

They are wide on purpose: a channel is named only where a heat estimate would
be visibly wrong, and docs/signal-quality.md explains them to the user.
"""

from typing import Final

GRID_S: Final = 0.05
"""Common grid: the slowest useful chassis signal (10 Hz) is seen twice."""

WINDOW_S: Final = 0.5
"""Difference quotient of speed, and mean of the accelerometer: long enough
that 0.06 m/s of quantum is 0.24 m/s2, short against a stop."""

LONGEST_LAG_S: Final = 2.0
"""Search range of the cross-correlation; a GNSS receiver is late by 1 s."""

LAG_S: Final = 0.25
"""Largest lag; during a larger one a hard stop changes the speed by more than
2 m/s. Filters and lines on a car take 20 to 100 ms."""

LAG_CORRELATION: Final = 0.7
"""A weaker peak of the cross-correlation gives no lag."""

UNRELATED: Final = 0.5
"""Readings with a weaker correlation are not of one quantity."""

UNIT_TOLERANCE: Final = 0.06
"""Tolerance of a scale that is taken as the ratio of two units; the
nearest wrong pair, mph for km/h (1.61) and Feed-Forward's 1.5, is at 7 %."""

ENOUGH_S: Final = 5.0
"""Seconds of common, moving data below which no fit is judged."""

SPEED_SPAN_MS: Final = 3.0
"""Speeds must range over this (5 to 95 %) to give a scale: a quantum of
0.06 m/s is then 2 %."""

SPEED_FLOOR_MS: Final = 0.5
"""A difference of speeds that is no outlier: bends, slip, quantum."""

ACCELERATION_FLOOR_MS2: Final = 1.0
"""A difference of accelerations that is no outlier: a grade of 10 %."""

PRESSURE_FLOOR_PA: Final = 2e5
"""A difference of pressures that is no outlier: 10 % of hard braking."""

SPEED_SCALE: Final = 1.06
"""A larger ratio is a wrong wheel size or scale, with the same error of the
heat. Worn and new tyres differ by 2 %, a spare wheel by 5 %."""

SPEED_OFFSET_MS: Final = 0.6
"""Wheel sensors read 0 below 0.4 m/s; beyond that it is no dead band."""

ACCELERATION_SPREAD_MS2: Final = 0.3
"""Least standard deviation of dv/dt, above that of bias and grade."""

ACCELERATION_SCALE: Final = 1.25
"""Pitch under braking alone gives 3 %, and a 10 % grade that comes with
braking 10 % or more: only what is beyond is the sensor's."""

ACCELERATION_OFFSET_MS2: Final = 2.0
"""An offset above that of any road's grade (20 %)."""

PRESSURE_SPAN_PA: Final = 5e5
"""Pressures must range over 5 bar: friction of seals and valves is 0.5."""

PRESSURE_SCALE: Final = 1.4
"""Circuits of one car differ (thesis figure 4.2); ten units do not."""

REAR_PRESSURE_SCALE: Final = 3.0
"""A proportioning valve or EBD holds the rear down to about a third."""

PRESSURE_OFFSET_PA: Final = 3e5
"""Two circuits at rest; push-out and sensor zero stay below 1 bar."""

PRESSED_PA: Final = 3e5
"""Pads are on at this pressure (push-out is 0.5 to 1 bar)."""

RELEASED_PA: Final = 0.5e5
RELEASED_SPREADS: Final = 3.0
"""Below half of this pressure above its released reading the brake is
released, or below so many times what that varies by, if that is more: five
standard deviations of noise, so that none breaks a stretch. The whole where
only the lowest reading is known, which lies below the noise's middle."""

RESIDUAL_PA: Final = 2e5
"""Largest reading of a released brake: valves hold 0.4 to 1 bar in the line,
sensors' zeros add to it."""

MOVING_MS: Final = 2.0
"""Below this, wheel sensors and difference quotients are not trusted."""

DRIVING_MS2: Final = 0.3
"""Acceleration above which the car is not braked."""

FROZEN_S: Final = 5.0
"""Shortest run of one exact value that is called frozen."""

FROZEN_SPEED_MS: Final = 3.0
"""Least change of the other speeds during such a run."""

FROZEN_ACCELERATION_MS2: Final = 2.0
"""Least range of the speeds' rates of change during such a run."""

FROZEN_STEPS: Final = 20
"""A channel seen moving in this many different values has the resolution to
show that it moves; one that never did may be coarse."""

MISSING_SHARE: Final = 0.1
"""Share of the bus's time without a valid value that is named."""

MISSING_FAILS: Final = 0.5
"""Share of missing time above which the channel is not usable."""

FORCE_RATIO: Final = 2.0
"""Feed-Forward over Feed-Back energy: friction coefficient (0.3 to 0.5),
mass and torque errors together stay below 2."""

FORCE_UNIT_TOLERANCE: Final = 0.3
"""Relative error of Feed-Forward over Feed-Back in a test for a wrong unit."""

FORCE_MS2: Final = 0.5
"""Mean braking, as a deceleration, that resistances cannot fake."""

MISWIRED: Final = 0.98
"""A temperature with this correlation to a pressure is miswired: a brake part
integrates heat and cannot cool as the pedal is released."""

MISWIRED_PRESSES: Final = 3
"""Presses of the pedal needed for that verdict."""

COLDER_K: Final = 15.0
"""Largest plausible fall below ambient: evaporation gives 5 to 10 K."""

TEMPERATURE_RANGE_K: Final = {
    "disc": (223.0, 1400.0),
    "disc_2": (223.0, 1400.0),
    "pad_front": (223.0, 1400.0),
    "pad_back": (223.0, 1000.0),
    "fluid": (223.0, 620.0),
    "caliper": (223.0, 800.0),
}
"""Iron melts at 1420 K, DOT 5.1 boils dry at 543 K."""

TEMPERATURE_RATE_K_S: Final = {
    "disc": 400.0,
    "disc_2": 400.0,
    "pad_front": 400.0,
    "pad_back": 30.0,
    "fluid": 10.0,
    "caliper": 10.0,
}
"""Race discs gain 300 K in a 2 s stop; a kilogram of aluminium on 5 kW 6 K/s
at most."""

DISC_WORK_MS2S: Final = 100.0
"""Brake work over mass [m2/s2] that must heat a disc: a stop from 50 km/h, 10
K or more at the front of any car."""

BEND_MS: Final = 3.0
"""Slower the car may reverse: its speed has no sign then, and in bends the
inner wheel is the faster one."""

BEND_SMOOTH_S: Final = 0.5
"""Readings in bends are means over so long: in a slight one the wheels differ
by less than a tooth or a bump makes."""

YAW_SPREAD_RAD_S: Final = 0.05
"""A bend at 10 m/s of 200 m radius: left and right differ by 0.08 m/s."""

SIDE_CORRELATION: Final = 0.6
"""Wheel differences follow the yaw rate this well in bends."""

SAME_SIGN: Final = 0.8
"""Share of a bend's samples in which one axle is the faster one."""

WIDEST_TRACK_M: Final = 2.5
"""Widest track that the wheel differences in bends may imply."""

STAND_RESPONSE: Final = 0.3
"""Share of the turning wheels' dv/dt that the accelerometer must show for the
car to have moved."""

TIGHT_YAW_RAD_S: Final = 0.15
"""A bend in which the front axle is the faster by 0.016 m/s at 5 m/s."""
