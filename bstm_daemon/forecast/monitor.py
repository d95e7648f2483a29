"""Risk monitor: risk and forecast at each publication, live and in replay.

:class:`RiskMonitor` takes the estimator's blocks and gives a
:class:`CarRisk` a publication. As long as a start is unknown the hot bound
is followed beside the estimate, and the risk is that of the bound: at most as
given.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pydantic import Field, ValidationError

from bstm_daemon.estimate import RiskLevel
from bstm_daemon.estimator.memory import Int64, Saved, SavedState, checked
from bstm_daemon.forecast.course_risk import CourseRisk
from bstm_daemon.forecast.fluid import (
    CHANGED_ROLE,
    WATER_ROLE,
    FluidKnowledge,
    SavedFluid,
)
from bstm_daemon.model.risk.levels import sure_level

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimate import CarRisk
    from bstm_daemon.estimator.blocks import Block, Instant
    from bstm_daemon.estimator.estimator import Estimator, Floats, Ints
    from bstm_daemon.model.risk.levels import LevelMemory

FLUID_ROLES: Final = (CHANGED_ROLE, WATER_ROLE)


class SavedRisk(Saved):
    """Result of :meth:`RiskMonitor.export`."""

    fluid: SavedFluid | None = None
    levels: dict[str, tuple[RiskLevel, Int64 | None]] = Field(
        default_factory=dict
    )

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> SavedRisk:
        """Return the one in the state *document*; empty if it is not valid."""
        try:
            return cls.model_validate(document.get("risk"))
        except ValidationError:
            return cls()


class RiskMonitor:
    """Risk and forecast of one car."""

    def __init__(self, config: Config, estimator: Estimator) -> None:
        """Watch *estimator* of the car *config*."""
        self._config, self._estimator = config, estimator
        self.fluid = FluidKnowledge(config.fluid)
        self._samples: list[tuple[int, int, float]] = []
        self.course = CourseRisk(config, estimator, self.fluid)
        """That of the estimate."""
        self._bound: CourseRisk | None = None
        """That of the hot bound, while a start is unknown."""
        self.members = self.course.members
        self._last: tuple[CarRisk, CarRisk, CarRisk] | None = None

    def ingest(self, times_us: Ints, roles: Ints, values: Floats) -> None:
        """Take samples that the estimator is about to get.

        Only those of the fluid matter; each holds from its stamp on.
        """
        # columns of a replay; the live service does without NumPy's 15 MiB
        if hasattr(roles, "nonzero"):
            column: Any = roles
            (picked,) = (
                (column == FLUID_ROLES[0]) | (column == FLUID_ROLES[1])
            ).nonzero()
        else:
            picked = [i for i, one in enumerate(roles) if one in FLUID_ROLES]
        self._samples += [
            (int(times_us[i]), int(roles[i]), float(values[i])) for i in picked
        ]

    def peaks_k(self) -> dict[str, tuple[float, ...]]:
        """Return each corner's peaks [K] if the car parks, one a member.

        They are of the last forecast of the estimate, empty before the first;
        members of one number belong together.
        """
        return self.course.peaks_k()

    def add(self, block: Block) -> list[CarRisk]:
        """Return the risk at each publication of *block*."""
        known_from = max(block.known_from.values(), default=0)
        return [
            self._advance(block.at(i), history_known=i >= known_from)
            for i in range(len(block.times_us))
        ]

    def _advance(self, instant: Instant, *, history_known: bool) -> CarRisk:
        while self._samples and self._samples[0][0] <= instant.time_us:
            self.fluid.ingest(*self._samples.pop(0))
        if history_known:
            self._bound = None
            return self.course.advance(instant)
        if self._bound is None:
            self._bound = self._of_bound()
        # half as fast, so that no publication has more to do, and only its
        # level of a car that parks is wanted
        least = self.course.advance(instant, share=2, duty=False)
        most = self._bound.advance(instant, share=2)
        if self._last is not None:
            *of, published = self._last
            if of[0] is least and of[1] is most:
                return published
        corners = {
            name: risk
            if instant.start_known(name)
            else most.corners[name]._replace(
                sure_level=sure_level(risk.level, most.corners[name].level),
                # of the temperature that is published, the estimate's
                fluid_deviation_k=risk.fluid_deviation_k,
            )
            for name, risk in least.corners.items()
        }
        published = most._replace(corners=corners)
        self._last = least, most, published
        return published

    def _of_bound(self) -> CourseRisk:
        return CourseRisk(
            self._config, self._estimator, self.fluid, beside=self.course
        )

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values, for the state file."""
        return {
            "fluid": self.fluid.export(),
            "levels": {
                name: [int(memory.level), memory.below_since_us]
                for name, memory in self.memories().items()
            },
        }

    def resume(
        self, document: Mapping[str, Any], parked_us: int | None, now_us: int
    ) -> None:
        """Continue from *document*, a state that the estimator has restored.

        Call it before the first publication; an unreadable risk is ignored.

        Args:
            document: the state.
            parked_us: time since the save [us], None where it is not known;
                vapour may have formed meanwhile.
            now_us: time now on the axis of the stamps [us].
        """
        saved = SavedRisk.of(document)
        if saved.fluid is not None:
            self.fluid.resume(saved.fluid)
        if not self._estimator.history_known:
            self._bound = self._of_bound()
        for name, memory in self.memories().items():
            level, since_us = saved.levels.get(name, (RiskLevel.UNKNOWN, None))
            if level is not RiskLevel.UNKNOWN:
                memory.level, memory.below_since_us = level, since_us
        if parked_us is not None and parked_us > 0:
            self.look_back(document, parked_us, now_us)

    def look_back(
        self, document: Mapping[str, Any], parked_us: int, now_us: int
    ) -> None:
        """Compute the probability of vapour while the computer was off.

        Args:
            document: the state that was saved before.
            parked_us: time since the save [us].
            now_us: time now on the axis of the stamps [us].
        """
        state = checked(SavedState, document)
        for course in (self.course, self._bound):
            if course is not None:
                course.look_back(state, parked_us * 1e-6, now_us)

    def memories(self) -> dict[str, LevelMemory]:
        """Return the levels that go over a restart, by name."""
        found = self.course.memories()
        if self._bound is not None:
            bound = self._bound.memories()
            found |= {f"bound.{name}": one for name, one in bound.items()}
        return found
