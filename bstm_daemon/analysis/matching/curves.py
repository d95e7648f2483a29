"""Measured temperatures beside those of the model before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.analysis.matching.march import initial_temperatures, march
from bstm_daemon.analysis.matching.problem import NODE_OF
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.analysis.statistics.series import Column


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """A thermocouple over a drive: time [s] and temperatures [degC], (n,)."""

    drive: str
    corner: str
    couple: str
    time_s: Column
    measured_c: Column
    before_c: Column
    after_c: Column


def curves_of(match: Match, drives: Sequence[Drive]) -> list[Curves]:
    """Return every thermocouple of *match*'s corners over *drives*."""
    programs = [
        compile_corner(one.config, one.corner)
        for one in (match.before, match.after)
    ]
    nodes = {node.name for node in programs[0].network.nodes}
    found = []
    for drive in drives:
        for corner in match.corners:
            couples = drive.measured.get(corner, {})
            if not couples:
                continue
            initial = initial_temperatures(programs[0], drive, corner)
            result = march(programs, drive, corner, initial)
            for name, couple in couples.items():
                node = NODE_OF.get(name, name)
                if node in nodes:
                    both = result[node] - KELVIN_OFFSET
                    found.append(
                        Curves(
                            drive.name,
                            corner,
                            name,
                            drive.time_s,
                            couple.at(drive.time_s) - KELVIN_OFFSET,
                            both[:, 0],
                            both[:, 1],
                        )
                    )
    return found
