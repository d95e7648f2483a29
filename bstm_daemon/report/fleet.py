"""The page of ``bstm fleet report``: cars, days, the worst drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bstm_daemon.report.drive_statistics import VALIDITY_NAMES
from bstm_daemon.report.plots import BLUE, VERMILION, Plot, numbers, plot
from bstm_daemon.report.replay_page import DASH
from bstm_daemon.report.shell import Cell, Page, Section, Table
from bstm_daemon.report.text import percent

Row = Mapping[str, Any]


CARS_SHOWN: Final = 40
FAILURES_SHOWN: Final = 40
FEW: Final = 10
DAY_MS: Final = 86_400_000


@dataclass(frozen=True)
class FleetFacts:
    """Content of the page.

    ``cars``, ``dates`` and ``worst`` are rows of the shipped questions of
    these names; ``pages`` has the address of a drive's own page by car and
    name; ``failures`` are lines, ``waiting`` counts drives.
    """

    title: str
    cars: Sequence[Row]
    dates: Sequence[Row]
    worst: Sequence[Row]
    pages: Mapping[tuple[str, str], str]
    failures: Sequence[str] = ()
    waiting: int = 0


def fleet_page(facts: FleetFacts) -> Page:
    """Return the page of a fleet."""
    sections = [
        Section(
            "Drives with the least margin to wet boiling",
            Table(
                (
                    *("car", "drive", "margin [K]", "disc [°C]"),
                    *("fluid [°C]", "corner", "day", "minutes", "fluid peak"),
                ),
                [_worst_row(row, facts.pages) for row in facts.worst],
            ),
        ),
        Section(
            "Cars",
            plots=(
                ("hottest disc of each car", _of_cars(facts.cars, "disc_c")),
                ("least margin of each car", _of_cars(facts.cars, "margin_k")),
            ),
            note="A point is a car, in the order of its value; its name is "
            "shown where the pointer is.",
        ),
        Section(
            "Cars with the least margin",
            _cars(facts.cars),
            note="all cars: bstm fleet query LAKE cars",
        ),
        Section(
            "Days",
            plots=(
                ("hottest disc of the day", _of_days(facts.dates, "disc_c")),
                ("least margin of the day", _of_days(facts.dates, "margin_k")),
            ),
        ),
    ]
    if facts.failures:
        left = len(facts.failures) - FAILURES_SHOWN
        lines = [*facts.failures[:FAILURES_SHOWN]]
        lines += [f"and {left} more: bstm fleet status"] * (left > 0)
        sections.insert(0, Section("Not replayed", lines=lines, kind="faults"))
    if facts.waiting:
        line = f"{facts.waiting} drives wait for 'bstm fleet replay'"
        sections.insert(0, Section("Waiting", lines=[line], kind="warnings"))
    return Page(facts.title, sections, _tiles(facts), sentence(facts))


def sentence(facts: FleetFacts) -> str:
    """Return for a person which car came nearest to boiling."""
    known = [row for row in facts.worst if row["margin_k"] is not None]
    if not known:
        return "No drive has a margin to boiling."
    worst = known[0]
    return (
        f"Nearest to boiling came {worst['vehicle']}, {worst['corner']}, on "
        f"{worst['date']} ({worst['name']}): {worst['margin_k']:.0f} K were "
        "left with wet fluid."
    )


def _tiles(facts: FleetFacts) -> list[tuple[str, str]]:
    drives, hours, km = (
        sum(row[name] or 0 for row in facts.cars)
        for name in ("drives", "hours", "km")
    )
    disc_c = [row["disc_c"] for row in facts.cars if row["disc_c"] is not None]
    tiles = [
        (f"{len(facts.cars)}", "cars"),
        (f"{drives}", f"drives, {hours:.0f} h, {km:.0f} km"),
    ]
    if disc_c:
        tiles.append((f"{max(disc_c):.0f} °C", "hottest disc"))
    for row in facts.cars[:1]:
        if row["margin_k"] is not None:
            what = f"least margin to wet boiling, {row['vehicle']}"
            tiles.append((f"{row['margin_k']:.0f} K", what))
    tiles.append((f"{len(facts.failures)}", "drives not replayed"))
    return tiles


def _worst_row(
    row: Row, pages: Mapping[tuple[str, str], str]
) -> list[str | Cell]:
    vehicle, name = row["vehicle"], row["name"]
    validity = row["validity"]
    return [
        vehicle,
        Cell(name, href=pages.get((vehicle, name), "")),
        *(_whole(row[key]) for key in ("margin_k", "disc_c", "fluid_c")),
        row["corner"],
        f"{row['date']}",
        _whole(row["minutes"]),
        DASH if validity is None else VALIDITY_NAMES[validity],
    ]


def _cars(cars: Sequence[Row]) -> Table:
    head = ("car", "margin [K]", "disc [°C]", "drives", "hours", "km")
    rows = [
        [
            row["vehicle"],
            Cell(_whole(row["margin_k"]), row["corner"] or ""),
            *(_whole(row[k]) for k in ("disc_c", "drives", "hours", "km")),
            DASH if row["lining_mm"] is None else f"{row['lining_mm']:.2f}",
            DASH if row["valid"] is None else percent(row["valid"]),
            f"{row['after_hole']}",
        ]
        for row in cars[:CARS_SHOWN]
    ]
    return Table((*head, "lining [mm]", "valid", "after a gap"), rows)


def _whole(value: float | None) -> str:
    return DASH if value is None else f"{value:.0f}"


def _of_cars(cars: Sequence[Row], key: str) -> Plot:
    known = [row for row in cars if row[key] is not None]
    known.sort(key=lambda row: (row[key], row["vehicle"]))
    look = {"mode": "markers", "text": [row["vehicle"] for row in known]}
    places = [*range(1, len(known) + 1)]
    return _points(known, key, places, look, "car, by its value", 1)


def _of_days(days: Sequence[Row], key: str) -> Plot:
    known = [row for row in days if row[key] is not None]
    look = {"mode": "lines+markers", "line": {"width": 1}}
    dates = [f"{row['date']}" for row in known]
    return _points(known, key, dates, look, "", DAY_MS)


def _points(
    rows: Sequence[Row],
    key: str,
    x: Sequence[object],
    look: Mapping[str, Any],
    title: str,
    step: int,
) -> Plot:
    """Return a point for each of *rows*; few have a tick each *step*."""
    points = {
        "type": "scatter",
        "x": x,
        "y": numbers(np.array([row[key] for row in rows])),
        "marker": {"size": 5, "color": VERMILION if key == "disc_c" else BLUE},
        **look,
    }
    ticks = {"dtick": step} if len(rows) <= FEW else {}
    return plot([points], title, _AXES[key], xaxis=ticks)


_AXES: Final = {"disc_c": "disc [°C]", "margin_k": "margin [K]"}
