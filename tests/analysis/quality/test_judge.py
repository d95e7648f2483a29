"""Faults put into a clean drive: each is named, and nothing else is."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.analysis.quality.finding import Quality
from bstm_daemon.analysis.quality.judge import judge
from bstm_daemon.analysis.quality.recording import Recording, Series
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config

Judge = Callable[[Recording], Quality]
Change = Callable[[Column, Column], Column]

ACCELERATION = "acceleration_longitudinal"
PRIMARY = "primary_pressure"
SECONDARY = "secondary_pressure"
WHEEL = "wheel_speed_fl"
DISC = "temp_fl_disc"
WHEELS = tuple(f"wheel_speed_{corner}" for corner in ("fl", "fr", "rl", "rr"))
SPEEDS = ("vehicle_speed", *WHEELS)


def changed(recording: Recording, **changes: Change) -> Recording:
    """Return *recording* with roles changed by (time_s, value) -> value."""
    series = dict(recording.series)
    for role, change in changes.items():
        old = series[role]
        series[role] = replace(old, value=change(old.time_s, old.value))
    return replace(recording, series=series)


def only(recording: Recording, *roles: str) -> Recording:
    """Return *recording* with nothing but *roles*."""
    series = {role: recording.series[role] for role in roles}
    return replace(recording, series=series)


def without(recording: Recording, *roles: str) -> Recording:
    """Return *recording* with *roles* left out."""
    kept = [role for role in recording.series if role not in roles]
    return only(recording, *kept)


def swapped(recording: Recording, *pairs: tuple[str, str]) -> Recording:
    """Return *recording* with the channels of each pair exchanged."""
    series = dict(recording.series)
    for one, other in pairs:
        series[one], series[other] = series[other], series[one]
    return replace(recording, series=series)


def named(quality: Quality) -> list[tuple[str, tuple[str, ...]]]:
    """Return fault and roles of every finding, absent roles left out."""
    return [
        (finding.fault, finding.roles)
        for finding in quality.findings
        if finding.fault != "missing"
    ]


def scaled(factor: float) -> Change:
    return lambda _, value: value * factor


def shifted(offset: float) -> Change:
    return lambda _, value: value + offset


def stuck(from_s: float) -> Change:
    def change(time_s: Column, value: Column) -> Column:
        held = value[time_s >= from_s][0]
        return np.where(time_s >= from_s, held, value)

    return change


def late(lag_s: float) -> Change:
    return lambda time_s, value: np.interp(time_s - lag_s, time_s, value)


def test_clean_drive_is_clean(clean: Recording, judged: Judge) -> None:
    quality = judged(clean)

    assert named(quality) == []
    assert [mode.usable for mode in quality.modes] == [True] * 4
    assert all(one.agrees is not False for one in quality.comparisons)
    agreed = [one for one in quality.comparisons if one.agrees]
    assert len(agreed) == 20
    assert quality.not_judged == ()


@pytest.mark.parametrize(
    ("role", "change", "fault"),
    [
        (ACCELERATION, scaled(-1.0), "sign"),
        (ACCELERATION, scaled(1 / 9.80665), "unit"),
        (ACCELERATION, scaled(9.80665), "unit"),
        (ACCELERATION, scaled(1.5), "scale"),
        (ACCELERATION, shifted(3.0), "offset"),
        (ACCELERATION, stuck(80.0), "frozen"),
        (ACCELERATION, scaled(0.0), "dead"),
        (ACCELERATION, late(0.5), "lag"),
        (WHEEL, scaled(-1.0), "sign"),
        (WHEEL, scaled(3.6), "unit"),
        (WHEEL, scaled(1 / 3.6), "unit"),
        (WHEEL, scaled(1.609344), "unit"),
        (WHEEL, scaled(1.1), "scale"),
        (WHEEL, shifted(1.5), "offset"),
        (WHEEL, stuck(60.0), "frozen"),
        (WHEEL, scaled(0.0), "dead"),
        (WHEEL, late(0.6), "lag"),
        ("vehicle_speed", scaled(3.6), "unit"),
        ("vehicle_speed", stuck(60.0), "frozen"),
        (PRIMARY, scaled(-1.0), "sign"),
        (PRIMARY, scaled(14.5038), "unit"),
        (PRIMARY, scaled(0.1), "unit"),
        (PRIMARY, scaled(4.0), "scale"),
        (PRIMARY, shifted(6e5), "offset"),
        (PRIMARY, stuck(21.5), "frozen"),
        (PRIMARY, scaled(0.0), "dead"),
        (PRIMARY, late(0.5), "lag"),
        (SECONDARY, scaled(14.5038), "unit"),
        (DISC, lambda _, value: value * 0.0 + 300.0, "dead"),
        (DISC, stuck(60.0), "frozen"),
        (DISC, shifted(-40.0), "implausible"),
        (DISC, shifted(-273.15), "unit"),
        (DISC, scaled(5.0), "implausible"),
        ("brake_switch", lambda _, value: 1.0 - value, "sign"),
        ("brake_switch", scaled(0.0), "dead"),
    ],
)
def test_fault_is_named_and_nothing_else(
    clean: Recording, judged: Judge, role: str, change: Change, fault: str
) -> None:
    quality = judged(changed(clean, **{role: change}))

    assert named(quality) == [(fault, (role,))]


@pytest.mark.parametrize(
    ("role", "change"),
    [
        (ACCELERATION, scaled(1.1)),
        (ACCELERATION, shifted(0.2)),
        (ACCELERATION, late(0.1)),
        (WHEEL, scaled(1.02)),
        (WHEEL, shifted(0.2)),
        (WHEEL, late(0.1)),
        (PRIMARY, scaled(1.2)),
        (PRIMARY, shifted(0.5e5)),
        (DISC, shifted(-8.0)),
    ],
)
def test_small_fault_is_not_claimed(
    clean: Recording, judged: Judge, role: str, change: Change
) -> None:
    assert named(judged(changed(clean, **{role: change}))) == []


def test_every_wheel_wrong_is_not_the_vehicle_speed(
    clean: Recording, judged: Judge
) -> None:
    """Four wheels have one source: the accelerometer decides."""
    quality = judged(changed(clean, **dict.fromkeys(WHEELS, scaled(3.6))))

    assert named(quality) == [("unit", (wheel,)) for wheel in WHEELS]


def test_every_speed_wrong_by_a_unit_is_not_the_accelerometer(
    clean: Recording, judged: Judge
) -> None:
    wrong = changed(clean, **dict.fromkeys(SPEEDS, scaled(3.6)))
    quality = judged(without(wrong, "gnss_speed"))

    assert named(quality) == [("unit", SPEEDS)]
    assert not quality.usable


def test_one_speed_with_the_accelerometer_is_right_against_five(
    clean: Recording, judged: Judge
) -> None:
    """The vehicle's speed comes from the wheels: satellites do not."""
    quality = judged(changed(clean, **dict.fromkeys(SPEEDS, scaled(3.6))))

    assert named(quality) == [("unit", (role,)) for role in SPEEDS]


