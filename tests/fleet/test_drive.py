"""One drive of a chain: what it writes, what it begins from, how it fails."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.estimate import Reason
from bstm_daemon.fleet.drive import (
    FAILED,
    FOREIGN,
    MADE,
    SKIPPED,
)
from bstm_daemon.service import state_file

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def by_hand(
    fleet: Any, log: Path, before: Path | None, folder: Path
) -> tuple[Path, dict[str, Any]]:
    """Replay *log* as a user would; return the state and the columns."""
    state = folder / f"{log.stem}.state"
    start = ["--state", before] if before else []
    arguments = [
        *("replay", log, "-c", fleet.folder / "car.toml", "--no-forecast"),
        *("-o", folder, "--format", "parquet", "--state-out", state, *start),
    ]
    assert main([*map(str, arguments)]) == 0
    table = pq.read_table(folder / f"{log.stem}.estimates.parquet")
    return state, {n: table[n].to_numpy() for n in table.column_names}


def columns_of(path: Path) -> dict[str, Any]:
    table = pq.ParquetFile(path).read()
    return {n: table[n].to_numpy() for n in table.column_names}


@pytest.mark.slow
def test_a_chain_equals_the_chain_by_hand(
    make_fleet: Callable[..., Any], tmp_path: Path
) -> None:
    """The states byte for byte, the rows at their resolution."""
    fleet = make_fleet(1, [2, 0, 1])
    fleet.plan()

    assert fleet.replay("car0") == [MADE, MADE, MADE]

    before = None
    for drive in fleet.chain("car0"):
        log = fleet.log("car0", int(drive.name[-1]))
        before, expected = by_hand(fleet, log, before, tmp_path)
        estimates, row, state = fleet.lake.files(drive)
        assert state.read_bytes() == before.read_bytes()
        found = columns_of(estimates)
        assert {n.partition(".")[2] for n in found} >= {
            *("disc_c", "pad_front_c", "pad_back_c", "fluid_c"),
            *("margin_k", "validity", "reasons"),
        }
        for name, column in found.items():
            np.testing.assert_array_equal(column, expected[name])
        (one,) = pq.ParquetFile(row).read().to_pylist()
        corner = next(c for c in one["corners"] if c["corner"] == "FL")
        assert corner["disc_peak_c"] == pytest.approx(
            np.max(expected["FL.disc_c"]), abs=0.01
        )
        assert corner["margin_k"] == pytest.approx(
            np.min(expected["FL.margin_k"]), abs=0.01
        )
        assert one["distance_m"] == pytest.approx(
            np.ptp(expected["distance_m"]), abs=0.1
        )
        assert not one["after_hole"]


def test_the_second_time_nothing_is_written(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0, 1])
    fleet.plan()
    fleet.replay("car0")
    before = fleet.files()

    assert fleet.replay("car0") == [SKIPPED, SKIPPED]

    assert fleet.files() == before


def test_a_corrupt_log_costs_itself_and_the_chain_goes_on(
    make_fleet: Callable[..., Any],
) -> None:
    """From the last good state, marked as after driving that nobody saw."""
    fleet = make_fleet(1, [0, 1, 2])
    fleet.log("car0", 1).write_bytes(b"no log\n" * 100)
    (unread,) = fleet.plan()
    assert unread.name == "drive1"

    assert fleet.replay("car0") == [MADE, FAILED, MADE]

    first, bad, last = fleet.chain("car0")
    receipt = fleet.lake.receipt(bad)
    assert "drive1.log" in receipt.message
    assert not fleet.lake.path(bad, "estimates").exists()
    good = state_file.read(fleet.lake.path(first, "state")).document
    marked = state_file.read(fleet.lake.path(bad, "state")).document
    assert marked["corners"] == good["corners"]
    assert marked["drove_unseen"] is True
    (row,) = pq.ParquetFile(fleet.lake.path(last, "row")).read().to_pylist()
    assert row["after_hole"]
    rows = columns_of(fleet.lake.path(last, "estimates"))
    reasons = rows["FL.reasons"].astype(int)
    for reason in (Reason.START_UNKNOWN, Reason.INPUT_SUSPECT):
        assert (reasons & reason != 0).all()
    assert (rows["FL.validity"] == 1).all()
    # the wear goes on
    after = state_file.read(fleet.lake.path(last, "state")).document
    before_j = good["corners"]["FL"]["wear_dose_j"]
    assert after["corners"]["FL"]["wear_dose_j"] > before_j


def test_an_overlap_is_refused_by_name(
    make_fleet: Callable[..., Any], recorded: list[bytes]
) -> None:
    fleet = make_fleet(1, [0])
    lines = recorded[0].splitlines(keepends=True)
    fleet.log("car0", 5).write_bytes(b"".join(lines[1000:]))
    fleet.plan()

    assert fleet.replay("car0") == [MADE, FAILED]

    message = fleet.lake.receipt(fleet.chain("car0")[1]).message
    assert "drive5.log: begins before the end" in message
    assert message.endswith("drive0.log")


def test_a_log_that_changed_since_the_plan_is_not_replayed(
    make_fleet: Callable[..., Any],
) -> None:
    """And is tried again once it is planned: its receipt has no key."""
    fleet = make_fleet(1, [0, 1])
    fleet.plan()
    log = fleet.log("car0", 0)
    whole = log.read_bytes()
    log.write_bytes(whole[: whole.rindex(b"(")])

    assert fleet.replay("car0") == [FAILED, MADE]
    first = fleet.lake.receipt(fleet.chain("car0")[0])
    assert "has changed since 'bstm fleet plan'" in first.message
    assert first.key == ""

    fleet.plan()
    assert fleet.replay("car0") == [MADE, MADE]
    row = pq.ParquetFile(fleet.lake.path(fleet.chain("car0")[1], "row")).read()
    assert row["after_hole"].to_pylist() == [False]


def test_a_touched_log_is_read_but_not_replayed(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()
    fleet.replay("car0")
    estimates = fleet.lake.path(fleet.chain("car0")[0], "estimates")
    before = estimates.stat()
    os.utime(fleet.log("car0", 0))
    fleet.plan()

    assert fleet.replay("car0") == [SKIPPED]

    assert estimates.stat().st_ino == before.st_ino


def test_a_deleted_result_is_made_anew(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()
    fleet.replay("car0")
    before = fleet.files()
    fleet.lake.path(fleet.chain("car0")[0], "estimates").unlink()

    assert fleet.replay("car0") == [MADE]

    assert fleet.files() == before


def test_what_killed_runs_left_goes(make_fleet: Callable[..., Any]) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()
    estimates = fleet.lake.path(fleet.chain("car0")[0], "estimates")
    estimates.parent.mkdir(parents=True)
    leftover = estimates.with_name(f".{estimates.name}.abc123")
    leftover.write_bytes(b"half a table")

    assert fleet.replay("car0") == [MADE]

    assert not leftover.exists()


def test_a_worker_of_another_program_does_nothing(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()

    assert fleet.replay("car0", program={"bstm": "9"}) == [FOREIGN]

    assert fleet.files() == {}
