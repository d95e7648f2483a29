"""How long an estimate stays degraded by heat that may have been wrong.

A finding against an input ends with the braking that showed it; the network
remembers that heat for much longer. So the time with a finding is counted,
corner by corner, and the corner stays degraded for :data:`MEMORY` times as
long, at most until its slowest node has forgotten. A hole in the data that the
car drove in counts too. One finding is made here, from what the pass over
samples publishes: the work by pressure and the work that heats the brakes
differ by more than friction, mass and slope do, so one of their inputs is
wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, isfinite
from typing import Any, ClassVar, Final

from bstm_daemon.channels import CHANNELS, FLAGS
from bstm_daemon.estimator.blocks import Block
from bstm_daemon.estimator.memory import Machine, Number

MEMORY: Final = 30.0
"""The network's time constants are minutes to an hour; heat that was wrong
for a minute is gone, but for a hundredth of the disc's, in half an hour."""

LEAST_S: Final = 5.0
"""Findings of this time in total leave nothing: the disc moves by 1 K/s."""

FORGET_J: Final = 1e6
LEAST_J: Final = 3e5
"""Braking work that the two works are compared over, and from which on."""

LEAST_RATIO: Final = 0.6
MOST_RATIO: Final = 1.75
LEARNED: Final = 0.05
"""Work by pressure over the work that heats, of a sound car: linings have
0.7 to 1.3 of their nominal friction, 0.6 when they fade. As long as the heat
by pressure has a deviation of LEARNED of it or more, a deviation less does not
contradict: heat that is too high hides none."""

_POWER: Final = CHANNELS.index("brake_power_w")
_DEVIATION: Final = CHANNELS.index("brake_power_std_w")
_PRESSED: Final = CHANNELS.index("brake_energy_ff_j")
_ASSUMED: Final = (
    FLAGS["pressure_missing"] | FLAGS["clock_jump"] | FLAGS["settled"]
)
"""With any of these the work by pressure is not that of the brakes."""


class Trust(Machine):
    """What was found against the heat of each corner, and for how long."""

    MEMORY: ClassVar = {
        "_found_s": dict[str, Number],
        "_held_s": dict[str, Number],
        "_work": tuple[Number, Number],
        "_doubt_j": Number,
        "_pressed_j": Number,
    }

    def __init__(
        self,
        corners: Sequence[str],
        settling_s: float,
        *,
        compares: bool,
        has_switch: bool,
    ) -> None:
        """Trust all *corners*.

        Args:
            corners: their names, in the order of a block's rows.
            settling_s: how long the slowest node remembers [s].
            compares: whether the heat comes from pressure and motion both, so
                that the two works can be compared.
            has_switch: whether a brake switch is mapped: then braking without
                pressure is an assistant's, unless the switch contradicts.
        """
        self._excused = _ASSUMED | (
            FLAGS["braking_unpressed"] if has_switch else 0
        )
        self._settling_s = settling_s
        self._compares = compares
        self._found_s = dict.fromkeys(corners, 0.0)
        self._held_s = dict.fromkeys(corners, 0.0)
        self._work = 0.0, 0.0
        self._doubt_j = 0.0
        self._pressed_j = -1.0

    def restore(self, saved: Any) -> None:
        """Take over what :meth:`export` gave, of the same corners.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind.
        """
        corners = [*self._held_s]
        # a file of an earlier version has no doubt
        super().restore({"_doubt_j": 0.0, **saved})
        found_s, held_s = self._found_s, self._held_s
        self._found_s = {name: found_s.get(name, 0.0) for name in corners}
        self._held_s = {name: held_s.get(name, 0.0) for name in corners}

    def hold(self, seconds: float) -> None:
        """Keep all corners degraded for *seconds* from now on."""
        for name, held_s in self._held_s.items():
            longest_s = max(held_s, seconds)
            self._held_s[name] = min(longest_s, self._settling_s)

    def park(self, seconds: float) -> None:
        """Let the brakes have stood for *seconds*."""
        self._pressed_j = -1.0
        for name, held_s in self._held_s.items():
            self._held_s[name] = max(held_s - seconds, 0.0)
            self._found_s[name] = max(
                self._found_s[name] - seconds / MEMORY, 0.0
            )

    def findings(self, block: Block, step_s: float) -> list[bool]:
        """Return at which publications of *block* the car's heat is doubted.

        Args:
            block: its validities are not read.
            step_s: time between two publications [s].
        """
        size = len(block.layout.corners) * len(CHANNELS)
        found = []
        for i, flags in enumerate(block.flags):
            if self._compares:
                row = block.rows[i * size : (i + 1) * size]
                self._add_work(row, flags, step_s)
            found.append(self._works_differ())
        return found

    def count(self, seconds: float) -> None:
        """Count *seconds* against the heat of every corner.

        They are a hole in the data that the car drove in, or may have.
        """
        for name, held_s in self._held_s.items():
            found_s = self._found_s[name] + seconds
            # the slowest node has forgotten what is older
            found_s = min(found_s, self._settling_s / MEMORY)
            self._found_s[name] = found_s
            if found_s > LEAST_S:
                self._held_s[name] = max(held_s, MEMORY * found_s)

    def _add_work(
        self, row: Sequence[float], flags: int, step_s: float
    ) -> None:
        before_j = self._pressed_j
        self._pressed_j = sum(row[_PRESSED :: len(CHANNELS)])
        # the sum begins anew where the pass over samples does
        began = not 0.0 <= before_j <= self._pressed_j
        if began or flags & self._excused:
            return
        heat_j = step_s * sum(row[_POWER :: len(CHANNELS)])
        doubt_j = 0.0
        if not flags & FLAGS["braking_unpressed"]:
            doubt_j = step_s * sum(row[_DEVIATION :: len(CHANNELS)])
        pressed_j = self._pressed_j - before_j
        if not (heat_j > 0.0 or pressed_j > 0.0):
            return
        if isfinite(heat_j + pressed_j + doubt_j):
            keep = exp(-max(heat_j, pressed_j) / FORGET_J)
            pressed, heat = self._work
            self._work = keep * pressed + pressed_j, keep * heat + heat_j
            self._doubt_j = keep * self._doubt_j + doubt_j

    def _works_differ(self) -> bool:
        pressed_j, heat_j = self._work
        if max(pressed_j, heat_j) < LEAST_J:
            return False
        learned = self._doubt_j < LEARNED * heat_j
        least_j = LEAST_RATIO * (heat_j - (0.0 if learned else self._doubt_j))
        return not least_j <= pressed_j <= MOST_RATIO * heat_j

    def remembers(self, corner: str) -> bool:
        """Return whether anything was found against the heat of *corner*."""
        return self._found_s[corner] > 0.0 or self._held_s[corner] > 0.0

    def holds(self, corner: str, step_s: float, *, found: bool) -> bool:
        """Return whether *corner* is degraded by what was found, now or once.

        Args:
            corner: its name.
            step_s: time since the last call for it [s].
            found: whether anything speaks against its heat now.
        """
        found_s, held_s = self._found_s[corner], self._held_s[corner]
        if found:
            self._found_s[corner] = found_s = found_s + step_s
            if found_s > LEAST_S:
                held_s = max(held_s, MEMORY * found_s)
                self._held_s[corner] = min(held_s, self._settling_s)
            return True
        if found_s > 0.0:
            self._found_s[corner] = max(found_s - step_s / MEMORY, 0.0)
        if held_s > 0.0:
            self._held_s[corner] = max(held_s - step_s, 0.0)
        return held_s > 0.0
