"""The configuration models: rules of one section, and their documentation."""

import json
import math
import re
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from bstm_daemon.bus.output.layout import BLOCK_IDS
from bstm_daemon.config import sections as config
from bstm_daemon.config import service as config_service
from bstm_daemon.config.estimates import FluidConfig, MatchedConfig
from bstm_daemon.config.schema import config_schema
from bstm_daemon.config.thermal import CoolingConfig, ThermalConfig
from bstm_daemon.simulation.drives import DriveHead, Segment

from .reference_tables import (
    REFERENCE,
    SCHEMA,
    SECTIONS,
    schema_text,
    with_tables,
)

DISC = {"mass_kg": 7.5, "swept_area_m2": 0.085, "total_area_m2": 0.14}
PAD = {"area_m2": 6.5e-3, "thickness_m": 0.011}
VEHICLE = {"id": "car", "mass_kg": 2000.0, "wheel_radius_m": 0.3}
CORNER = {
    "name": "FL",
    "piston_area_m2": 2.8e-3,
    "effective_radius_m": 0.13,
    "disc": DISC,
    "pad": PAD,
}


def corner(**changes: Any) -> dict[str, Any]:
    """Return a valid corner with *changes*; None removes a key."""
    table = {**CORNER, **changes}
    return {key: value for key, value in table.items() if value is not None}


def documented(heading: str) -> dict[str, str]:
    """Return key to what it may be, of one table of the reference."""
    text = REFERENCE.read_text(encoding="utf-8")
    body = text.partition(f"### {heading}\n")[2].partition("\n## ")[0]
    rows = re.findall(
        r"^\| `(\w+)` \| ([^|]+) \| [^|]+ \|$",
        body.partition("\n### ")[0],
        re.MULTILINE,
    )
    return dict(rows)


def default_of(value: str) -> object:
    """Return the default in *value*, the last that stands as code."""
    if value.endswith(", required"):
        return "required"
    found = re.findall(r"`([^`]+)`", value)
    return json.loads(found[-1]) if found else None


def test_reference_has_every_section() -> None:
    """Each section of Config is among those compared below."""
    models = set(SECTIONS.values())
    annotations = str(
        {
            name: field.annotation
            for name, field in config.Config.model_fields.items()
        }
    )

    assert all(
        model.__name__ in annotations
        for model in models - {config.DiscConfig, config.PadConfig}
    )
    assert len(SECTIONS) == len(config.Config.model_fields) + 2


def test_the_reference_has_the_keys_of_the_models() -> None:
    """Keys, allowed values, defaults and meanings; the command is there."""
    text = REFERENCE.read_text(encoding="utf-8")

    assert with_tables(text) == text


def test_the_shipped_schema_is_that_of_the_models() -> None:
    assert SCHEMA.read_text(encoding="utf-8") == schema_text()


def test_the_schema_describes_and_bounds_a_key() -> None:
    """What an editor shows, and refuses as the daemon would."""
    schema = config_schema()
    part = schema["$defs"]["VehicleConfig"]["properties"]["ambient_c"]

    assert (part["minimum"], part["maximum"]) == (-60, 70)
    assert part["description"].startswith("air temperature until the role")
    roles = schema["properties"]["signals"]["propertyNames"]["enum"]
    assert "primary_pressure" in roles
    described = json.dumps(schema).count('"description"')
    keys = sum(len(model.model_fields) for model in SECTIONS.values())
    assert described >= keys


@pytest.mark.parametrize(
    ("heading", "model"),
    [("`[drive]`", DriveHead), ("`[[segment]]`", Segment)],
)
def test_reference_lists_every_key_of_a_drive(
    heading: str, model: type[BaseModel]
) -> None:
    """Keys and defaults of a drive in the reference are the model's."""
    expected = {
        key: "required" if field.is_required() else field.get_default()
        for key, field in model.model_fields.items()
    }
    found = {
        key: default_of(value) for key, value in documented(heading).items()
    }
    empty = ("", [], {})
    expected = {
        key: None if default in empty else default
        for key, default in expected.items()
    }

    assert expected == found


def test_published_ids_are_those_of_the_frames() -> None:
    """The room that id_base keeps free is what the frame table needs."""
    assert config_service.PUBLISHED_IDS == BLOCK_IDS


def test_values_are_final() -> None:
    """A configuration cannot change behind the back of its users."""
    heat = config.HeatConfig()

    with pytest.raises(ValidationError):
        setattr(heat, "mode", "fb")  # noqa: B010  (mypy would see it)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "7", True])
