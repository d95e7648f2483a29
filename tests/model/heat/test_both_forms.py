"""Whole cars, plans and drives drawn at random: both forms, bit for bit."""

from __future__ import annotations

import math
import os
import random
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from operator import mul
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bstm_daemon.model.compiled import generated_header
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.heat.memory import SampleMemory
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.native import layout
from bstm_daemon.native.sources import PACKAGE, SOURCES, digest
from bstm_daemon.roles import CORNERS, ROLES

from .conftest import STEP_US, Run

if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

LAW = FrictionLaw.of(
    temperature_k=lambda t: 1.2 - 3e-4 * t,
    pressure_pa=lambda p: 1.1 - 1e-9 * p,
    speed_ms=lambda v: 1.05 - 1e-3 * v,
)
JUMPS_US = (
    *(700_000, 5_000_000, -500_000, -3_000_000, 20_000_000) * 4,
    # seldom: pure Python marches an hour in seconds
    *(3_700_000_000, 13 * 3_600_000_000, -4_000_000_000),
    40 * 24 * 3_600_000_000,
)
DEFECTS = (math.nan, math.inf, -math.inf, 1e9, -1e9, 5.0)

PLANS = st.fixed_dictionaries(
    {
        "names": st.permutations(CORNERS).flatmap(
            lambda names: st.integers(1, 4).map(lambda n: names[:n])
        ),
        "secondary": st.sets(st.sampled_from(CORNERS)),
        "mode": st.sampled_from(["ff", "fb", "measured", "fused", "fused"]),
        "slope": st.sampled_from(["accelerometer", "flat"]),
        "torque_nm": st.sampled_from([None, 0.0, 200.0]),
        "lag_s": st.sampled_from([0.0, 0.1]),
        "table": st.booleans(),
        "law": st.booleans(),
        "unpressed": st.sampled_from([0.0, 0.5]),
        "settling_s": st.sampled_from([100.0, 86_400.0]),
        "absent": st.sets(st.sampled_from(range(len(ROLES))), max_size=40),
        "timeout_us": st.sampled_from([200_000, 500_000, 5_000_000]),
    }
)


CORNER = re.compile(r"_[fr][lr](?=_|$)")
"""Of the name of a role that each corner has."""

FAULTS: dict[str, Callable[[float, float], float]] = {
    "stuck": lambda _, last: last,
    "zero": lambda *_: 0.0,
    "half": lambda value, _: 0.5 * value,
    "triple": lambda value, _: 3.0 * value,
    "shifted": lambda value, _: value + 2.0,
    "much less": lambda value, _: value - 2e5,
    "reversed": lambda value, _: -value,
    "swinging": lambda value, last: 0.0 if last else value,
    "silent": lambda *_: math.nan,
}
"""What a faulty sensor shows of a value, with what it showed before."""


