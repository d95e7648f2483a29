"""A car's FMU on recorded drives: bits of the estimator and of replay."""

from __future__ import annotations

import gzip
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.exchange.fmu import write_fmu
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.replay.columns import present_roles, stream_log
from bstm_daemon.replay.results import Collector
from bstm_daemon.roles import ROLE_INDEX

from ..fmu_slave import PLATFORM, Slave, model_of  # noqa: TID252

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[1] / "golden"
NODES = ("disc", "pad_front", "pad_back", "fluid")
STEPS = 1600
KELVIN = 273.15


def gridded(name: str) -> Iterator[str]:
    """Yield lines of a recording with the last frame of each id every 50 ms.

    An FMU holds its inputs through a communication step, which a recording
    with frames between the points of the grid does not. It has no
    thermocouples, whose frames are left out.
    """
    text = gzip.decompress((GOLDEN / "logs" / f"{name}.log.gz").read_bytes())
    lines = text.decode("ascii").splitlines()
    frames = [line.split() for line in lines if " 6A" not in line]
    first_us = round(float(frames[0][0][1:-1]) * 1e6)
    ids = {frame.split("#")[0] for _, _, frame in frames}
    last: dict[str, str] = {}
    i, at_us, left = 0, 0, STEPS
    while left:
        at_us += STEP_US
        while round(float(frames[i][0][1:-1]) * 1e6) - first_us <= at_us:
            last[frames[i][2].split("#")[0]] = frames[i][2]
            i += 1
        if last.keys() == ids:
            left -= 1
            yield from (
                f"({at_us / 1e6:.6f}) can0 {f}\n" for f in last.values()
            )


@pytest.fixture(scope="module")
def alpine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, Path]:
    pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    config, signal_map = load_vehicle(GOLDEN / "alpine.toml", quiet=True)
    path = tmp_path_factory.mktemp("fmu") / "car.fmu"
    write_fmu(model_of(config, signal_map, "car"), path, 2, [PLATFORM])
    return config, signal_map, path


@pytest.mark.parametrize("hold", [1, 2, 20])
@pytest.mark.parametrize("name", ["descent", "stops", "drag"])
def test_bits_are_those_of_the_estimator_and_of_replay(
    alpine: tuple[Any, Any, Path], tmp_path: Path, name: str, hold: int
) -> None:
    config, signal_map, fmu = alpine
    log = tmp_path / "grid.log"
    log.write_text("".join(gridded(name)), encoding="ascii")
    held: dict[int, dict[str, float]] = {}
    roles = {number: role for role, number in ROLE_INDEX.items()}
    for events in EventLog(log, signal_map).events():
        for at_us, role, value in zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        ):
            held.setdefault(at_us, {})[roles[role]] = value
    times_us = sorted(held)
    slave = Slave(fmu, 2, times_us[0] / 1e6)
    variables = slave.description.modelVariables
    inputs = [v.name for v in variables if v.causality == "input"]
    corners = [corner.name for corner in config.disc_corners()]
    outputs = [f"{c}.{node}_k" for c in corners for node in NODES]
    estimator = Estimator(config, present_roles(signal_map))
    found = {}
    for first in range(0, STEPS - hold + 1, hold):
        at_us = times_us[first]
        values = [held[at_us][role] for role in inputs]
        slave.set_all(dict(zip(inputs, values, strict=True)))
        slave.step(round(hold * STEP_US / 1e6, 9))
        for k in range(hold):
            now_us = at_us + k * STEP_US
            estimator.advance(
                array("q", [now_us] * len(inputs) + [now_us + STEP_US]),
                array("i", [*(ROLE_INDEX[role] for role in inputs), TICK]),
                array("d", [*values, 0.0]),
            )
        got = slave.get(*outputs)
        states = {c: estimator.state(c) for c in corners}
        assert got == [states[c][n] for c in corners for n in NODES], at_us
        found[at_us + hold * STEP_US] = got
    slave.close()
    hottest = np.array(list(found.values())).max()
    assert hottest > 400.0
    if hold == 1:
        rows = Collector()
        stream_log(config, signal_map, log, [rows], forecast=False)
        columns = rows.results().columns
        compared = 0
        for row, time_s in enumerate(columns["time_s"]):
            at_us = round(time_s * 1e6)
            if at_us in found:
                compared += 1
                row_c = [columns[f"{o[:-2]}_c"][row] for o in outputs]
                assert row_c == [k - KELVIN for k in found[at_us]], time_s
        assert compared > STEPS // 2 - 10