def test_two_speeds_that_disagree_without_a_third_stay_undecided(
    clean: Recording, judged: Judge
) -> None:
    two = only(clean, "vehicle_speed", WHEEL, PRIMARY)

    quality = judged(changed(two, **{WHEEL: scaled(3.6)}))

    assert ("ambiguous", ("vehicle_speed", WHEEL)) in named(quality)


def test_swapped_front_wheels(clean: Recording, judged: Judge) -> None:
    front = (WHEELS[0], WHEELS[1])

    quality = judged(swapped(clean, front))

    assert named(quality) == [("swapped", front)]


def test_swapped_axles(clean: Recording, judged: Judge) -> None:
    quality = judged(
        swapped(clean, (WHEELS[0], WHEELS[2]), (WHEELS[1], WHEELS[3]))
    )

    assert named(quality) == [("swapped", WHEELS)]


@pytest.mark.parametrize("share", [0.08, 0.3])
def test_wheels_that_spin_in_launches_are_no_fault(
    clean: Recording, judged: Judge, share: float
) -> None:
    """Driven wheels, and the speed that is taken from them, in every launch.

    Half of the time, in slow driving, all agree.
    """
    launch, slowing = np.arange(0.0, 30.0, 0.08), np.arange(30.0, 0.0, -0.16)
    parts = [launch, slowing, np.full(1000, 6.0), np.full(200, 3.0)]
    spin = [share, 0.0, 0.0, 0.0]
    sizes = [len(part) for part in parts]
    true = np.tile(np.concatenate(parts), 8)
    spun = true * (1.0 + np.tile(np.repeat(spin, sizes), 8))
    time_s = np.arange(len(true)) * 0.02
    rng = np.random.default_rng(3)
    series = {
        role: Series(time_s, value + rng.normal(0.0, 0.03, len(true)))
        for role, value in {
            "vehicle_speed": spun,
            **dict.fromkeys(WHEELS[:2], true),
            **dict.fromkeys(WHEELS[2:], spun),
        }.items()
    }

    quality = judged(Recording(series, float(time_s[-1]), {}, {}))

    assert not [text for text in quality.findings if text.wrong]