@dataclass
class Drive:
    """A drive that holds together, with defects, from one seed.

    ``faulty`` is the share of the roles that fail for good at some time;
    those of the four corners do so *together* or each alone.
    Those of ``stuck`` stay what they are at a braking in mid-drive.
    """

    seed: int
    steps: int
    defects: float
    step_us: int = 20_000
    faulty: float = 0.0
    together: bool = False
    stuck: str = ""

    def samples(self, roles: list[int]) -> list[tuple[int, int, float]]:
        """Return samples of *roles*: a car that pulls away and brakes."""
        draw = random.Random(self.seed)  # noqa: S311  (a drive, no secret)
        at_us = draw.choice([0, -1_234_567, 1_700_000_000_000_000])
        speed, rate = draw.uniform(0.0, 30.0), 0.0
        mass_kg, friction = draw.uniform(1500.0, 3500.0), draw.uniform(0.5, 1)
        grade, wheels = draw.uniform(-0.05, 0.05), draw.choice([1.0, 1.1])
        kinds = {role: self._kind(role) for role in roles}
        faults = {
            kind: (draw.randrange(self.steps), draw.choice([*FAULTS.values()]))
            for kind in dict.fromkeys(kinds.values())
            if self.faulty and draw.random() < self.faulty
        }
        shown: dict[int, float] = {}
        altitude_m = 200.0
        found = []
        for step in range(self.steps):
            if step % 60 == 0:
                rate = draw.choice([0.0, 1.5, 0.5, -2.0, -4.0])
                rate = -2.0 if speed > 40.0 else rate
            share = draw.choice([1.0, 1.0, 1.0, 2.5, 0.25])
            at_us += round(share * self.step_us)
            if draw.random() < 0.1 * self.defects:
                at_us += draw.choice(JUMPS_US)
            speed = max(speed + 1e-6 * self.step_us * rate, 0.0)
            altitude_m += 1e-6 * self.step_us * grade * speed
            force = mass_kg * (rate + 9.81 * (0.014 + grade)) + 4.0 * speed
            braking = max(-rate - 0.3, 0.0) if speed > 0.0 else 0.0
            if self.stuck and step > self.steps // 3 and braking > 1.0:
                faults.setdefault(self.stuck, (step, FAULTS["stuck"]))
            held = {
                "speed": speed * wheels,
                "pressure": braking * mass_kg / friction / 24e-4,
                "acceleration": 1.02 * rate + 9.81 * grade + 0.1,
                "torque": 0.33 * force if rate > -0.5 else -50.0,
                "force": 0.0,
                "temperature": 290.0 + 0.1 * (step % 90),
                "flag": 0.0,
                "brake_switch": float(braking > 0.0),
                "brake_torque": 0.33 * braking * mass_kg,
                "motor_torque": 0.0,
                "acceleration_lateral": 0.0,
                "gnss_speed": speed,
                "pitch": grade,
                "altitude": altitude_m,
                "brake_pedal_travel": 0.01 * braking,
                "count": float(3 + step // 500 % 2),
            }
            for role in roles:
                if draw.random() < 0.2:
                    continue
                of = ROLES[role]
                value = held.get(of.name, held.get(of.quantities[0], 0.0))
                begin, shows = faults.get(kinds[role], (self.steps, None))
                if shows is not None and step >= begin:
                    value = shows(value, shown.get(role, value))
                shown[role] = value
                if draw.random() < self.defects:
                    value = draw.choice([*DEFECTS, 50.0 * value, -value])
                found.append((at_us, role, value))
            if draw.random() < self.defects:
                found.append((at_us, draw.choice([-1, 500, 7]), 1.0))
        return found

    def _kind(self, role: int) -> str:
        name = ROLES[role].name
        return CORNER.sub("", name) if self.together else name


DRIVES = st.builds(
    Drive,
    st.integers(0, 2**32),
    st.sampled_from([50, 150, 300]),
    st.sampled_from([0.0, 0.002, 0.02]),
)


def runs(
    chosen: dict[str, Any],
    drive: Drive,
    compiled: Kernel,
    make_car: Any,
    make_corner: Any,
    *,
    shaken: int | None = None,
) -> tuple[Run, Run]:
    """Return both forms after the drive.

    With *shaken*, a seed, each has another memory from the middle on.
    """
    corners = [
        make_corner(
            name,
            circuit="secondary" if name in chosen["secondary"] else "primary",
        )
        for name in chosen["names"]
    ]
    heat = {
        "mode": chosen["mode"],
        "slope": chosen["slope"],
        "primary_lag_s": chosen["lag_s"],
        "assume_powertrain_torque_nm": chosen["torque_nm"],
        "front_pressure_pa": [1e5, 2e6, 6e6] if chosen["table"] else [],
        "rear_pressure_pa": [1e5, 2e6, 3e6] if chosen["table"] else [],
    }
    heat = {key: value for key, value in heat.items() if value is not None}
    config = make_car(*corners, heat=heat)
    roles = [i for i in range(len(ROLES)) if i not in chosen["absent"]]
    plan = plan_samples(
        config,
        dict.fromkeys(roles, chosen["timeout_us"]),
        STEP_US,
        chosen["settling_s"],
        {chosen["names"][0]: LAW} if chosen["law"] else None,
        chosen["unpressed"],
    )
    samples = drive.samples(roles)
    half = len(samples) // 2
    one, two = Run(plan, None), Run(plan, compiled)
    for run in (one, two):
        run.feed(samples[:half])
        for corner in range(len(corners)):
            run.state.heat_interface(corner, 500.0 + 10.0 * corner)
        if shaken is not None:
            shake(run.state.numbers, random.Random(shaken))  # noqa: S311
        run.feed(samples[half:])
    return one, two


def shake(numbers: array[float], draw: random.Random) -> None:
    """Put some of *numbers* where a drive seldom brings them.

    What is learned stays, as no covariance is drawn, and the sine.
    """
    learned, end, sine = (
        layout.first(SampleMemory, f"observer.{name}")
        for name in ("known.x", "copy_age_s", "sine")
    )
    for i in {*range(len(numbers))} - {*range(learned, end), sine}:
        match draw.randrange(8):
            case 0 | 1:
                numbers[i] *= draw.choice([0.0, 0.3, 0.9, 1.1, 4.0])
            case 2:
                numbers[i] += draw.choice([0.1, 2.0, 30.0, 400.0])
    slope, at_0 = draw.choice([0.5, 1.0, 2.0]), draw.choice([-1.0, 0.0, 1.0])
    pressed = [draw.uniform(0.3, 4.0) for _ in range(draw.choice([15, 60]))]
    moved = [at_0 + slope * x + draw.gauss(0.0, 0.3) for x in pressed]
    turn, lateral = (draw.choice([0.5, 5.0, 50.0]) for _ in range(2))
    motion = draw.choice([20.0, 80.0])
    sums = {
        "observer.balance_count": float(len(pressed)),
        "observer.balance_x": sum(pressed),
        "observer.balance_y": sum(moved),
        "observer.balance_xx": sum(x * x for x in pressed),
        "observer.balance_xy": sum(map(mul, pressed, moved)),
        "observer.balance_yy": sum(y * y for y in moved),
        "observer.balance_std": 0.1 * len(pressed),
        "checks.turn_square": turn * turn,
        "checks.lateral_square": lateral * lateral,
        "checks.turn_lateral": draw.choice([0.3, 0.9, 1.0]) * turn * lateral,
        "checks.motion": motion,
        "checks.agreement": draw.choice([-1.0, -0.3, 0.3, 1.0]) * motion,
        "observer.unpressed_s": draw.choice([0.0, 5.9, 8.0]),
        "samples.pedal_lost": draw.choice([0.0, 19.0, 30.0]),
    }
    for path, value in sums.items():
        numbers[layout.first(SampleMemory, path)] = value


def same(one: Run, two: Run) -> bool:
    return one.bits() == two.bits() and one.codes == two.codes


TOO_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=TOO_SLOW)
@given(chosen=PLANS, drive=DRIVES)
def test_random_cars_and_drives(
    compiled: Kernel,
    make_car: Any,
    make_corner: Any,
    chosen: dict[str, Any],
    drive: Drive,
) -> None:
    """Rows, flags, codes and the whole memory are equal."""
    assert same(*runs(chosen, drive, compiled, make_car, make_corner))


