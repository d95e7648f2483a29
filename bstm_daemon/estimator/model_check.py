"""Continuous check of the running model against measurements.

It keeps two running statistics. Feed-Forward against Feed-Back: the braking
work from pressure less that from motion, over the last megajoule or so.
Thermocouples, if they are mapped: the mean residual over two minutes. A
residual beyond the tolerance of a sound model is a gap; ``bstm gap`` finds
its cause in the record. Far beyond it the estimate is not valid, and stays so
while the brake remembers.
"""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import exp, hypot, isfinite, nan
from typing import Any, ClassVar, Final, NamedTuple

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.blocks import Block, BlockLayout
from bstm_daemon.estimator.memory import (
    AnyNumber,
    Flag,
    Int64,
    Machine,
    Number,
)
from bstm_daemon.estimator.trust import Trust
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX

FORGET_J: Final = 1e6
LEAST_J: Final = 3e5
"""Braking work over which forces are averaged, and least work to compare."""

TRIAL_S: Final = 5.0
"""Braking work counts if no input became suspect within this time after it: a
fault may take that long to be detected."""

FORCE_COMES: Final = 0.3
FORCE_GOES: Final = 0.2
"""Thresholds with hysteresis of the relative difference of the works: friction
varies by a tenth, mass and accelerometer add as much."""

FORCE_STRONG: Final = 0.6
FORCE_STRONG_GOES: Final = 0.4
"""Likewise of a difference that degrades the estimate: faded linings make
40 %, brakes that modulate on ice 50 %."""

EVERY_US: Final = 1_000_000
"""Thermocouples are compared on whole seconds."""

MEMORY_S: Final = 120.0
KNOWN_S: Final = 120.0
NODE_OF: Final = {"disc_2": "disc"}
SIGMAS: Final = 3.0
GOES: Final = 0.6
"""Share of the tolerance below which a thermocouple agrees again."""

STRONG: Final = 1.5
"""Multiple of the tolerance from which on the corner is degraded, until the
residual is within the tolerance."""

USUAL: Final[dict[str, tuple[float, float]]] = {
    "disc": (10.0, 0.06),
    "pad_front": (10.0, 0.06),
    "pad_back": (5.0, 0.05),
    "fluid": (3.0, 0.05),
    "caliper": (3.0, 0.05),
}
"""Standard deviation of an unmatched model by node: [K] and share of the rise;
``[accuracy]`` overrides it."""