@pytest.mark.slow
def test_a_residual_pressure_is_a_released_brake(
    clean: Recording, judged: Judge
) -> None:
    """0.55 to 0.85 bar, which a threshold of 0.5 bar takes for pressed."""
    wavering = {
        role: lambda time_s, value: value + 0.7e5 + 0.15e5 * np.sin(time_s)
        for role in (PRIMARY, SECONDARY)
    }

    quality = judged(changed(clean, **wavering))
    inverted = judged(
        changed(clean, **wavering, brake_switch=lambda _, value: 1.0 - value)
    )

    assert named(quality) == []
    assert named(inverted) == [("sign", ("brake_switch",))]


def test_reversing_is_no_swapping(clean: Recording, judged: Judge) -> None:
    """In reverse the inner wheel's speed, without a sign, is the larger."""
    time_s = np.arange(0.0, 90.0, 0.02)
    reverse = time_s < 20.0
    velocity = np.where(reverse, -1.5, 15.0 + 3.0 * np.sin(time_s))
    yaw = np.where(reverse, 0.5, 0.07 * (np.sin(0.2 * time_s) > 0.0))
    series = {
        wheel: Series(
            time_s,
            np.abs(velocity + (-0.8 if wheel[-1] == "l" else 0.8) * yaw),
        )
        for wheel in WHEELS
    }
    series["yaw_rate"] = Series(time_s, yaw)

    quality = judged(Recording(series, 90.0, {}, {}))

    assert not any(fault == "swapped" for fault, _ in named(quality))
    tracks = [one.verdict for one in quality.comparisons if "yaw" in one.title]
    assert tracks == ["agrees, track 1.60 m"] * 2


def test_swapping_without_yaw_rate_is_not_guessed(
    clean: Recording, judged: Judge
) -> None:
    front = (WHEELS[0], WHEELS[1])

    quality = judged(without(swapped(clean, front), "yaw_rate"))

    assert named(quality) == []
    assert any(
        "swapping is not detected" in text for text in quality.not_judged
    )


def test_temperature_on_a_pressure_line(
    clean: Recording, judged: Judge
) -> None:
    pressure = clean.series[PRIMARY]
    line = Series(pressure.time_s, 250.0 + 1.8e-5 * pressure.value)

    quality = judged(replace(clean, series={**clean.series, DISC: line}))

    assert named(quality) == [("mis-wired", (DISC,))]
    assert "r = 1.0" in quality.findings[-1].text


def test_dropouts(clean: Recording, judged: Judge) -> None:
    series = clean.series[WHEEL]
    kept = (series.time_s < 50.0) | (series.time_s > 90.0)
    holed = Series(series.time_s[kept], series.value[kept])

    quality = judged(replace(clean, series={**clean.series, WHEEL: holed}))

    assert named(quality) == [("dropouts", (WHEEL,))]
    (role,) = [one for one in quality.roles if one.role == WHEEL]
    assert role.statistics is not None
    assert role.statistics.gaps_over_timeout == 1
    assert role.statistics.longest_gap_s == pytest.approx(40.0, abs=0.1)


def test_silence_of_the_whole_bus_is_no_dropout(
    clean: Recording, judged: Judge
) -> None:
    """After the ignition goes off, only the thermocouples go on."""
    series = {
        role: one
        if role.startswith("temp_")
        else Series(one.time_s[one.time_s < 90.0], one.value[one.time_s < 90])
        for role, one in clean.series.items()
    }

    assert named(judged(replace(clean, series=series))) == []