@pytest.mark.parametrize(
    ("model", "key"),
    [
        (config.SignalConfig, "scale"),
        (config.SignalConfig, "max"),
        (config.HeatConfig, "assume_powertrain_torque_nm"),
        (ThermalConfig, "hot_pad_factor"),
        (FluidConfig, "water_percent"),
    ],
)
def test_not_a_number_is_refused(
    model: type[config.Section], key: str, value: object
) -> None:
    """NaN, infinity, text and booleans are no numbers."""
    needed = {"message": "M", "signal": "S", "unit": "bar"}
    table = needed if model is config.SignalConfig else {}

    with pytest.raises(ValidationError):
        model.model_validate({**table, key: value})


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"disc": None}, "needs 'disc' and 'pad'"),
        ({"type": "drum"}, "a drum corner has neither"),
        ({"type": "drum", "pad": None}, "a drum corner has neither"),
        ({"effective_radius_m": None}, "needs 'effective_radius_m'"),
        (
            {"swept_inner_radius_m": 0.16, "swept_outer_radius_m": 0.10},
            "must be below 'swept_outer_radius_m'",
        ),
        ({"axle": "rear"}, "corner FL is front left"),
        ({"side": "right"}, "corner FL is front left"),
        ({"disc": {**DISC, "material": "own"}}, 'material "own"'),
        ({"disc": {**DISC, "total_area_m2": 0.08}}, "'total_area_m2' = 0.08"),
        ({"pad": {**PAD, "area_m2": 0.0426}}, "'pad.area_m2' = 0.0852"),
    ],
)
def test_corner_rules(changes: dict[str, Any], reason: str) -> None:
    """Parts of a corner that contradict each other are refused."""
    with pytest.raises(ValidationError, match=re.escape(reason)):
        config.CornerConfig.model_validate(corner(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"type": "drum", "disc": None, "pad": None},
        {
            "effective_radius_m": None,
            "swept_inner_radius_m": 0.10,
            "swept_outer_radius_m": 0.16,
        },
        {"axle": "front", "side": "left"},
        {"disc": {**DISC, "total_area_m2": 0.085}},
        {"pad": {**PAD, "area_m2": 0.0425}},
    ],
)
def test_corner_forms(changes: dict[str, Any]) -> None:
    """Each way to describe a corner is accepted."""
    assert config.CornerConfig.model_validate(corner(**changes)).name == "FL"


@pytest.mark.parametrize(
    ("model", "table", "key", "bound"),
    [
        (config.CornerConfig, CORNER, "effective_radius_m", 0.5),
        (config.CornerConfig, CORNER, "swept_inner_radius_m", 0.5),
        (config.CornerConfig, CORNER, "swept_outer_radius_m", 0.5),
        (config.CornerConfig, CORNER, "piston_area_m2", 0.02),
        (config.DiscConfig, DISC, "mass_kg", 100.0),
        (config.DiscConfig, DISC, "total_area_m2", 1.0),
        (config.PadConfig, PAD, "area_m2", 0.05),
        (config.PadConfig, PAD, "thickness_m", 0.05),
        (config.VehicleConfig, VEHICLE, "mass_kg", 60_000.0),
        (config.VehicleConfig, VEHICLE, "wheel_radius_m", 1.0),
    ],
)
def test_units_of_a_drawing_are_refused(
    model: type[config.Section], table: dict[str, Any], key: str, bound: float
) -> None:
    """The largest value is taken, one in mm, cm2, mm2 or g is not."""
    assert getattr(model.model_validate({**table, key: bound}), key) == bound
    for wrong in (math.nextafter(bound, math.inf), 1000.0 * bound):
        with pytest.raises(ValidationError, match="less than or equal"):
            model.model_validate({**table, key: wrong})


def test_property_is_a_number_or_a_curve() -> None:
    """A pad's heat capacity may depend on temperature."""
    curve = {"temperature_c": [20.0, 400.0], "value": [1000.0, 1342.0]}
    pad = config.PadConfig.model_validate(
        {**PAD, "heat_capacity_j_kgk": curve}
    )

    assert isinstance(pad.heat_capacity_j_kgk, config.Curve)
    assert pad.conductivity_w_mk == 1.2


@pytest.mark.parametrize(
    ("model", "table"),
    [
        (CoolingConfig, {"speed_ms": [0.0, 5.0], "s_per_s": [1e-3]}),
        (
            CoolingConfig,
            {"speed_ms": [5.0, 5.0], "s_per_s": [1e-3, 1e-3]},
        ),
        (config.HeatConfig, {"front_pressure_pa": [0.0, 1e6]}),
        (config.Curve, {"temperature_c": [400.0, 20.0], "value": [1.0, 2.0]}),
    ],
)
def test_curves_need_rising_points_and_one_value_each(
    model: type[config.Section], table: dict[str, Any]
) -> None:
    """A table that cannot be looked up is refused."""
    with pytest.raises(ValidationError):
        model.model_validate(table)


@pytest.mark.parametrize(
    "changes",
    [
        {"expression": "S * 2"},
        {"signal": None},
        {"message": None},
        {"scale": 0.0},
        {"min": 5.0, "max": 5.0},
        {"sign": 2},
    ],
)
def test_signal_rules(changes: dict[str, Any]) -> None:
    """A signal with no, two or an impossible source is refused."""
    table = {"message": "M", "signal": "S", "unit": "bar", **changes}

    with pytest.raises(ValidationError):
        config.SignalConfig.model_validate(table)


