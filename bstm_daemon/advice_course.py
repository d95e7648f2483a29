"""Advice along a recording's blocks, as the engine gives it live.

The engine takes frames one by one and holds the driver's roles as they come;
here whole columns of samples come before the publications that they are for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bstm_daemon.advice.advisor import Advisor
from bstm_daemon.advice.conditions import FAR_US, HeldRoles
from bstm_daemon.bus.output_layout import Validity
from bstm_daemon.bus.publication import CornerSnapshot
from bstm_daemon.driver_side import conditions_of
from bstm_daemon.forecast.snapshots import corner_snapshot
from bstm_daemon.risk.boiling import wet_boiling_point_k
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.bus.publication_slow import AdviceSnapshot
    from bstm_daemon.config import Config
    from bstm_daemon.estimator import Block, Estimator, Floats, Ints
    from bstm_daemon.forecast.records import CarRisk


class AdviceCourse:
    """The advice of one car at each publication of its blocks."""

    def __init__(
        self, config: Config, estimator: Estimator, present: Mapping[int, int]
    ) -> None:
        """Begin parked; *present* is role number to time-out [us]."""
        self._config = config
        self._estimator = estimator
        self._present = present
        self._boiling_k = wet_boiling_point_k(config.fluid.grade)
        self._advisor = Advisor(config)
        self._held = HeldRoles(present, ROLE_INDEX)
        self._waiting: list[tuple[int, int, float]] = []
        self._places = [
            (name, number, member, group.state_names.index("fluid"))
            for number, group in enumerate(estimator.groups)
            for member, name in enumerate(group.corners)
        ]

    def hear(self, times_us: Ints, roles: Ints, values: Floats) -> None:
        """Take samples that the estimator is about to get."""
        wanted = np.isin(np.asarray(roles), sorted(self._held.numbers))
        self._waiting += zip(
            np.asarray(times_us)[wanted].tolist(),
            np.asarray(roles)[wanted].tolist(),
            np.asarray(values)[wanted].tolist(),
            strict=True,
        )

    def add(
        self, block: Block, risks: Sequence[CarRisk]
    ) -> list[AdviceSnapshot]:
        """Return the advice at each publication of *block* with its risk."""
        found = []
        taken = 0
        for i, (time_us, risk) in enumerate(
            zip(block.times_us, risks, strict=True)
        ):
            taken = self._note(taken, time_us)
            now = conditions_of(
                block,
                i,
                self._corners(block, i, risk),
                self._estimator.plan.corners,
                self._held.at(time_us),
                history_known=i >= block.known_from,
            )
            found.append(self._advisor.update(now))
        del self._waiting[:taken]
        return found

    def resume(self, saved: Any) -> None:
        """Go on with the advice of a state file, where it is one."""
        advisor = Advisor(self._config)
        held = HeldRoles(self._present, ROLE_INDEX)
        try:
            advisor.restore(saved["machines"])
            held.restore(saved["roles"])
        except (KeyError, TypeError, ValueError, AttributeError):
            return
        self._advisor, self._held = advisor, held

    def _note(self, taken: int, time_us: int) -> int:
        """Hold what came up to *time_us* and return how many are done with.

        One stamped far ahead is of a clock that went wrong.
        """
        waiting = self._waiting
        while taken < len(waiting):
            ahead_us = waiting[taken][0] - time_us
            if 0 < ahead_us < FAR_US:
                break
            if ahead_us <= 0:
                self._held.note(*waiting[taken])
            taken += 1
        return taken

    def _corners(
        self, block: Block, i: int, risk: CarRisk
    ) -> dict[str, CornerSnapshot]:
        found = {}
        for name, number, member, fluid in self._places:
            group = self._estimator.groups[number]
            first = (i * len(group.corners) + member) * group.size
            fluid_k = block.outputs[number][first + fluid]
            found[name] = CornerSnapshot(
                fluid_k=fluid_k,
                margin_k=self._boiling_k - fluid_k,
                wet_boiling_k=self._boiling_k,
                validity=Validity(block.validity[name][i]),
                risk=corner_snapshot(risk, name, block.times_us[i]),
            )
        return found
