"""The guest's power is cut while the service saves: the state is there.

The state lies on a directory of this machine. What the guest's kernel has
not been told to sync is lost with the guest, as on a board without power.
``BSTM_POWER_CUTS`` sets how often.
"""

from __future__ import annotations

import os
import random
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.service.state_file import load
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

pytestmark = pytest.mark.slow

RIG = Path(__file__).resolve().parent
ROOT = RIG.parents[1]
CUTS = int(os.environ.get("BSTM_POWER_CUTS", "2"))
INTERVAL_S = 0.2
SAVE_S = 0.5
"""A save, the cycle that asks for it and the way of a line of the clock."""

BOOT_S = 60.0
"""Until the first line of the guest, at the latest."""

DRIVE = """
[drive]
name = "hold"
description = "a descent of 8 % held at 72 km/h"
[[segment]]
speed_kmh = 72.0
rate_ms2 = 9.0
grade_percent = -8.0
duration_s = 60.0
"""

# tells the guest's clock as soon as this boot has saved; it switches itself
# off {off_s} s later
GUEST = """
{python} -u -c '
import os, time
def stamp():
    try:
        return os.stat("{state}").st_mtime_ns
    except FileNotFoundError:
        return None
before = stamp()
print()
off_s = float("inf")
while True:
    if stamp() != before:
        now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        print(now_ns // 1000)
        off_s = min(off_s, now_ns * 1e-9 + {off_s})
        if now_ns * 1e-9 > off_s:
            open("/proc/sysrq-trigger", "w").write("o")
    time.sleep(0.02)
' &
canplayer -I {log} vcan0=can0 &
exec {python} -m bstm_daemon.cli.main run -c {config} --state {state}
"""


@pytest.fixture(scope="module")
def possible() -> None:
    """Skip where the rig is not possible; fail if it is required to be."""
    probe = subprocess.run(
        [sys.executable, RIG / "possible.py"],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if probe.returncode or not shutil.which("canplayer"):
        reason = f"rig not possible: {probe.stdout or 'no canplayer'}"
        if os.environ.get("BSTM_RIG") == "required":
            pytest.fail(reason)
        pytest.skip(reason)


@pytest.mark.parametrize(
    "how", ["process", pytest.param("sysrq", marks=pytest.mark.full)]
)
def test_the_state_survives_the_end_of_the_guest(
    possible: None, tmp_path: Path, how: str
) -> None:
    """Killed from outside, or switched off from inside by ``sysrq o``."""
    log = tmp_path / "drive.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(log, simulate(parse_drive(DRIVE, "hold")), encoder)
    medium = tmp_path / "medium"
    medium.mkdir()
    state = medium / "car.state"
    config = tmp_path / "car.toml"
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    for old, new in (
        ('channel = "can0"', 'channel = "vcan0"'),
        ('dbc = "../dbc', f'dbc = "{ROOT}/dbc'),
        ("interval_s = 10.0\nidle", f"interval_s = {INTERVAL_S}\nidle"),
    ):
        assert old in text
        text = text.replace(old, new)
    config.write_text(text, "utf-8")
    chance = random.Random(f"power {how}")  # noqa: S311
    ages_s = []
    hottest_k = 0.0
    for _ in range(CUTS):
        life_s = chance.uniform(2.0, 4.0)
        from_inside = how == "sysrq"
        script = GUEST.format(
            log=log,
            python=sys.executable,
            config=config,
            state=state,
            off_s=life_s if from_inside else 1e9,
        )
        last_us = live(script, medium, BOOT_S if from_inside else life_s)

        loaded = load(state)
        assert loaded.problem is None
        document: dict[str, Any] = loaded.document or {}
        assert document
        ages_s.append((last_us - document["boot_us"]) * 1e-6)
        assert ages_s[-1] <= INTERVAL_S + SAVE_S
        # each life adds its heat to that of the ones before
        disc_k = document["corners"]["FL"]["disc"]
        assert disc_k > hottest_k
        hottest_k = disc_k
    # the figures, for who asks (pytest -rP)
    print(  # noqa: T201
        f"{CUTS} power cuts ({how}), oldest state {max(ages_s):.3f} s, "
        f"disc {hottest_k - 273.15:.0f} degC"
    )


def live(script: str, medium: Path, life_s: float) -> int:
    """Return what the guest's clock showed last [us since its boot].

    The guest is killed *life_s* after the first state was there.
    """
    lines = b""
    deadline_s = None
    with subprocess.Popen(
        [
            *(sys.executable, RIG / "vcan_run.py", "-w", medium),
            *("bash", "-c", script),
        ],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        bufsize=0,
    ) as guest:
        assert guest.stdout is not None
        while True:
            left_s = BOOT_S
            if deadline_s is not None:
                left_s = max(deadline_s - time.monotonic(), 0.0)
            if not select.select([guest.stdout], [], [], left_s)[0]:
                break
            if not (more := guest.stdout.read(65536)):
                break
            lines += more
            if deadline_s is None and lines.strip():
                deadline_s = time.monotonic() + life_s
        guest.kill()
        while more := guest.stdout.read(65536):
            lines += more
    assert lines.strip(), "nothing was saved before the power went"
    return int(lines[: lines.rindex(b"\n")].splitlines()[-1])
