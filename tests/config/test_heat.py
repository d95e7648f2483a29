"""The heat mode that the configured roles give."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from bstm_daemon.config.heat import (
    HeatConfig,
    automatic_mode,
    heat_mode_problems,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import CornerConfig

SPEED, PRESSURE = "wheel_speed_rl", "primary_pressure"
MOTION = {"acceleration_longitudinal", "powertrain_torque"}


@pytest.mark.parametrize(
    ("mode", "roles"),
    [
        ("fused", {SPEED, PRESSURE, *MOTION}),
        ("fused", {SPEED, "wheel_pressure_fl", *MOTION}),
        ("ff", {SPEED, PRESSURE}),
        ("ff", {SPEED, PRESSURE, "powertrain_torque"}),
        ("ff", {SPEED, PRESSURE, "acceleration_longitudinal"}),
        ("fb", {SPEED, *MOTION}),
        ("fb", {SPEED, "powertrain_torque", "secondary_pressure"}),
    ],
)
def test_automatic_is_the_first_mode_with_its_inputs(
    make_corner: Callable[..., CornerConfig], mode: str, roles: set[str]
) -> None:
    """A corner of the primary circuit has no use for the secondary one's."""
    corners = [make_corner()]

    assert automatic_mode(HeatConfig(), corners, roles) == mode


@pytest.mark.parametrize(
    ("mode", "roles"), [("fb", {SPEED}), ("fused", {SPEED, PRESSURE})]
)
def test_a_declared_torque_counts(
    make_corner: Callable[..., CornerConfig], mode: str, roles: set[str]
) -> None:
    """Coasting while braking may be declared."""
    heat = HeatConfig(assume_powertrain_torque_nm=0.0)
    roles = roles | {"acceleration_longitudinal"}

    assert automatic_mode(heat, [make_corner()], roles) == mode


def test_a_drum_needs_no_pressure(
    make_corner: Callable[..., CornerConfig],
) -> None:
    """It has no thermal model."""
    corners = [
        make_corner(),
        make_corner(name="RR", type="drum", disc=None, pad=None),
    ]
    roles = {SPEED, "wheel_pressure_fl"}

    assert automatic_mode(HeatConfig(), corners, roles) == "ff"


def test_without_any_mode_all_ways_out_are_named(
    make_corner: Callable[..., CornerConfig],
) -> None:
    """A pressure would do, or a torque."""
    corners = [make_corner()]

    pressure, torque = heat_mode_problems(HeatConfig(), corners, {SPEED})

    assert pressure.startswith('[heat] mode = "auto": needs a pressure')
    assert torque.startswith('[heat] mode = "auto": or needs the torque')
    with pytest.raises(ValueError, match="needs a pressure"):
        automatic_mode(HeatConfig(), corners, {SPEED})
