"""An instance of an FMU, run by FMPy, and drives for it."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import numpy as np

from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.exchange.fmu_model import FmuModel, car_fmu, corner_fmu
from bstm_daemon.replay.columns import present_roles

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

STEP_S = 0.05
PLATFORM = "linux64"


def model_of(config: Config, signal_map: SignalMap, name: str) -> FmuModel:
    if name == "car":
        return car_fmu(config, present_roles(signal_map))
    return corner_fmu(config, name)


class Slave:
    """An instance of an FMU, whichever version."""

    def __init__(self, path: Path, fmi: int, start_s: float = 0.0) -> None:
        import fmpy  # noqa: PLC0415  (an extra)
        from fmpy.simulation import instantiate_fmu  # noqa: PLC0415

        self.fmi = fmi
        self.folder = fmpy.extract(str(path))
        self.description = fmpy.read_model_description(self.folder)
        self.messages: list[str] = []
        kind = "CoSimulation"
        self.fmu: Any = instantiate_fmu(
            self.folder,
            self.description,
            fmi_type=kind,
            logger=self._log,
        )
        self.references = {
            v.name: v.valueReference for v in self.description.modelVariables
        }
        if fmi == 2:
            self.fmu.setupExperiment(startTime=start_s)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start_s)
        self.fmu.exitInitializationMode()
        self.time_s = start_s

    def _log(self, *message: Any) -> None:
        self.messages.append(" ".join(map(str, message)))

    def set(self, **values: float) -> None:
        self.set_all(values)

    def set_all(self, values: dict[str, float]) -> None:
        references = [self.references[name] for name in values]
        numbers = [float(value) for value in values.values()]
        call = self.fmu.setReal if self.fmi == 2 else self.fmu.setFloat64
        call(references, numbers)

    def get(self, *names: str) -> list[float]:
        references = [self.references[name] for name in names]
        call = self.fmu.getReal if self.fmi == 2 else self.fmu.getFloat64
        return list(call(references))

    def step(self, step_s: float = STEP_S) -> None:
        self.fmu.doStep(self.time_s, step_s)
        self.time_s = round(self.time_s + step_s, 9)

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def drive(seed: int, steps: int) -> dict[str, np.ndarray]:
    """Return inputs of a corner at each step: stops from rising speed."""
    random = np.random.default_rng(seed)
    time_s = np.arange(steps) * STEP_S
    speed = (
        15.0
        + 12.0 * np.sin(time_s / (7.0 + seed))
        + random.normal(0.0, 0.02, steps)
    )
    brakes = (np.sin(time_s / (3.0 + 0.5 * seed)) > 0.3).astype(float)
    power = brakes * 900.0 * speed * random.uniform(0.8, 1.2, steps)
    return {
        "speed_ms": speed,
        "brake_on": brakes,
        "ambient_k": 288.0 + 0.01 * time_s,
        "brake_power_w": power,
    }


def rows_of(inputs: dict[str, np.ndarray], hold: int) -> np.ndarray:
    """Return rows of channels, each value held for *hold* steps."""
    steps = len(inputs["speed_ms"])
    rows = np.tile(list(channels_at_rest(288.0).values()), (steps, 1))
    for name, values in inputs.items():
        rows[:, CHANNELS.index(name)] = np.repeat(values[::hold], hold)[:steps]
    return rows
