"""What ``bstm identify`` recovers of simulated cars, from their CAN frames.

Cars are drawn at random around the configured one, so that no prior is right;
the reality shares no physics code with the identification.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from side_by_side import Outcome, Table

from bstm_daemon.analysis.identify.brakes import identify_brakes
from bstm_daemon.analysis.identify.coastdown import identify_coast_down
from bstm_daemon.analysis.identify.cooling import (
    CoolingPoint,
    identify_cooling,
)
from bstm_daemon.analysis.identify.driving import Driving, driving_of
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import (
    NOMINAL,
    load_drive,
    preset_effects,
    simulate,
)
from bstm_daemon.simulation.parameters import FRONT
from bstm_daemon.simulation.recorder import Encoder, write_candump

SENSORS = ("n1", "n2", "n3")
THERMOCOUPLES = ("n1", "n2", "n3", "n4")
SERIES = ("idiada-step", "idiada-ramp", "idiada-pulse")
COASTS = {"accelerometer": False, "even grade": True}
KEYS = ("drag_area_m2", "friction_ns_m", "rolling_resistance")


def run(*, full: bool) -> Outcome:
    """Recover 4 cars (full: 20) with each sensor preset."""
    cars = 20 if full else 4
    outcome = Outcome(
        "Identified against true",
        f"{cars} cars a row, drawn around the configured one: drag area 0.5 "
        "to 1.0 m2, C_fric 2 to 8 N s/m, f_r 0.009 to 0.018; friction scale "
        "0.7 to 1.3, push-out 0 to 1.5 bar. Median and largest absolute "
        "error; within: share of the errors below two standard errors.",
    )
    drives = 10 if full else 1
    clean = [point.value for point in _cooling_points("none", 0)]
    outcome.tables = [
        Table(
            "Coast-down: drive coastdown, four runs on 0.2 %",
            (
                *("sensors, grade from", "drag, %", "C_fric, N s/m"),
                *("f_r, 1e-4", "within"),
            ),
            tuple(
                _coast_row(sensors, way, cars)
                for sensors in SENSORS
                for way in COASTS
            ),
        ),
        Table(
            "Brakes: drives idiada-step, -ramp and -pulse",
            ("sensors, preset", "friction scale, %", "push-out, bar"),
            tuple(
                _brake_row(sensors, preset, cars)
                for preset in ("plain", "road")
                for sensors in SENSORS
            ),
        ),
        Table(
            f"Cooling: drive cooling, {drives} times a row, 18 to 150 km/h, "
            "form conductance",
            (
                *("sensors", "off clean sensors, %", "standard error, %"),
                *("off h A / m cp, %", "90 % holds"),
            ),
            tuple(
                _cooling_row(sensors, drives, clean)
                for sensors in THERMOCOUPLES
            ),
        ),
    ]
    return outcome


def _coast_row(sensors: str, way: str, cars: int) -> tuple[str, ...]:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    apart, within = [], []
    for seed in range(cars):
        rng = np.random.default_rng(seed)
        true = {
            "drag_area_m2": rng.uniform(0.5, 1.0),
            "friction_ns_m": rng.uniform(2.0, 8.0),
            "rolling_resistance": rng.uniform(0.009, 0.018),
        }
        read = _driving(
            "coastdown", sensors, seed, car=replace(NOMINAL, **true)
        )
        found = identify_coast_down([read], config, even_grade=COASTS[way])
        errors = [abs(found.values[k].value - true[k]) for k in KEYS]
        apart.append([errors[0] / true[KEYS[0]], *errors[1:]])
        within += [
            error < 2.0 * found.values[k].standard_error
            for k, error in zip(KEYS, errors, strict=True)
        ]
    return (
        f"{sensors}, {way}",
        *(
            _both(column * factor)
            for column, factor in zip(
                np.array(apart).T, (100.0, 1.0, 1e4), strict=True
            )
        ),
        f"{100 * np.mean(within):.0f} %",
    )


def _brake_row(sensors: str, preset: str, cars: int) -> tuple[str, ...]:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    apart = []
    for seed in range(cars):
        rng = np.random.default_rng(seed)
        scale, pushout = rng.uniform(0.7, 1.3), rng.uniform(0.0, 1.5)
        corners = [
            corner.model_copy(
                update={
                    "friction_coefficient": corner.friction_coefficient / scale
                }
            )
            for corner in config.corner
        ]
        effects = preset_effects(preset).with_strength(
            "pushout_pressure", pushout
        )
        drivings = [
            _driving(name, sensors, seed, preset=effects) for name in SERIES
        ]
        found = identify_brakes(
            drivings, config.model_copy(update={"corner": corners})
        )
        # with friction that leans there is no one true scale to compare
        error = 100.0 * abs(found.scale.value / scale - 1.0)
        apart.append(
            (
                error if preset == "plain" else np.nan,
                abs(found.pushout_pa.value / 1e5 - pushout),
            )
        )
    return (
        f"{sensors}, {preset}",
        *(_both(column) for column in np.array(apart).T),
    )


def _both(errors: np.ndarray) -> str:
    if np.isnan(errors).any():
        return "-"
    return f"{np.median(errors):.2g} / {errors.max():.2g}"


def _driving(name: str, sensors: str, seed: int, **options: Any) -> Driving:
    config, plan = load_vehicle(shipped_file("config/example_vehicle.toml"))
    car = options.pop("car", None)
    driven = simulate(
        load_drive(name), car, sensors=sensors, seed=seed, **options
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.log"
        write_candump(
            path, driven, Encoder(shipped_file("dbc/example_vehicle.dbc"))
        )
        return driving_of(name, read_recording([path], plan), config, plan)


def _cooling_row(
    sensors: str, drives: int, clean: list[float]
) -> tuple[str, ...]:
    apart, true_apart, within, widths = [], [], [], []
    for seed in range(drives):
        points = _cooling_points(sensors, seed)
        for point, value in zip(points, clean, strict=True):
            error = point.value / value - 1.0
            apart.append(100.0 * abs(error))
            width = point.standard_error / point.value
            widths.append(100.0 * width)
            within.append(abs(error) < 1.645 * width)
            true = true_cooling_per_s(point.speed_ms)
            true_apart.append(100.0 * abs(point.value / true - 1.0))
    return (
        sensors,
        *(_both(np.array(one)) for one in (apart, widths, true_apart)),
        f"{100 * np.mean(within):.0f} %",
    )


def _cooling_points(sensors: str, seed: int) -> list[CoolingPoint]:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    cooling = config.cooling.model_copy(update={"form": "conductance"})
    config = config.model_copy(update={"cooling": cooling})
    read = _driving("cooling", sensors, seed)
    (axle,) = identify_cooling([read], config).axles
    return [point for point in axle.points if point.speed_ms > 0.0]


def true_cooling_per_s(speed_ms: float) -> float:
    """Return h A of the reality's front disc over m cp at 20 degC, 250 K.

    As one isothermal lump: convection of faces and vanes, natural and forced.
    """
    natural = FRONT.natural_convection_w_m2k * (250.0 / 200.0) ** 0.25
    wind = speed_ms**FRONT.forced_exponent
    conductance = 0.0
    for area_m2, still, forced in (
        (2.0 * FRONT.face_air_area_m2, 1.0, FRONT.forced_face_w_m2k),
        (
            FRONT.vent_area_m2,
            FRONT.parked_vent_fraction,
            FRONT.forced_vent_w_m2k,
        ),
    ):
        conductance += area_m2 * float(
            np.cbrt((still * natural) ** 3 + (forced * wind) ** 3)
        )
    return conductance / (FRONT.ring_mass_kg * 460.0)
