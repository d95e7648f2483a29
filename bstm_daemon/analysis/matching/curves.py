"""Measured and modelled temperatures of a match over a drive."""

from dataclasses import dataclass

from bstm_daemon.analysis.matching.drives import Drive
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.matching.matcher import Match
from bstm_daemon.analysis.matching.problem import power_w
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.units import KELVIN_OFFSET


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """A thermocouple over a drive, (n,) each: temperatures [degC]."""

    couple: str
    measured_c: Column
    before_c: Column
    after_c: Column


def curves_of(match: Match, drive: Drive, corner: str) -> list[Curves]:
    """Return each thermocouple of *corner*, and the model as it was and is."""
    # one by one: a match may have added an effect, and with it an edge
    targets = (match.before, match.after)
    programs = [compile_corner(one.config, one.corner) for one in targets]
    couples = drive.couples(
        corner, {node.name for node in programs[0].network.nodes}
    )
    if not couples:
        return []
    before, after = (
        march([program], drive, corner, power_w=power_w(drive, corner, [one]))
        for one, program in zip(targets, programs, strict=True)
    )
    return [
        Curves(
            name,
            drive.measured[corner][name].at(drive.time_s) - KELVIN_OFFSET,
            before[node][:, 0] - KELVIN_OFFSET,
            after[node][:, 0] - KELVIN_OFFSET,
        )
        for name, node in couples
    ]
