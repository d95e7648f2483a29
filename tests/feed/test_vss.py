"""VSS names of the messages, and the overlay that defines them."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import Estimate, Message, RiskLevel, Validity
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.feed.vss import CAR, WHEELS, branches
from bstm_daemon.files import shipped_file

HERE = Path(__file__).parent / "vss"
OVERLAY = shipped_file("config/vss/bstm.vspec")
INSTANCES = {
    "Row1": ("Axle", "Row[1,2]"),
    "Left": ("Wheel", ["Left", "Right"]),
}
"""Name of an instance in the released tree to its branch and all instances."""

RENAMED = {"FluidLevelLow": "IsFluidLevelLow", "BrakesWorn": "IsBrakesWorn"}
"""Names of 2.0 and those since 3.0."""

NOT_IN_VSS = {"time_s"}


@pytest.fixture
def values(
    config: Config, estimate: Callable[[int], Estimate]
) -> dict[str, dict[str, Any]]:
    return branches(json.loads(RecordWriter(config).line(estimate(0))))


def test_a_wheel_has_its_values_time_and_validity(
    values: dict[str, dict[str, Any]],
) -> None:
    assert values[WHEELS["FL"]] == {
        "time_s": 1_700_000_000.0,
        "Validity": "VALID",
        "Reasons": [],
        "DiscTemperature": 300.0,
        "PadTemperature": 250.0,
        "FluidTemperature": 100.0,
        "BoilingMargin": 55.0,
        "VapourProbability": 2.0,
        "RiskLevel": "ELEVATED",
        "PadWear": 61,
        "IsBrakesWorn": False,
        "WearValidity": "DEGRADED",
    }
    assert WHEELS["FL"] == "Vehicle.Chassis.Axle.Row1.Wheel.Left.Brake"
    assert WHEELS["RR"] == "Vehicle.Chassis.Axle.Row2.Wheel.Right.Brake"


def test_the_car_has_the_worst_of_its_wheels(
    values: dict[str, dict[str, Any]],
) -> None:
    """RR is known to nobody: nothing is said of the car."""
    assert values[CAR] == {
        "time_s": 1_700_000_000.0,
        "Validity": "NOT_AVAILABLE",
        "RiskLevel": "UNKNOWN",
        "VapourProbability": None,
        "DriverMessage": "BRAKES_HOT",
    }


@pytest.mark.parametrize("corner", ["RL", "RR"])
def test_what_is_invalid_has_no_value(
    values: dict[str, dict[str, Any]], corner: str
) -> None:
    found = values[WHEELS[corner]]
    for leaf in ("DiscTemperature", "FluidTemperature", "BoilingMargin"):
        assert found[leaf] is None
    assert found["VapourProbability"] is None
    assert found["RiskLevel"] == "UNKNOWN"
    worn = {"RL": False, "RR": None}[corner]
    assert found["IsBrakesWorn"] is worn


def flattened(node: dict[str, Any], path: str, out: dict[str, Any]) -> None:
    """Undo the expansion of instances: their first one is the branch."""
    children = node.get("children", {})
    for first, (_, instances) in INSTANCES.items():
        if first in children:
            node = {**node, "instances": instances}
            children = children[first]["children"]
    dropped = ("children", "uuid")
    out[path] = {key: one for key, one in node.items() if key not in dropped}
    for old, child in children.items():
        name = RENAMED.get(old, old)
        flattened(child, f"{path}.{name}", out)


@pytest.mark.slow
def test_the_overlay_fits_the_released_specification(
    values: dict[str, dict[str, Any]], tmp_path: Path
) -> None:
    if importlib.util.find_spec("vss_tools") is None:
        pytest.skip("vss-tools is not installed: nothing checks the overlay")
    released = json.loads((HERE / "vss_release_2.0_brakes.json").read_text())
    nodes: dict[str, Any] = {}
    flattened(released["Vehicle"], "Vehicle", nodes)
    base = tmp_path / "released.vspec"
    base.write_text(json.dumps(nodes))  # JSON is YAML

    done = subprocess.run(
        [
            *(sys.executable, "-c", "from vss_tools.cli import cli; cli()"),
            *("export", "json", "--strict", "--vspec", base),
            *("--overlays", OVERLAY, "--output", tmp_path / "out.json"),
            *("--units", HERE / "units.yaml"),
            *("--quantities", HERE / "quantities.yaml"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stdout + done.stderr
    tree = json.loads((tmp_path / "out.json").read_text())
    for branch, leaves in values.items():
        node = tree["Vehicle"]
        for name in branch.split(".")[1:]:
            node = node["children"][name]
        assert leaves.keys() - NOT_IN_VSS <= node["children"].keys(), branch
        for leaf in leaves.keys() - NOT_IN_VSS:
            suits(leaves[leaf], node["children"][leaf])
    wheel = node_of(tree, WHEELS["FL"])
    assert wheel["RiskLevel"]["allowed"] == [one.name for one in RiskLevel]
    assert wheel["Validity"]["allowed"] == [one.name for one in Validity]
    messages = node_of(tree, CAR)["DriverMessage"]["allowed"]
    assert messages == [one.name for one in Message]
    # the standard's own: type and unit as they were released
    released_wheel = node_of(released, WHEELS["FL"])
    for old, new in (("PadWear", "PadWear"), ("BrakesWorn", "IsBrakesWorn")):
        for key in ("datatype", "type", "description"):
            assert wheel[new][key] == released_wheel[old][key]


def node_of(tree: dict[str, Any], path: str) -> dict[str, Any]:
    node = tree["Vehicle"]
    for name in path.split(".")[1:]:
        node = node["children"][name]
    return dict(node["children"])


def suits(value: Any, definition: dict[str, Any]) -> None:
    """Require that *value* is one that *definition* allows, or unknown."""
    if value is None:
        return
    kinds = {"uint8": int, "float": float, "boolean": bool, "string": str}
    kind = kinds.get(definition["datatype"], list)
    assert type(value) is kind, definition
    if "allowed" in definition:
        assert value in definition["allowed"]
    if "max" in definition:
        assert definition.get("min", 0) <= value <= definition["max"]
