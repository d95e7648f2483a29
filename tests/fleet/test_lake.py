"""Questions to a lake: each shipped one, own ones, and refusals."""

from __future__ import annotations

from datetime import date
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import pytest

from bstm_daemon.errors import FileAccessError, UsageError
from bstm_daemon.fleet.lake import ask, shipped

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def fleet(make_fleet: Callable[..., Any]) -> Any:
    """Return two cars with two drives each, all replayed."""
    found = make_fleet(2, [0, 1])
    found.plan()
    for car in ("car0", "car1"):
        found.replay(car)
    return found


def rows_of(fleet: Any, car: str) -> list[dict[str, Any]]:
    return [
        pq.ParquetFile(fleet.lake.path(drive, "row")).read().to_pylist()[0]
        for drive in fleet.chain(car)
    ]


def answered(fleet: Any, sql: str) -> dict[str, dict[str, Any]]:
    """Return the rows of the answer by car."""
    answer = ask(fleet.lake, sql)
    rows = [dict(zip(answer.names, row, strict=True)) for row in answer.rows]
    return {row["vehicle"]: row for row in rows}


def test_hottest_and_margins(fleet: Any) -> None:
    hottest, margins = (answered(fleet, n) for n in ("hottest", "margins"))

    for car in ("car0", "car1"):
        corners = [c for row in rows_of(fleet, car) for c in row["corners"]]
        peak = max(corners, key=lambda c: c["disc_peak_c"])
        assert hottest[car]["corner"] == peak["corner"]
        assert hottest[car]["disc_c"] == round(peak["disc_peak_c"])
        assert hottest[car]["date"] == date(2023, 11, 14)
        least = min(corner["margin_k"] for corner in corners)
        assert margins[car]["margin_k"] == pytest.approx(least, abs=0.051)


def test_quality_and_wear(fleet: Any) -> None:
    quality, wear = (answered(fleet, n) for n in ("quality", "wear"))

    for car in ("car0", "car1"):
        rows = rows_of(fleet, car)
        # the start of the first drive is unknown throughout
        assert quality[car]["drives"] == 2
        assert quality[car]["after_hole"] == quality[car]["truncated"] == 0
        assert 0.0 <= quality[car]["valid_percent"] < 100.0
        last = rows[-1]["corners"]
        thinnest = min(corner["pad_thickness_m"] for corner in last)
        assert wear[car]["lining_mm"] == pytest.approx(
            1000 * thinnest, abs=0.01
        )


def test_warnings_leave_unknown_starts_out(fleet: Any) -> None:
    """No fluid is near boiling after one stop."""
    assert ask(fleet.lake, "warnings").rows == []


def test_every_shipped_question_has_an_answer(fleet: Any) -> None:
    for name in shipped():
        assert ask(fleet.lake, name).names


def test_own_questions_join_the_tables(fleet: Any) -> None:
    answer = ask(
        fleet.lake,
        """SELECT e.vehicle, count(*), max("FL.disc_c"),
                  (SELECT max(disc_peak_c) FROM corners c
                   WHERE c.vehicle = e.vehicle AND corner = 'FL')
           FROM Estimates e GROUP BY 1 ORDER BY 1""",
    )

    for car, (vehicle, count, rows_c, peak_c) in zip(
        ("car0", "car1"), answer.rows, strict=True
    ):
        assert vehicle == car
        assert count > 100
        assert rows_c == pytest.approx(peak_c, abs=0.01)


def test_refusals(fleet: Any, make_fleet: Callable[..., Any]) -> None:
    with pytest.raises(UsageError, match="colour"):
        ask(fleet.lake, "SELECT colour FROM drives")
    fleet.lake.root.rename(fleet.folder / "elsewhere")
    with pytest.raises(FileAccessError, match="bstm fleet replay"):
        ask(fleet.lake, "hottest")
