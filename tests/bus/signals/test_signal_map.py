"""Compiling DBC and roles: the plan, and every problem at once."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bstm_daemon.bus.output.layout import BLOCK_IDS
from bstm_daemon.bus.signals import signal_map
from bstm_daemon.bus.signals.dbc_text import DbcDefect
from bstm_daemon.bus.signals.extraction import Condition, FrameKey, Output
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.units import GRAVITY_MS2

Compile = Callable[..., SignalMap]

DBC = """VERSION ""
BU_: X
BO_ 208 WHEELS: 8 X
 SG_ FL : 0|16@1+ (0.01,0) [0|0] "" X
 SG_ FR : 16|16@1+ (0.01,0) [0|0] "" X
BO_ 256 BRAKE: 8 X
 SG_ pressure : 7|12@0+ (0.1,-10) [0|0] "" X
 SG_ pressed : 24|1@1+ (1,0) [0|0] "" X
BO_ 2147483904 BODY: 6 X
 SG_ kind M : 0|4@1+ (1,0) [0|0] "" X
 SG_ ambient m2 : 8|8@1+ (0.5,-40) [0|0] "" X
BO_ 300 WIDE: 10 X
 SG_ torque : 64|16@1- (1,0) [0|0] "" X
BO_ 301 LONG: 255 X
 SG_ x : 0|8@1+ (1,0) [0|0] "" X
BO_ 208 TWIN: 8 X
 SG_ y : 0|8@1+ (1,0) [0|0] "" X