@pytest.mark.parametrize("key", ["message", "signal", "expression", "bus"])
def test_a_column_stands_alone(key: str) -> None:
    """A role of a table names no frame."""
    table = {"column": "speed", "unit": "km/h"}

    assert config.SignalConfig.model_validate(table).column == "speed"
    with pytest.raises(ValidationError, match="with 'column'"):
        config.SignalConfig.model_validate({**table, key: "x"})


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({}, "needs either 'time'"),
        ({"time": "t", "rate_hz": 50}, "needs either 'time'"),
        ({"rate_hz": 50, "time_unit": "s"}, "'time_unit' needs 'time'"),
        ({"time": "t", "name": "n"}, "'name' and 'value' are used together"),
        ({"rate_hz": 5, "name": "n", "value": "v"}, "need a column 'time'"),
        ({"time": "t", "delimiter": ", "}, "must be one character"),
    ],
)
def test_table_rules(table: dict[str, Any], reason: str) -> None:
    """Keys of a table that contradict each other are refused."""
    with pytest.raises(ValidationError, match=reason):
        config.TableConfig.model_validate(table)


def test_corner_overrides_single_keys() -> None:
    """A corner's override changes its key and leaves the others."""
    front = config.CornerConfig.model_validate(
        corner(
            thermal={"disc_emissivity": 0.7},
            cooling={"standstill_convection_fraction": 0.3},
        )
    )
    whole = config.Config.model_validate(
        {
            "vehicle": {"id": "car", "mass_kg": 2000, "wheel_radius_m": 0.3},
            "bus": [{"name": "b", "dbc": "b.dbc"}],
            "signals": {},
            "corner": [
                front,
                corner(name="RR", type="drum", disc=None, pad=None),
            ],
            "thermal": {"pad_emissivity": 0.9},
            "heat": {"mode": "ff"},
        }
    )

    thermal = whole.thermal_of(front)

    assert (thermal.disc_emissivity, thermal.pad_emissivity) == (0.7, 0.9)
    assert whole.cooling_of(front).standstill_convection_fraction == 0.3
    assert whole.disc_corners() == [front]


@pytest.mark.parametrize(
    ("key", "whole_loss", "own"),
    [
        ("fluid_static_convection_w_k", 1.5, 0.6),
        ("disc_view_factor", 1.0, 0.6),
    ],
)
def test_with_other_paths_a_surface_has_its_own_loss_alone(
    key: str, whole_loss: float, own: float
) -> None:
    """Of a corner as of the car; a value that is given stays."""
    assert getattr(ThermalConfig(), key) == whole_loss
    apart = ThermalConfig(structure="extended")
    assert getattr(apart, key) == own
    given = ThermalConfig(structure="extended", **{key: 0.9})
    assert getattr(given, key) == 0.9
    plain = config.Config.model_validate(
        {
            "vehicle": VEHICLE,
            "bus": [{"name": "b", "dbc": "b.dbc"}],
            "signals": {},
            "corner": [corner(thermal={"structure": "extended"})],
            "heat": {"mode": "ff"},
        }
    )
    assert getattr(plain.thermal, key) == whole_loss
    assert getattr(plain.thermal_of(plain.corner[0]), key) == own


def test_a_piston_is_given_by_its_area_or_its_diameter() -> None:
    """57 mm are 25.5 cm2; a configuration that was written out reads back."""
    given = {k: v for k, v in CORNER.items() if k != "piston_area_m2"}

    corner = config.CornerConfig.model_validate(
        given | {"piston_diameter_mm": 57.0}
    )

    assert corner.piston_area_m2 == pytest.approx(2.5518e-3, rel=1e-4)
    assert config.CornerConfig.model_validate(corner.model_dump()) == corner
    with pytest.raises(ValidationError, match="not both"):
        config.CornerConfig.model_validate(
            CORNER | {"piston_diameter_mm": 57.0}
        )
    with pytest.raises(ValidationError, match="piston_diameter_mm"):
        config.CornerConfig.model_validate(given | {"piston_diameter_mm": -57})
    with pytest.raises(ValidationError, match="piston_area_m2"):
        config.CornerConfig.model_validate(given)


def test_what_forces_showed_has_its_deviations() -> None:
    one = {
        "corners": ["FL"],
        "names": ["thermal.disc_emissivity"],
        "values": [0.5],
        "factor": [[0.1]],
        "forces": {"mass_error": 0.2},
    }

    with pytest.raises(ValidationError, match="'forces' and 'forces_sd'"):
        MatchedConfig.model_validate(one)
    deviations = {"forces_sd": {"mass_error": 0.1}}
    assert MatchedConfig.model_validate(one | deviations).forces_sd
