"""SIGKILL of the live service: its state is whole and fresh, whenever.

The service is killed while a car heats its brakes, at random instants, in
the start as well as later. ``BSTM_SIGKILLS`` sets how often.
"""

from __future__ import annotations

import os
import random
import signal
import threading
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.service.clock import boot_clock_ns
from bstm_daemon.service.state_file import read

from .daemon_process import Forked
from .peers import DEADLINE_S, stood_s

if TYPE_CHECKING:
    from collections.abc import Callable

    from .daemon_process import Daemon, Forks
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

BASE = 0x5B0
KILLS = int(os.environ.get("BSTM_SIGKILLS", "10"))
INTERVAL_S = 0.2
SAVE_S = 0.3
"""A save, and the cycle of 10 ms that asks for it, on a busy machine."""
IN_START = 0.2
"""The share of kills within the start, before the first frame."""
START_S = 0.3


@pytest.mark.full
def test_the_state_survives_sigkill_at_random_instants(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    forks: Forks,
    vcan0: str,
) -> None:
    """Whole, never older than an interval and a save, never colder."""
    heard = ear(vcan0)
    first = daemon({"state.interval_s": INTERVAL_S})
    driven = car()
    heard.wait(5, BASE)
    first.process.kill()
    first.exit_code()
    known = first.document()

    arguments = ["run", "-c", f"{first.config}", "--state", f"{first.state}"]
    chance = random.Random(20240225)  # noqa: S311
    pause = threading.Event()
    ages_s = []
    born_us = 0
    hottest_k = 0.0
    for _ in range(KILLS):
        count = len(heard.frames)
        service = Forked(forks, arguments, {})
        in_start = chance.random() < IN_START
        if in_start:
            pause.wait(chance.uniform(0.0, START_S))
        else:
            heard.wait(1, BASE, since=count)
            born_us = boot_clock_ns() // 1000
            pause.wait(chance.uniform(0.0, 2.5 * INTERVAL_S))
        kill_us = boot_clock_ns() // 1000
        service.kill()
        assert service.wait(DEADLINE_S) == -signal.SIGKILL
        service.stderr.close()

        loaded = read(first.state)
        assert loaded.problem is None
        assert loaded.document is not None
        # the history goes on from kill to kill
        assert loaded.document["boot_us"] >= known["boot_us"]
        known = loaded.document
        if not in_start:
            # what the life before left may still be there in the first
            # moments; and a computer that stood saved nothing
            since_us = max(known["boot_us"], born_us)
            sent = [f for f in driven.sent[-5000:] if f.boot_us >= since_us]
            ages_s.append((kill_us - since_us) * 1e-6 - stood_s(sent))
        hottest_k = max(hottest_k, known["corners"]["FL"]["disc"])

    # the figures, for who asks (pytest -rP)
    print(  # noqa: T201
        f"{KILLS} kills, {KILLS - len(ages_s)} of them in the start; oldest "
        f"state {max(ages_s):.3f} s, mean {sum(ages_s) / len(ages_s):.3f} s; "
        f"disc {hottest_k - 273.15:.0f} degC"
    )
    assert max(ages_s) <= INTERVAL_S + SAVE_S
    # heat of every life adds up: none began anew
    assert known["corners"]["FL"]["disc"] > hottest_k - 10.0
    assert hottest_k > 290.0
    driven.close()
    left = {path.name for path in first.state.parent.iterdir()}
    assert not any(".bad-" in name for name in left)
    # what a kill leaves beside it the next start takes away
    last = daemon(state=first.state)
    assert last.event("state_loaded")["new_nodes"] == []
    assert last.end() == 0
    left = {path.name for path in first.state.parent.iterdir()}
    assert not any(".tmp-" in name for name in left)