"""


def source(
    message: str, signal: str | None, unit: str, **more: Any
) -> SignalConfig:
    return SignalConfig(message=message, signal=signal, unit=unit, **more)


@pytest.fixture
def compile_map(tmp_path: Path) -> Compile:
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "other.dbc").write_text(DBC)

    def compiled(
        *buses: BusConfig, radius_m: float = 0.3, **signals: SignalConfig
    ) -> SignalMap:
        buses = buses or (BusConfig(name="car", dbc="car.dbc"),)
        return compile_signal_map(buses, signals, tmp_path, radius_m)

    return compiled


def test_roles_of_one_message_share_a_plan(compile_map: Compile) -> None:
    signal_map = compile_map(
        primary_pressure=source("BRAKE", "pressure", "bar"),
        brake_switch=source("BRAKE", "pressed", "bool"),
        wheel_speed_fl=source("WHEELS", "FL", "km/h"),
    )

    assert list(signal_map.messages) == [
        FrameKey(0, 256, extended=False),
        FrameKey(0, 208, extended=False),
    ]
    brake = signal_map.messages[FrameKey(0, 256, extended=False)]
    assert [output.role for output in brake.outputs] == [
        ROLE_INDEX["primary_pressure"],
        ROLE_INDEX["brake_switch"],
    ]
    assert [output.flag for output in brake.outputs] == [False, True]
    assert signal_map.wanted(0) == {(256, False), (208, False)}
    assert signal_map.wanted(1) == frozenset()
    assert signal_map.roles() == {
        ROLE_INDEX[name]
        for name in ("primary_pressure", "brake_switch", "wheel_speed_fl")
    }


def only_output(signal_map: SignalMap) -> Output:
    (plan,) = signal_map.messages.values()
    (output,) = plan.outputs
    return output


def test_the_map_to_si(compile_map: Compile) -> None:
    """In SI: factor * sign * (value * scale + offset) + unit offset."""
    output = only_output(
        compile_map(
            acceleration_longitudinal=source(
                "WHEELS", "FL", "g", sign=-1, scale=2.0, offset=0.5,
                min=-1.0, max=1.5,
            )
        )
    )  # fmt: skip

    assert output.gain == pytest.approx(-2 * GRAVITY_MS2)
    assert output.bias == pytest.approx(-0.5 * GRAVITY_MS2)
    assert output.low == pytest.approx(-GRAVITY_MS2)
    assert output.high == pytest.approx(1.5 * GRAVITY_MS2)


def test_degrees_become_kelvin(compile_map: Compile) -> None:
    output = only_output(
        compile_map(ambient_temperature=source("BODY", "ambient", "degC"))
    )

    assert (output.gain, output.bias) == (1.0, 273.15)
    assert output.conditions == (Condition(1, frozenset({2})),)


@pytest.mark.parametrize(
    ("id_base", "taken"),
    [
        (256, True),
        (256 - BLOCK_IDS + 1, True),
        (257, False),
        (256 - BLOCK_IDS, False),
    ],
)
def test_an_id_that_is_read_is_not_for_our_frames(
    compile_map: Compile, id_base: int, *, taken: bool
) -> None:
    """A standard one of the same bus: an extended 256 is another."""
    brake = compile_map(primary_pressure=source("BRAKE", "pressure", "bar"))
    body = compile_map(ambient_temperature=source("BODY", "ambient", "degC"))

    problems = brake.taken_ids(0, id_base)
    expected = (
        f"[publish] id_base = 0x{id_base:X}: the id 0x100 of message 'BRAKE' "
        "would be ours, but this configuration reads it: choose another "
        "id_base"
    )
    assert problems == [expected] * taken
    assert brake.taken_ids(1, id_base) == []
    assert body.taken_ids(0, id_base) == []


@pytest.mark.parametrize(
    ("unit", "gain"), [("rad/s", 0.25), ("rpm", 0.25 * 0.10471975511965977)]
)
def test_an_angular_wheel_speed_uses_the_wheel_radius(
    compile_map: Compile, unit: str, gain: float
) -> None:
    output = only_output(
        compile_map(
            wheel_speed_rl=source("WHEELS", "FL", unit, max=100.0),
            radius_m=0.25,
        )
    )

    assert output.gain == pytest.approx(gain)
    assert output.high == pytest.approx(100 * gain)


def test_other_angular_speeds_stay_angular(compile_map: Compile) -> None:
    output = only_output(
        compile_map(engine_speed=source("WHEELS", "FL", "rad/s"))
    )

    assert output.gain == 1.0


def test_time_limits_come_from_the_configuration_or_the_role(
    compile_map: Compile,
) -> None:
    signal_map = compile_map(
        gnss_speed=source("WHEELS", "FL", "m/s", timeout_s=0.25)
    )

    timeouts = signal_map.timeouts_us
    assert timeouts[ROLE_INDEX["gnss_speed"]] == 250_000
    assert timeouts[ROLE_INDEX["altitude"]] == 5_000_000


def test_an_fd_message_takes_the_next_frame_length(
    compile_map: Compile,
) -> None:
    signal_map = compile_map(motor_torque=source("WIDE", "torque", "Nm"))

    (plan,) = signal_map.messages.values()
    assert plan.length == 12


def test_buses_are_told_apart(compile_map: Compile) -> None:
    signal_map = compile_map(
        BusConfig(name="a", dbc="car.dbc"),
        BusConfig(name="b", dbc="other.dbc"),
        wheel_speed_fl=source("WHEELS", "FL", "m/s"),
        wheel_speed_fr=source("WHEELS", "FR", "m/s", bus="b"),
    )

    assert [key.bus for key in signal_map.messages] == [0, 1]


@pytest.mark.parametrize(
    ("role", "config", "problem"),
    [
        (
            "primary_pressure",
            source("BRAKES", "pressure", "bar"),
            "message = 'BRAKES': not in 'car.dbc', did you mean 'BRAKE'?",
        ),
        (
            "primary_pressure",
            source("BRAKE", "presure", "bar"),
            (
                "signal = 'presure': not a signal of "
                "message 'BRAKE', did you mean 'pressure'?"
            ),
        ),
        (
            "primary_pressure",
            source("BRAKE", "zzz", "bar"),
            (
                "signal = 'zzz': not a signal of "
                "message 'BRAKE', known are pressed, pressure"
            ),
        ),
        (
            "primary_pressure",
            source("BRAKE", None, "bar", expression="pressure +"),
            (
                "expression = 'pressure +': position "
                "11: a number, a signal or '(' is expected, found the end"
            ),
        ),
        (
            "primary_pressure",
            source("BRAKE", None, "bar", expression="presure * 2"),
            (
                "expression = 'presure * 2': "
                "'presure' is not a signal of message 'BRAKE', did you "
                "mean 'pressure'?"
            ),
        ),
        (
            "gear",
            source("LONG", "x", "count"),
            ("message = 'LONG': has 255 bytes, a frame carries at most 64"),
        ),
    ],
)
def test_a_problem_names_section_key_value_and_what_is_allowed(
    compile_map: Compile, role: str, config: SignalConfig, problem: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        compile_map(**{role: config})

    (found,) = caught.value.problems
    section, _, said = found.partition("]")
    assert section == f"[signals.{role}"
    assert said.strip() == problem


def test_all_problems_are_listed(compile_map: Compile) -> None:
    with pytest.raises(ConfigError) as caught:
        compile_map(
            BusConfig(name="car", dbc="car.dbc"),
            BusConfig(name="gone", dbc="gone.dbc"),
            primary_pressure=source("BRAKES", "pressure", "bar"),
            gear=source("BRAKE", "presse", "count"),
            vehicle_speed=source("WHEELS", "FL", "km/h", bus="gone"),
        )

    problems = caught.value.problems
    assert len(problems) == 3
    assert problems[0].startswith("[[bus]] name = 'gone': ")
    assert "gone.dbc: cannot be read" in problems[0]
    assert [problem.split(" = ")[0] for problem in problems[1:]] == [
        "[signals.primary_pressure] message",
        "[signals.gear] signal",
    ]


def test_two_messages_of_one_id_are_a_problem(compile_map: Compile) -> None:
    with pytest.raises(ConfigError, match="message = 'TWIN': has the id of"):
        compile_map(
            wheel_speed_fl=source("WHEELS", "FL", "km/h"),
            gear=source("TWIN", "y", "count"),
        )


def test_defects_that_change_a_value_are_logged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An id given twice as a warning; what is harmless not at all."""
    lines: list[tuple[str, str, dict[str, Any]]] = []
    log = SimpleNamespace(
        **{
            level: lambda event, level=level, **fields: lines.append(
                (level, event, fields)
            )
            for level in ("info", "warning")
        }
    )
    monkeypatch.setattr(signal_map, "_log", log)
    found: Any = SimpleNamespace(
        buses=[SimpleNamespace(name="body", dbc="body.dbc")],
        warnings={
            "body": (
                DbcDefect(3, "a long comment", harmless=True),
                DbcDefect(7, "dropped", "BRAKE"),
                DbcDefect(9, "twice", harmless=True, same_id=True),
            )
        },
    )

    signal_map.log_defects(found)

    fields = {"bus": "body", "dbc": "body.dbc"}
    dropped = {"defect": "line 7: message 'BRAKE': dropped"}
    assert lines == [
        ("info", "dbc_defect", fields | dropped),
        ("warning", "dbc_defect", fields | {"defect": "line 9: twice"}),
    ]