def test_parked_car_claims_nothing(clean: Recording, judged: Judge) -> None:
    """Wrong signs and scales at standstill: nothing can be seen of them."""
    parked = {
        role: Series(one.time_s[one.time_s < 3.5], one.value[one.time_s < 3.5])
        for role, one in clean.series.items()
    }
    still = replace(clean, series=parked, duration_s=3.5)

    quality = judged(
        changed(still, **{ACCELERATION: scaled(-1.0), WHEEL: scaled(3.6)})
    )

    assert named(quality) == []
    assert all(one.agrees is None for one in quality.comparisons)
    assert any(ACCELERATION in text for text in quality.not_judged)
    assert any("speeds" in text for text in quality.not_judged)


def test_car_on_a_stand(clean: Recording, judged: Judge) -> None:
    """Front wheels stand, rear ones turn, the accelerometer feels nothing."""
    rng = np.random.default_rng(1)
    quality = judged(
        changed(
            clean,
            wheel_speed_fl=scaled(0.0),
            wheel_speed_fr=scaled(0.0),
            acceleration_longitudinal=lambda _, value: rng.normal(
                0.0, 0.03, len(value)
            ),
        )
    )

    assert named(quality) == [("axles-disagree", WHEELS[:2])]
    usable = {mode.mode: mode.usable for mode in quality.modes}
    assert usable == {
        "ff": True,
        "fb": False,
        "fused": False,
        "measured": True,
    }


def test_front_axle_dead_on_a_moving_car(
    clean: Recording, judged: Judge
) -> None:
    """The accelerometer knows that the car moves."""
    quality = judged(
        changed(clean, wheel_speed_fl=scaled(0), wheel_speed_fr=scaled(0))
    )

    assert named(quality) == [("dead", (wheel,)) for wheel in WHEELS[:2]]


def test_pressure_unit_is_told_by_the_motion_alone(
    clean: Recording, judged: Judge
) -> None:
    single = without(clean, SECONDARY)

    quality = judged(changed(single, **{PRIMARY: scaled(14.5038)}))

    assert named(quality) == [("unit", (PRIMARY,))]
    assert "psi" in quality.findings[-1].text


def test_what_a_mode_lacks_is_said(clean: Recording, judged: Judge) -> None:
    quality = judged(only(clean, *SPEEDS))

    modes = {mode.mode: mode for mode in quality.modes}
    assert modes["ff"].missing == ("a pressure for FL FR RL RR",)
    assert "powertrain_torque" in modes["fb"].missing[0]
    assert "temp_fl_disc" in modes["measured"].missing[0]
    assert not quality.usable


def test_fused_learns_from_the_accelerometer(
    clean: Recording, judged: Judge
) -> None:
    quality = judged(without(clean, ACCELERATION))

    missing = {mode.mode: mode.missing for mode in quality.modes}
    assert missing["fused"] == (f"{ACCELERATION} to learn from",)
    assert missing["ff"] == missing["fb"] == ()


def test_own_ids_on_the_bus_are_told(clean: Recording, judged: Judge) -> None:
    taken = replace(clean, seen={(0, 0x5B0, False): 12, (0, 0x100, False): 3})

    quality = judged(taken)

    assert named(quality) == [("id-collision", ())]
    assert "12 frames with id 0x5B0 on" in quality.findings[-1].text
    assert "choose another id_base" in quality.findings[-1].text
    assert quality.usable


def test_ids_in_reserve_are_ours_too(clean: Recording, judged: Judge) -> None:
    seen = {(0, 0x5C3, False): 1, (0, 0x5C4, False): 1, (0, 0x5B0, True): 1}

    (finding,) = judged(replace(clean, seen=seen)).findings

    assert "1 frame with id 0x5C3 on" in finding.text
    assert "5C4" not in finding.text
    assert "5B0 on" not in finding.text


def test_frames_of_the_daemon_are_told_from_foreign_ones(
    clean: Recording, example: tuple[Config, SignalMap]
) -> None:
    """All frames of an id must carry our protection."""
    taken = replace(clean, seen={(0, 0x5B0, False): 12, (0, 0x5B4, False): 9})

    quality = judge(taken, *example, own_frames={0x5B0: 12, 0x5B4: 8})

    collision, own = quality.findings
    assert collision.fault == "id-collision"
    assert "9 frames with id 0x5B4" in collision.text
    assert own.fault == "own-frames"
    assert "12 frames with id 0x5B0" in own.text
    assert quality.usable
