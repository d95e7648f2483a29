"""The dashboard: of metrics that exist, in Grafana's own schema."""

from __future__ import annotations

import json
import re
from itertools import combinations
from pathlib import Path
from typing import Any

from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import Dashboard

ROOT = Path(__file__).parents[2]
DASHBOARD = json.loads(
    (ROOT / "config" / "grafana_dashboard.json").read_text(encoding="utf-8")
)
GIVEN_BY_PROMETHEUS = {"instance"}


def documented() -> dict[str, set[str]]:
    """Return the labels of each metric, as another test holds its list."""
    rows = re.findall(
        r"^- `(bstm_\w+)(?:\{(.+?)\})?`:",
        (ROOT / "docs" / "observing.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    return {name: set(re.findall(r"\w+", labels)) for name, labels in rows}


def targets() -> list[dict[str, Any]]:
    return [one for panel in DASHBOARD["panels"] for one in panel["targets"]]


def test_every_query_is_of_a_metric_and_of_labels_that_exist() -> None:
    known = documented()

    for target in targets():
        query = target["expr"]
        names = re.findall(r"\bbstm_\w+", query)
        assert names, query
        assert set(names) <= set(known), query
        labels = set().union(*(known[name] for name in names))
        used = re.findall(r"(\w+)!?=~?\"", query)
        used += re.findall(r"by \((\w+)\)", query)
        used += re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])
        assert set(used) <= labels | GIVEN_BY_PROMETHEUS, query
        counted = set(re.findall(r"rate\((bstm_\w+)", query))
        assert {n for n in names if n.endswith("_total")} == counted


def test_what_a_reader_looks_for_first_is_there() -> None:
    shown = {n for t in targets() for n in re.findall(r"bstm_\w+", t["expr"])}

    assert {
        *(
            "bstm_state",
            "bstm_risk",
            "bstm_validity",
            "bstm_fluid_peak_celsius",
        ),
        *("bstm_boiling_margin_celsius", "bstm_temperature_celsius"),
        *("bstm_vapour_probability", "bstm_input_fault"),
    } <= shown


def test_grafana_reads_every_field_of_it() -> None:
    """Its published model of a dashboard drops what it does not know."""
    model = Dashboard.from_json(DASHBOARD)
    read = json.loads(JSONEncoder().encode(model))

    def lost(ours: Any, theirs: Any, place: str = "") -> list[str]:
        if isinstance(ours, dict):
            return [
                found
                for key, value in ours.items()
                for found in (
                    lost(value, theirs[key], f"{place}.{key}")
                    if isinstance(theirs, dict) and key in theirs
                    else [f"{place}.{key}"]
                )
            ]
        if isinstance(ours, list):
            assert len(ours) == len(theirs), place
            return [
                found
                for i, pair in enumerate(zip(ours, theirs, strict=True))
                for found in lost(*pair, f"{place}[{i}]")
            ]
        return [] if ours == theirs else [place]

    assert lost(DASHBOARD, read) == []


def test_panels_do_not_overlap() -> None:
    places = [panel["gridPos"] for panel in DASHBOARD["panels"]]

    for one, other in combinations(places, 2):
        beside = (
            one["x"] + one["w"] <= other["x"]
            or other["x"] + other["w"] <= one["x"]
        )
        below = (
            one["y"] + one["h"] <= other["y"]
            or other["y"] + other["h"] <= one["y"]
        )
        assert beside or below
    assert all(p["x"] >= 0 and p["x"] + p["w"] <= 24 for p in places)
    identities = [panel["id"] for panel in DASHBOARD["panels"]]
    assert len(set(identities)) == len(identities)