_UNKNOWN: Final = (
    FLAGS["speed_missing"]
    | FLAGS["pressure_missing"]
    | FLAGS["acceleration_missing"]
    | FLAGS["torque_missing"]
    | FLAGS["speed_suspect"]
    | FLAGS["pressure_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
    | FLAGS["clock_jump"]
    | FLAGS["settled"]
    | FLAGS["silent"]
)
"""With any of these one of the two works is unknown."""

_FF: Final = CHANNELS.index("brake_energy_ff_j")
_FB: Final = CHANNELS.index("brake_energy_fb_j")
_POWER: Final = CHANNELS.index("brake_power_w")
_SCALE: Final = VEHICLE_CHANNELS.index("friction_scale")
_NOWHERE: Final[frozenset[str]] = frozenset()

NO_WORK: Final = (0.0, 0.0, 0.0)
"""Work from pressure less work from motion and the larger of the two [J]; time
over which they were summed [s]."""


@dataclass
class Couple(Machine):
    """One thermocouple and its mean residual.

    ``node`` is the one it measures, ``shown_node`` the model's node there.
    """

    MEMORY: ClassVar = {
        "mean_k": AnyNumber,
        "known_s": Number,
        "disagrees": Flag,
        "strongly": Flag,
    }

    corner: str
    node: str
    shown_node: str
    floor_k: float
    share: float
    mean_k: float = nan
    known_s: float = 0.0
    disagrees: bool = False
    strongly: bool = False

    @property
    def name(self) -> str:
        """Corner and node."""
        return f"{self.corner} {self.node}"

    def take(self, residual_k: float, rise_k: float, dt_s: float) -> None:
        """Take *residual_k*, measured less estimated, of the last *dt_s*."""
        if not isfinite(residual_k):
            self.mean_k, self.known_s = nan, 0.0
            self.disagrees = self.strongly = False
            return
        if not isfinite(self.mean_k):
            self.mean_k, self.known_s = 0.0, 0.0
        self.known_s += dt_s
        # at first the plain mean, so that the first value has no extra weight
        share = dt_s / min(self.known_s, MEMORY_S)
        self.mean_k += (residual_k - self.mean_k) * min(share, 1.0)
        tolerance = SIGMAS * hypot(self.floor_k, self.share * rise_k)
        excess = abs(self.mean_k) / tolerance
        known = self.known_s >= KNOWN_S
        self.disagrees = known and excess > (GOES if self.disagrees else 1.0)
        self.strongly = known and excess > (1.0 if self.strongly else STRONG)


class ModelCheck(Machine):
    """Model check of one car, publication by publication."""

    MEMORY: ClassVar = {
        "_before": tuple[Int64, Number, Number] | None,
        "_apart_j": Number,
        "_work_j": Number,
        "_braked_j": Number,
        "_forces_disagree": Flag,
        "_forces_strongly": Flag,
        "_young": tuple[AnyNumber, Number, Number],
        "_ripe": tuple[AnyNumber, Number, Number],
    }

    def __init__(
        self,
        config: Config,
        layout: BlockLayout,
        roles: Collection[int],
        settling_s: float,
    ) -> None:
        """Find out what is measured.

        Args:
            config: the vehicle.
            layout: of the blocks to come.
            roles: numbers of the mapped roles.
            settling_s: how long the slowest node remembers [s].
        """
        self._fused = config.heat.mode == "fused"
        self.couples = _couples(config, layout, roles)
        self._places = [_place(one, layout) for one in self.couples]
        self._unknown = _UNKNOWN
        if self._fused and ROLE_INDEX["brake_switch"] in roles:
            # an assistant's: there is no pressure to compare
            self._unknown |= FLAGS["braking_unpressed"]
        self._trust = Trust(
            layout.corners, settling_s, compares=False, has_switch=False
        )
        self.remembers = False
        """Whether a strong disagreement was found."""
        self._all = frozenset(layout.corners)
        self._strong = _NOWHERE
        self._disagrees = False
        self._before: tuple[int, float, float] | None = None
        self._apart_j = self._work_j = self._braked_j = 0.0
        self._forces_disagree = self._forces_strongly = False
        # work on trial, and the work before it
        self._young: tuple[float, float, float] = NO_WORK
        self._ripe: tuple[float, float, float] = NO_WORK

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values that JSON knows."""
        couples = {one.name: one.export() for one in self.couples}
        return super().export() | {
            "couples": couples,
            "trust": self._trust.export(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from :meth:`export`, within the same drive.

        Raises:
            KeyError, TypeError, ValueError: it is not of that form.
        """
        super().restore(saved)
        for one in self.couples:
            if one.name in saved["couples"]:
                one.restore(saved["couples"][one.name])
        self._restore_trust(saved["trust"])
        self._summarize()

    def _restore_trust(self, saved: Any) -> None:
        self._trust.restore(saved)
        self.remembers = True

    def resume(
        self, document: Mapping[str, Any], parked_s: float | None
    ) -> None:
        """Continue from the state *document*, as far as it can be read.

        Args:
            document: of a state file.
            parked_s: time since then [s], 0 if it is not known; None
                continues the same drive.
        """
        # one that can not be read begins anew
        with suppress(KeyError, TypeError, ValueError, AttributeError):
            saved = document["model_check"]
            if parked_s is None:
                self.restore(saved)
            else:
                self._restore_trust(saved["trust"])
                self.park(parked_s)

    def park(self, seconds: float) -> None:
        """Let the brakes have stood for *seconds*."""
        self._trust.park(seconds)

    @property
    def force_difference(self) -> float:
        """Work by pressure less work by motion, over the larger.

        NaN until enough has been braked.
        """
        if self._braked_j < LEAST_J:
            return nan
        return self._apart_j / max(self._work_j, 1.0)

    @property
    def disagreements(self) -> tuple[str, ...]:
        """Disagreements: ``heat``, or a corner and node."""
        found = ["heat"] if self._forces_disagree else []
        found += [one.name for one in self.couples if one.disagrees]
        return tuple(found)

    def findings(self, block: Block) -> list[frozenset[str]]:
        """Return the corners far from what is measured, by publication.

        Thermocouples count from when the start has no effect any more.

        Args:
            block: the next publications; its ``disagrees`` is filled in, its
                validities are not read.
        """
        wide = len(CHANNELS)
        size = wide * len(block.layout.corners)
        moved_by = _POWER if self._fused else _FB
        found = []
        for i, time_us in enumerate(block.times_us):
            first, end = i * size, (i + 1) * size
            pressed = sum(block.rows[first + _FF : end : wide])
            moved = sum(block.rows[first + moved_by : end : wide])
            before, self._before = self._before, (time_us, pressed, moved)
            dt_s = 0.0 if before is None else (time_us - before[0]) * 1e-6
            if before is not None and 0.0 < dt_s < 1.0:
                if block.flags[i] & self._unknown:
                    self._young = self._ripe = NO_WORK
                elif self._fused:
                    scale = block.vehicle[i * len(VEHICLE_CHANNELS) + _SCALE]
                    pressed = scale * (pressed - before[1])
                    self._take_work(pressed, moved * dt_s, dt_s)
                else:
                    pressed, moved = pressed - before[1], moved - before[2]
                    self._take_work(pressed, moved, dt_s)
            if self.couples and time_us % EVERY_US == 0:
                self._take_couples(block, i)
            block.disagrees.append(self._disagrees)
            found.append(self._strong)
        return found

    def holds(self, corner: str, step_s: float, *, found: bool) -> bool:
        """Return whether *corner* is degraded by a strong disagreement.

        As :meth:`~bstm_daemon.estimator.trust.Trust.holds`.
        """
        if not (found or self.remembers):
            return False
        self.remembers = True
        return self._trust.holds(corner, step_s, found=found)

    def _take_work(
        self, pressed_j: float, moved_j: float, dt_s: float
    ) -> None:
        difference_j, work_j, lasted_s = self._young
        larger = max(pressed_j, moved_j)
        if larger > 0.0 and isfinite(pressed_j - moved_j):
            difference_j += pressed_j - moved_j
            work_j += larger
        self._young = difference_j, work_j, lasted_s + dt_s
        if lasted_s + dt_s >= TRIAL_S:
            self._count_work(*self._ripe[:2])
            self._ripe, self._young = self._young, NO_WORK

    def _count_work(self, difference_j: float, work_j: float) -> None:
        if not work_j > 0.0:
            return
        # as if the work came evenly, with fading during it
        share = work_j / FORGET_J
        keep = exp(-share)
        taken = (1.0 - keep) / share
        self._apart_j = keep * self._apart_j + taken * difference_j
        self._work_j = keep * self._work_j + taken * work_j
        self._braked_j += work_j
        # nan fails every comparison
        difference = abs(self.force_difference)
        self._forces_disagree = difference > (
            FORCE_GOES if self._forces_disagree else FORCE_COMES
        )
        self._forces_strongly = difference > (
            FORCE_STRONG_GOES if self._forces_strongly else FORCE_STRONG
        )
        self._summarize()

    def _take_couples(self, block: Block, i: int) -> None:
        dt_s = EVERY_US * 1e-6
        size = len(CHANNELS) * len(block.layout.corners)
        row = block.rows[i * size : (i + 1) * size]
        taken = False
        for one, place in zip(self.couples, self._places, strict=True):
            measured_k = row[place.measured]
            known = i >= block.known_from[one.corner]
            if known and isfinite(measured_k):
                output = block.outputs[place.group]
                shown_k = output[place.shown + i * place.stride]
                rise_k = shown_k - row[place.ambient]
                one.take(measured_k - shown_k, rise_k, dt_s)
                taken = True
            elif one.known_s > 0.0:
                one.take(nan, 0.0, dt_s)
                taken = True
        if taken:
            self._summarize()

    def _summarize(self) -> None:
        """Hold what the publications say until it changes."""
        self._disagrees = bool(self.disagreements)
        self._strong = self._all if self._forces_strongly else _NOWHERE
        if not self._forces_strongly and self.couples:
            self._strong = frozenset(
                one.corner for one in self.couples if one.strongly
            )


class _Place(NamedTuple):
    """Where a thermocouple stands in a block's rows, its node in outputs."""

    measured: int
    ambient: int
    group: int
    shown: int
    stride: int


def _place(one: Couple, layout: BlockLayout) -> _Place:
    first = layout.rows[one.corner]
    number, member, stride, group = layout.modelled[one.corner]
    return _Place(
        first + CHANNELS.index(f"measured_{one.node}_k"),
        first + CHANNELS.index("ambient_k"),
        number,
        member + group.state_names.index(one.shown_node),
        stride,
    )


def _couples(
    config: Config, layout: BlockLayout, roles: Collection[int]
) -> list[Couple]:
    found = []
    for group in layout.groups:
        for corner in group.corners:
            for couple in MEASURED_NODES:
                role = ROLE_INDEX.get(f"temp_{corner.lower()}_{couple}")
                node = NODE_OF.get(couple, couple)
                forced = config.heat.mode == "measured" and couple == "disc"
                if (
                    role not in roles
                    or node not in group.state_names
                    or forced
                ):
                    continue
                accuracy = _accuracy(config, node)
                found.append(Couple(corner, couple, node, *accuracy))
    return found


def _accuracy(config: Config, node: str) -> tuple[float, float]:
    floor_k = getattr(config.accuracy, f"{node}_k", None)
    if floor_k is None:
        floor_k, share = USUAL[node]
    else:
        share = float(getattr(config.accuracy, f"{node}_share"))
    offset_k = config.accuracy.thermocouple_offset_k
    drift_k = config.accuracy.drift_beyond_usual_k()
    return hypot(floor_k, offset_k, drift_k), share
