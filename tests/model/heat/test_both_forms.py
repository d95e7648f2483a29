"""Whole cars, plans and drives drawn at random: both forms, bit for bit."""

from __future__ import annotations

import math
import os
import random
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bstm_daemon.model.compiled import generated_header
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.native.sources import PACKAGE, SOURCES, digest
from bstm_daemon.roles import CORNERS, ROLES

from .conftest import STEP_US, Run

if TYPE_CHECKING:
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


@dataclass
class Drive:
    """A drive that holds together, with defects, from one seed."""

    seed: int
    steps: int
    defects: float

    def samples(self, roles: list[int]) -> list[tuple[int, int, float]]:
        """Return samples of *roles*: a car that pulls away and brakes."""
        draw = random.Random(self.seed)  # noqa: S311  (a drive, no secret)
        at_us = draw.choice([0, -1_234_567, 1_700_000_000_000_000])
        speed, rate = draw.uniform(0.0, 30.0), 0.0
        mass_kg, friction = draw.uniform(1500.0, 3500.0), draw.uniform(0.5, 1)
        grade, wheels = draw.uniform(-0.05, 0.05), draw.choice([1.0, 1.1])
        found = []
        for step in range(self.steps):
            if step % 60 == 0:
                rate = draw.choice([0.0, 1.5, 0.5, -2.0, -4.0])
                rate = -2.0 if speed > 40.0 else rate
            at_us += draw.choice([20_000, 20_000, 20_000, 50_000, 5_000])
            if draw.random() < 0.1 * self.defects:
                at_us += draw.choice(JUMPS_US)
            speed = max(speed + 0.02 * rate, 0.0)
            force = mass_kg * (rate + 9.81 * (0.014 + grade)) + 4.0 * speed
            braking = max(-rate - 0.3, 0.0) if speed > 0.0 else 0.0
            held = {
                "speed": speed * wheels,
                "pressure": braking * mass_kg / friction / 24e-4,
                "acceleration": 1.02 * rate + 9.81 * grade + 0.1,
                "torque": 0.33 * force if rate > -0.5 else -50.0,
                "force": 0.0,
                "temperature": 290.0 + 0.1 * (step % 90),
                "flag": float(braking > 0.0),
                "count": float(3 + step // 500 % 2),
            }
            for role in roles:
                if draw.random() < 0.2:
                    continue
                value = held.get(ROLES[role].quantities[0], 0.0)
                if draw.random() < self.defects:
                    value = draw.choice([*DEFECTS, 50.0 * value, -value])
                found.append((at_us, role, value))
            if draw.random() < self.defects:
                found.append((at_us, draw.choice([-1, 500, 7]), 1.0))
        return found


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
) -> tuple[Run, Run]:
    """Return both forms after the drive."""
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
        run.feed(samples[half:])
    return one, two


def same(one: Run, two: Run) -> bool:
    return one.bits() == two.bits() and one.codes == two.codes


TOO_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]


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
