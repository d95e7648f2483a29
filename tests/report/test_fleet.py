"""The page of a fleet: its figures, links, and no rows without end."""

from __future__ import annotations

from datetime import date
from typing import Any

from bstm_daemon.report.fleet import CARS_SHOWN, FleetFacts, fleet_page
from bstm_daemon.report.shell import Cell, Page, render


def car(number: int, **changes: Any) -> dict[str, Any]:
    found = {
        "vehicle": f"car{number}",
        "drives": 2,
        "hours": 1.5,
        "km": 60.0,
        "disc_c": 300.0 - number,
        "margin_k": 20.0 + number,
        "corner": "FL",
        "lining_mm": 9.876,
        "valid": 0.875,
        "after_hole": 1,
    }
    return found | changes


WORST = {
    "vehicle": "car0",
    "name": "d1",
    "date": date(2024, 5, 1),
    "corner": "FL",
    "margin_k": 20.4,
    "disc_c": 300.0,
    "fluid_c": 134.6,
    "validity": 1,
    "minutes": 42.0,
}


def page_of(**changes: Any) -> Page:
    facts: dict[str, Any] = {
        "title": "Fleet",
        "cars": [car(n) for n in range(1000)],
        "dates": [
            {"date": date(2024, 5, 1), "disc_c": 300.0, "margin_k": 20.0}
        ],
        "worst": [WORST],
        "pages": {("car0", "d1"): "pages/car0/d1.html"},
    }
    return fleet_page(FleetFacts(**facts | changes))


def test_it_begins_with_the_drive_nearest_to_boiling() -> None:
    assert page_of().lead == (
        "Nearest to boiling came car0, FL, on 2024-05-01 (d1): 20 K were left "
        "with wet fluid."
    )
    assert page_of(worst=[WORST | {"margin_k": None}]).lead == (
        "No drive has a margin to boiling."
    )


def test_few_points_have_a_tick_each() -> None:
    """Not between them, where no car and no day is."""
    few = {one.heading: one for one in page_of(cars=[car(0)]).sections}
    many = {one.heading: one for one in page_of().sections}

    (_, cars), _ = few["Cars"].plots
    (_, days), _ = few["Days"].plots
    assert cars.layout["xaxis"]["dtick"] == 1
    assert days.layout["xaxis"]["dtick"] == 86_400_000
    assert "dtick" not in many["Cars"].plots[0][1].layout["xaxis"]


def test_a_thousand_cars_are_points_and_the_worst_of_them_rows() -> None:
    page = page_of()

    assert page.tiles[:2] == [
        ("1000", "cars"),
        ("2000", "drives, 1500 h, 60000 km"),
    ]
    assert ("300 °C", "hottest disc") in page.tiles
    assert ("20 K", "least margin to wet boiling, car0") in page.tiles
    sections = {one.heading: one for one in page.sections}
    (_, hottest), (_, margin) = sections["Cars"].plots
    assert len(hottest.data[0]["y"]) == len(margin.data[0]["y"]) == 1000
    assert hottest.data[0]["text"][-1] == "car0"
    assert hottest.data[0]["y"][-1] == 300.0
    assert margin.data[0]["text"][0] == "car0"
    table = sections["Cars with the least margin"].table
    assert table is not None
    assert len(table.rows) == CARS_SHOWN
    assert table.rows[0] == [
        *("car0", Cell("20", "FL"), "300", "2", "2", "60"),
        *("9.88", "87.5 %", "1"),
    ]


def test_the_worst_drives_lead_to_their_pages() -> None:
    html = render(page_of())

    assert '<a href="pages/car0/d1.html">d1</a>' in html
    assert "2024-05-01" in html
    assert "degraded" in html


def test_what_is_missing_comes_first() -> None:
    page = page_of(failures=[f"car1 d{n}: bad" for n in range(50)], waiting=3)

    first, second = page.sections[:2]
    assert first.lines == ["3 drives wait for 'bstm fleet replay'"]
    assert second.lines[0] == "car1 d0: bad"
    assert second.lines[-1] == "and 10 more: bstm fleet status"
    assert page.tiles[-1] == ("50", "drives not replayed")


def test_a_car_without_temperatures_has_dashes() -> None:
    unknown = dict.fromkeys(
        ("disc_c", "margin_k", "corner", "lining_mm", "valid")
    )

    page = page_of(cars=[car(0, **unknown)], worst=[], dates=[])

    html = render(page)
    assert "hottest disc</span>" not in html
    assert "\N{EN DASH}" in html
