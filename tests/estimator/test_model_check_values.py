"""Model check with values: averages, thresholds and what is left out."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from math import exp, hypot, isnan, nan
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.model_check import Couple, ModelCheck
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from bstm_daemon.config.sections import Config, CornerConfig

Makes = Callable[..., Any]
CORNERS = ("FL", "FR")
STEP_US = 500_000
WINDOW = 10
"""Steps of a trial of 5 s."""


def check_of(config: Config, roles: Collection[int] = ()) -> ModelCheck:
    return ModelCheck(config, Estimator(config, {}).layout, roles, 3600.0)


def block_of(
    time_us: int,
    channels: Mapping[str, float],
    flags: int = 0,
    scale: float = 1.0,
    **fields: Any,
) -> Any:
    """Return one publication; *channels* are of each corner."""
    row = array("d", bytes(8 * len(CHANNELS)))
    for name, value in channels.items():
        row[CHANNELS.index(name)] = value
    vehicle = array("d", bytes(8 * len(VEHICLE_CHANNELS)))
    vehicle[VEHICLE_CHANNELS.index("friction_scale")] = scale
    return SimpleNamespace(
        layout=SimpleNamespace(corners=CORNERS),
        times_us=[time_us],
        rows=row * len(CORNERS),
        vehicle=vehicle,
        flags=[flags],
        disagrees=array("b"),
        **fields,
    )


class Drive:
    """A car that brakes with two corners alike."""

    def __init__(self, config: Config) -> None:
        self.check = check_of(config)
        self._time_us = 0
        self._pressed_j = self._moved_j = 0.0
        self._fused = config.heat.mode == "fused"
        self.go(1, 0.0, 0.0)

    def go(
        self,
        steps: int,
        pressed_w: float,
        moved_w: float,
        flags: int = 0,
        step_us: int = STEP_US,
        scale: float = 1.0,
    ) -> Drive:
        """Brake with these powers of the whole car."""
        for _ in range(steps):
            self._time_us += step_us
            self._pressed_j += pressed_w * step_us * 1e-6
            self._moved_j += moved_w * step_us * 1e-6
            channels = {
                "brake_energy_ff_j": self._pressed_j / 2.0,
                "brake_energy_fb_j": self._moved_j / 2.0,
            }
            if self._fused:
                channels["brake_power_w"] = moved_w / 2.0
                del channels["brake_energy_fb_j"]
            self.check.findings(
                block_of(self._time_us, channels, flags, scale)
            )
        return self


@pytest.fixture
def car(make_car: Makes, make_corner: Makes) -> Callable[..., Config]:
    def make(mode: str = "ff", **sections: Any) -> Config:
        corners: list[CornerConfig] = [make_corner(name) for name in CORNERS]
        config: Config = make_car(*corners, heat={"mode": mode}, **sections)
        return config

    return make


def test_forces_are_compared_from_300_kj_on(
    car: Callable[..., Config],
) -> None:
    """10 kW by pressure, 8 by motion; work counts once it was on trial."""
    drive = Drive(car())
    # 50 kJ a trial: the sixth is counted as the seventh has ended
    drive.go(7 * WINDOW - 1, 10e3, 8e3)
    assert isnan(drive.check.force_difference)
    drive.go(1, 10e3, 8e3)
    assert drive.check.force_difference == pytest.approx(0.2)
    assert drive.check.disagreements == ()


def test_the_larger_of_the_works_is_what_is_compared_with(
    car: Callable[..., Config],
) -> None:
    drive = Drive(car()).go(20 * WINDOW, 8e3, 10e3)

    assert drive.check.force_difference == pytest.approx(-0.2)


def test_work_of_a_megajoule_ago_counts_less(
    car: Callable[..., Config],
) -> None:
    """1 MJ with 0.2 of difference, then 0.5 MJ with -0.4 in half the time."""
    drive = Drive(car()).go(20 * WINDOW, 10e3, 8e3).go(5 * WINDOW, 12e3, 20e3)
    drive.go(WINDOW, 0.0, 0.0)  # ends the last trial

    old, new = exp(-0.5) * (1.0 - exp(-1.0)), 1.0 - exp(-0.5)
    assert drive.check.force_difference == pytest.approx(
        (0.2 * old - 0.4 * new) / (old + new)
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_forces_disagree_above_30_percent_and_until_20(
    car: Callable[..., Config], sign: int
) -> None:
    def after(drive: Drive, difference: float) -> tuple[str, ...]:
        less = 1e4 * (1.0 - difference)
        powers = (1e4, less) if sign > 0 else (less, 1e4)
        drive.go(400 * WINDOW, *powers)
        assert drive.check.force_difference == pytest.approx(
            sign * difference, rel=1e-6
        )
        return drive.check.disagreements

    drive = Drive(car())
    assert after(drive, 0.299) == ()
    assert after(drive, 0.301) == ("heat",)
    assert after(drive, 0.201) == ("heat",)
    assert after(drive, 0.199) == ()


@pytest.mark.parametrize(
    "name",
    [
        *("speed_missing", "pressure_missing", "acceleration_missing"),
        *("torque_missing", "speed_suspect", "pressure_suspect"),
        *("acceleration_suspect", "torque_suspect", "clock_jump"),
        *("settled", "silent"),
    ],
)
def test_work_on_trial_is_lost_with_a_suspect_input(
    car: Callable[..., Config], name: str
) -> None:
    """That of this trial and of the one before, not what was counted."""
    drive = Drive(car()).go(7 * WINDOW, 10e3, 8e3)
    drive.go(2 * WINDOW - 1, 10e3, 1e3).go(1, 10e3, 1e3, FLAGS[name])

    drive.go(2 * WINDOW, 10e3, 8e3)
    assert drive.check.force_difference == pytest.approx(0.2)


def test_publications_a_second_apart_are_no_course(
    car: Callable[..., Config],
) -> None:
    """Nor those that do not come later."""
    drive = Drive(car()).go(400, 10e3, 8e3, step_us=1_000_000)
    assert isnan(drive.check.force_difference)
    drive.go(400, 10e3, 8e3, step_us=999_000)
    assert drive.check.force_difference == pytest.approx(0.2)


def test_fused_heat_is_compared_by_its_power_and_learned_friction(
    car: Callable[..., Config],
) -> None:
    """12.5 kW by pressure at 0.8 of the friction, 7.5 kW of heat."""
    drive = Drive(car("fused")).go(20 * WINDOW, 12.5e3, 7.5e3, scale=0.8)

    assert drive.check.force_difference == pytest.approx(0.25)


def test_a_standing_car_does_no_work(car: Callable[..., Config]) -> None:
    """Neither counts nor fades what was counted."""
    drive = Drive(car()).go(8 * WINDOW, 10e3, 8e3).go(400 * WINDOW, 0.0, 0.0)

    assert drive.check.force_difference == pytest.approx(0.2)


def couple(floor_k: float = 8.0, share: float = 0.05) -> Couple:
    return Couple("FL", "disc", "disc", floor_k=floor_k, share=share)


def test_a_residual_is_a_plain_mean_and_then_fades() -> None:
    one = couple()
    means = []
    for residual_k in (10.0, 20.0, 21.0, 0.0):
        one.take(residual_k, 100.0, 60.0)
        means.append(one.mean_k)

    # from two minutes on, a minute has half the weight
    assert means == pytest.approx([10.0, 15.0, 18.0, 9.0])
    assert one.known_s == 240.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_thermocouple_disagrees_beyond_three_sigmas(sign: float) -> None:
    """8 K and 5 % of 120 K make 10 K; it agrees again below 18 K."""
    for residual_k, disagrees in ((29.99, False), (30.01, True)):
        one = couple()
        one.take(sign * residual_k, 120.0, 119.0)
        assert not one.disagrees
        one.take(sign * residual_k, 120.0, 1.0)
        assert one.disagrees is disagrees
    for residual_k, disagrees in ((18.01, True), (17.99, False)):
        one.take(sign * residual_k, 120.0, 120.0)
        assert one.disagrees is disagrees


def test_a_reading_that_is_missing_begins_anew() -> None:
    one = couple()
    one.take(100.0, 0.0, 200.0)
    assert one.disagrees

    one.take(nan, 0.0, 0.1)
    assert (isnan(one.mean_k), one.known_s) == (True, 0.0)
    assert not one.disagrees
    one.take(5.0, 0.0, 0.5)
    assert (one.mean_k, one.known_s) == (5.0, 0.5)


def couples(config: Config, *names: str) -> list[Couple]:
    roles = [ROLE_INDEX[name] for name in names]
    return check_of(config, roles).couples


def test_the_usual_accuracy_of_each_node(car: Callable[..., Config]) -> None:
    """What docs/validity.md calls a sound model that was not matched."""
    found = couples(
        car(),
        *("temp_fl_disc", "temp_fl_disc_2", "temp_fr_pad_front"),
        *("temp_fr_pad_back", "temp_fl_fluid"),
    )

    assert {
        one.name: (one.shown_node, one.floor_k, one.share) for one in found
    } == {
        "FL disc": ("disc", 10.0, 0.06),
        "FL disc_2": ("disc", 10.0, 0.06),
        "FR pad_front": ("pad_front", 10.0, 0.06),
        "FR pad_back": ("pad_back", 5.0, 0.05),
        "FL fluid": ("fluid", 3.0, 0.05),
    }


def test_a_caliper_of_its_own_is_as_accurate_as_the_fluid(
    car: Callable[..., Config],
) -> None:
    split = EffectConfig(name="caliper_fluid_split")
    config = car(effect=[split])

    (one,) = couples(config, "temp_fr_caliper")

    assert (one.shown_node, one.floor_k, one.share) == ("caliper", 3.0, 0.05)


def test_couples_go_on_within_a_drive_and_findings_after_it(
    car: Callable[..., Config],
) -> None:
    roles = [ROLE_INDEX["temp_fl_disc"]]
    first = check_of(car(), roles)
    first.couples[0].take(100.0, 0.0, 200.0)
    assert first.holds("FL", 50.0, found=True)
    document = {"model_check": first.export()}

    def resumed(parked_s: float | None) -> tuple[float, bool]:
        check = check_of(car(), roles)
        check.resume(document, parked_s)
        return check.couples[0].known_s, check.holds("FL", 1.0, found=False)

    assert resumed(None) == (200.0, True)
    assert resumed(0.0) == (0.0, True)
    # 50 s are remembered for 30 times as long
    assert resumed(1490.0) == (0.0, True)
    assert resumed(1510.0) == (0.0, False)


def test_accuracy_that_is_configured(car: Callable[..., Config]) -> None:
    """The thermocouple's own error comes on top, in quadrature."""
    accuracy = {
        "disc_k": 6.0,
        "disc_share": 0.02,
        "thermocouple_offset_k": 8.0,
    }
    disc, fluid = couples(
        car(accuracy=accuracy), "temp_fl_disc", "temp_fl_fluid"
    )

    assert (disc.floor_k, disc.share) == (pytest.approx(10.0), 0.02)
    assert (fluid.floor_k, fluid.share) == (
        pytest.approx(hypot(3.0, 8.0)),
        0.05,
    )


def test_a_measured_disc_is_not_compared_with_itself(
    car: Callable[..., Config],
) -> None:
    found = couples(car("measured"), "temp_fl_disc", "temp_fl_pad_front")

    assert [one.name for one in found] == ["FL pad_front"]


@pytest.mark.parametrize("known", [True, False])
def test_a_residual_is_measured_less_shown(
    car: Callable[..., Config], *, known: bool
) -> None:
    """55 K at 200 K of rise are beyond 3 hypot(10, 12); if the start is."""
    config = car()
    roles = [ROLE_INDEX["temp_fl_disc"]]
    check = check_of(config, roles)
    layout = Estimator(config, {}).layout
    (group,) = layout.groups
    shown = array("d", [493.0]) * (group.size * len(CORNERS))
    for second in range(130):
        check.findings(
            block_of(
                second * 1_000_000,
                {"measured_disc_k": 548.0, "ambient_k": 293.0},
                outputs=[shown],
                known_from={name: int(not known) for name in CORNERS},
            )
        )

    (one,) = check.couples
    if known:
        assert one.mean_k == pytest.approx(55.0)
        assert check.disagreements == ("FL disc",)
    else:
        assert isnan(one.mean_k)
        assert check.disagreements == ()