@pytest.mark.parametrize("seed", range(30))
def test_any_memory(
    compiled: Kernel, make_car: Any, make_corner: Any, seed: int
) -> None:
    """Rules of what is learned act alike, wherever that has got to."""
    draw = random.Random(seed)  # noqa: S311
    chosen = {
        "names": CORNERS,
        "secondary": set(CORNERS[2:]),
        "mode": draw.choice(["fused", "fused", "fused", "fb", "ff"]),
        "slope": draw.choice(["accelerometer", "accelerometer", "flat"]),
        "torque_nm": draw.choice([None, 200.0]),
        "lag_s": 0.1,
        "table": True,
        "law": False,
        "unpressed": 0.5,
        "settling_s": 3600.0,
        "absent": {*draw.sample(range(len(ROLES)), draw.choice([0, 4, 12]))},
        "timeout_us": 500_000,
    }
    drive = Drive(seed, 160, 0.0, step_us=100_000)

    assert same(
        *runs(chosen, drive, compiled, make_car, make_corner, shaken=seed)
    )


@pytest.mark.full
@pytest.mark.slow
@settings(deadline=None, suppress_health_check=TOO_SLOW)
@given(chosen=PLANS, drive=DRIVES)
def test_many_random_cars_and_drives(
    compiled: Kernel,
    make_car: Any,
    make_corner: Any,
    chosen: dict[str, Any],
    drive: Drive,
) -> None:
    """The same, longer: also what only minutes of driving bring about."""
    drive.steps *= 10
    assert same(*runs(chosen, drive, compiled, make_car, make_corner))


