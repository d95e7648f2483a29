"""The network of a corner as a graph, as text and as a picture."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.effects.catalogue import effect_class, effect_names
from bstm_daemon.model.thermal.network import Link, Network, Node, Source
from bstm_daemon.report.network import (
    Graph,
    graph_text,
    network_graph,
    picture,
)

EXAMPLE = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
SVG = "{http://www.w3.org/2000/svg}"
CHARACTER_PX = 6.7
TEMPERATURE_K, AIR_K = 573.15, 283.15


def graph_of(structure: str = "thesis", *effects: str) -> Graph:
    config = load_config(EXAMPLE)
    thermal = config.thermal.model_copy(update={"structure": structure})
    more = [
        EffectConfig(name=one, parameters={"strength": 1.0}) for one in effects
    ]
    config = config.model_copy(update={"thermal": thermal, "effect": more})
    network = compile_corner(config, config.corner[0]).network
    return network_graph(network, "car, corner FL", AIR_K)


def texts_of(svg: str) -> list[tuple[str, float, float, float]]:
    """Return each text with its left end, right end and base line."""
    found = []
    for one in ET.fromstring(svg).iter(f"{SVG}text"):  # noqa: S314
        text, x = one.text or "", float(one.attrib["x"])
        width = CHARACTER_PX * len(text)
        style = one.attrib["class"].split()
        share = 1.0 if "end" in style else 0.5 if "middle" in style else 0.0
        left = x - share * width
        found.append((text, left, left + width, float(one.attrib["y"])))
    return found


def test_values_are_those_of_the_equations() -> None:
    graph = graph_of()
    nodes = {one.name: one for one in graph.nodes}
    edges = {one.name: one for one in (*graph.links, *graph.sources)}

    # 8.01 kg of grey iron without the peak, 560 J/kgK at 300 degC
    assert nodes["disc"].capacity_j_k == pytest.approx(8.01 * 560.0)
    assert nodes["ambient"].boundary_input == "ambient_k"
    assert edges["fluid_static"].law == "constant"
    assert edges["fluid_static"].driving == 0.944
    dynamic = edges["fluid_dynamic"]
    assert (dynamic.law, dynamic.standing) == ("convection", 0.0)
    assert dynamic.driving == pytest.approx(0.052 * 100.0 / 3.6)
    # two lumps of one temperature exchange 4 sigma eps A T^3
    inside = edges["disc_pad_radiation"]
    assert inside.law == "radiation"
    assert inside.standing == pytest.approx(
        4.0 * inside.constant * TEMPERATURE_K**3
    )
    outside = edges["disc_radiation"]
    assert outside.standing == pytest.approx(
        outside.constant
        * (TEMPERATURE_K**2 + AIR_K**2)
        * (TEMPERATURE_K + AIR_K)
    )
    assert outside.driving == 0.0
    shares = [one.driving for one in graph.sources if one.a == "brake_power_w"]
    assert sum(shares) == pytest.approx(1.0)


def test_text_has_every_part() -> None:
    graph = graph_of("extended")
    text = graph_text(graph)

    for one in (*graph.nodes, *graph.links, *graph.sources):
        assert re.search(
            rf"^{re.escape(one.name)} .*{one.value}$", text, re.MULTILINE
        )
    assert "nodes 300 °C, air 10 °C, standing … 100 km/h" in text


@pytest.mark.parametrize("effects", [(), "all"], ids=["plain", "all effects"])
@pytest.mark.parametrize("structure", ["thesis", "extended"])
def test_texts_of_a_picture_do_not_overlap(
    structure: str, effects: Any
) -> None:
    if effects:
        effects = [
            name
            for name in effect_names()
            if effect_class(name).kind == "thermal"
        ]
    graph = graph_of(structure, *effects)
    svg = picture(graph)
    texts = texts_of(svg)

    width = float(re.findall(r'viewBox="0 0 (\d+)', svg)[0])
    assert width < 560.0
    drawn = {text for text, *_ in texts}
    for one in (*graph.links, *graph.sources):
        if one.driving and one.name != f"{one.a}-{one.b}":
            assert drawn & {one.name, f"{one.name} {one.value}"}, one.name
    for one, left, right, _ in texts:
        assert left >= 0.0, one
        assert right <= width, one
    for one, other in combinations(texts, 2):
        apart = one[2] <= other[1] or other[2] <= one[1]
        assert apart or abs(one[3] - other[3]) >= 12.0, (one, other)


def test_slabs_are_one_box_and_the_disc_is_above_the_fluid() -> None:
    y = {text: base for text, _, _, base in texts_of(picture(graph_of()))}

    assert "pad_1 … pad_10" in y
    order = ["disc", "pad_front", "pad_1 … pad_10", "pad_back", "backplate"]
    assert [*order, "fluid"] == sorted([*order, "fluid"], key=y.__getitem__)
    # no heat goes there at 300 degC
    assert "dissolved" not in y


def test_a_network_of_ones_own_is_drawn_and_its_names_are_text() -> None:
    network = Network(
        ("brake_power_w", "ambient_k"),
        (
            Node("<script>", 100.0),
            Node("air", 0.0, boundary_input="ambient_k"),
            Node("box", 0.0, boundary_input="ambient_k"),
        ),
        (Link("loss", "<script>", "air", 2.0), Link("x", "air", "box", 1.0)),
        (Source("heat", "<script>", 1.0), Source("waste", "box", 0.5)),
    )
    svg = picture(network_graph(network, "a & b", AIR_K))

    texts = [text for text, *_ in texts_of(svg)]
    assert {"<script>", "a & b", "heat", "waste", "loss"} <= set(texts)
    assert "<script>" not in svg


def test_a_single_lump_without_links_is_drawn() -> None:
    one = Network(("ambient_k",), (Node("disc", 1.0),), (), ())
    heated = replace(one, sources=(Source("heat", "disc", 3.0),))

    svg = picture(network_graph(heated, "disc", AIR_K))

    assert "3 \u00d7 1 W" in [text for text, *_ in texts_of(svg)]


def test_the_command_prints_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    show = ["model", "show", "-c", str(EXAMPLE), "--corner", "RL"]
    assert main(show) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("example-vehicle, corner RL\n")

    for name in ("net.json", "net.svg"):
        assert main([*show, "-o", str(tmp_path / name)]) == 0
    found = json.loads((tmp_path / "net.json").read_text("utf-8"))
    assert [*found] == [
        *("title", "ambient_k", "nodes", "links", "sources", "memories"),
        *("temperature_k", "speed_ms", "layout"),
    ]
    assert found["layout"] == 1
    assert [*found["nodes"][0]] == [
        *("name", "capacity_j_k", "capacity_table", "boundary_input"),
    ]
    assert [*found["links"][0]] == [
        *("name", "a", "b", "law", "standing", "driving", "constant"),
        "factors",
    ]
    assert [*found["sources"][0]] == [*found["links"][0]]
    speed = found["links"][0]["factors"][0]
    assert (speed["a"], speed["table"]["x0"]) == ("speed_ms", 0.0)
    assert texts_of((tmp_path / "net.svg").read_text("utf-8"))


def moved_example() -> str:
    """Return the example's text, right in any folder."""
    dbc = str(EXAMPLE.parents[1] / "dbc")
    return EXAMPLE.read_text("utf-8").replace("../dbc", dbc)


def test_a_picture_is_xml_whatever_the_name_of_the_car(tmp_path: Path) -> None:
    text = moved_example().replace('"example-vehicle"', '"\\u001b<&>"')
    (tmp_path / "car.toml").write_text(text, "utf-8")
    out = tmp_path / "net.svg"

    car = str(tmp_path / "car.toml")
    assert main(["model", "show", "-c", car, "-o", str(out)]) == 0
    title = texts_of(out.read_text("utf-8"))[0][0]
    assert title == "\\x1b<&>, corner FL"


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["-o", "net.png"], "net.png: must end in .svg or .json"),
        (["--corner", "RL"], "--corner RL: no disc brake; there are FL, FR"),
    ],
)
def test_what_can_not_be_shown_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    more: list[str],
    reason: str,
) -> None:
    parts = re.split(
        r"(?=^\[\[corner\]\])", moved_example(), flags=re.MULTILINE
    )
    (tmp_path / "car.toml").write_text("".join(parts[:3]), "utf-8")
    monkeypatch.chdir(tmp_path)

    assert main(["model", "show", "-c", "car.toml", *more]) == 2
    assert reason in capsys.readouterr().err