BRAKE_PRESSURES = {i for i, one in enumerate(ROLES) if "pressure" in one.name}
EACH_FIFTH = set(range(3, len(ROLES), 5))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "seed", "absent"),
    [
        *(("fused", seed, set()) for seed in (0, 9, 11, 23, 29)),
        *(("fused", seed, EACH_FIFTH) for seed in (1, 3)),
        *(("ff", 38, EACH_FIFTH), ("fb", 2, EACH_FIFTH)),
        *(("fb", seed, BRAKE_PRESSURES) for seed in (5, 6)),
    ],
)
def test_minutes_with_sensors_that_fail(
    compiled: Kernel,
    make_car: Any,
    make_corner: Any,
    mode: str,
    seed: int,
    absent: set[int],
) -> None:
    """What is judged, learned and replaced over time is equal too."""
    chosen = {
        "names": CORNERS,
        "secondary": set(CORNERS[2:]),
        "mode": mode,
        "slope": "flat" if seed in {2, 6} else "accelerometer",
        "torque_nm": 200.0 if seed == 1 else None,
        "lag_s": 0.1,
        "table": True,
        "law": seed == 0,
        "unpressed": 0.5,
        "settling_s": 3600.0,
        "absent": absent,
        "timeout_us": 500_000,
    }
    faulty = 0.08 * (seed % 5)
    drive = Drive(
        *(seed, 2000, 1e-5),
        step_us=100_000,
        faulty=faulty,
        together=seed in {3, 6, 9},
        stuck={9: "wheel_speed", 11: "primary_pressure"}.get(seed, ""),
    )

    assert same(*runs(chosen, drive, compiled, make_car, make_corner))


SANITIZED = """
import importlib.util, sys
import pytest
name = "bstm_daemon.native._kernel"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
sys.modules[name] = module
sys.exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""


@pytest.mark.slow
def test_both_forms_under_the_sanitizers(tmp_path: Path) -> None:
    """No read outside a buffer and nothing undefined, in the same drives."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no gcc here")
    asan = subprocess.run(
        [compiler, "-print-file-name=libasan.so"],
        capture_output=True,
        check=True,
        text=True,
    ).stdout.strip()
    if not Path(asan).is_file():
        pytest.skip("gcc has no address sanitizer here")
    (tmp_path / "generated.h").write_text(generated_header(), encoding="utf-8")
    library = tmp_path / "_kernel.abi3.so"
    module = "native._kernel"
    subprocess.run(
        [
            *(compiler, "-shared", "-fPIC", "-g", "-O1", "-ffp-contract=off"),
            *("-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
            *("-DPy_LIMITED_API=0x030B0000", f"-I{tmp_path}"),
            f'-DBSTM_SOURCES="{digest(module)}"',
            f"-I{sysconfig.get_paths()['include']}",
            *(str(PACKAGE / name) for name in SOURCES[module]),
            *("-lm", "-o", str(library)),
        ],
        check=True,
    )
    here = Path(__file__)

    done = subprocess.run(
        [
            *(sys.executable, "-c", SANITIZED, str(library)),
            f"{here}::test_random_cars_and_drives",
            str(here.with_name("test_sample_time.py")),
            str(here.parents[1] / "thermal" / "test_kernel_buffers.py"),
        ],
        capture_output=True,
        check=False,
        cwd=here.parents[3],
        env={
            **os.environ,
            "LD_PRELOAD": asan,
            "ASAN_OPTIONS": "detect_leaks=0",
            "BSTM_KERNEL": "compiled",
        },
        text=True,
    )

    assert done.returncode == 0, done.stdout + done.stderr
