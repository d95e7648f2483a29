"""``bstm init``: what it proposes for cars whose truth is known."""

import os
import re
from pathlib import Path

import pytest
from cantools.database import load_file

from bstm_daemon.cli.main import main
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.model.heat.feed_forward import PressureTorque

from .. import ford_like  # noqa: TID252  (tests are no package)

ROOT = Path(__file__).parents[2]
EXAMPLE_DBC = ROOT / "dbc" / "example_vehicle.dbc"
REAL = os.environ.get("BSTM_REAL_DATA")

needs_recordings = pytest.mark.skipif(
    REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
)
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of the simulated car with hard braking in it."""
    log = tmp_path_factory.mktemp("init") / "step.log"
    assert main(["simulate", "idiada-step", "-o", str(log)]) == 0
    return log


def proposed(
    out: Path, dbc: Path, *logs: Path, options: tuple[str, ...] = ()
) -> Config:
    """Return the configuration that init writes and check accepts."""
    arguments = [word for log in logs for word in ("--log", str(log))]
    assert (
        main(["init", "--dbc", str(dbc), *arguments, "-o", str(out), *options])
        == 0
    )
    assert main(["check", str(out)]) == 0
    return load_config(out)


def sources(config: Config) -> dict[str, tuple[str, ...]]:
    return {
        role: (str(one.message), str(one.signal), one.unit)
        for role, one in config.signals.items()
    }


STILL = {
    *("acceleration_lateral", "yaw_rate", "motor_torque", "external_force"),
    *("rain", "abs_active", "esc_active", "tc_active"),
}
"""Roles of the example car that are 0 throughout the drive."""


def test_every_role_of_the_example_car_is_found(
    tmp_path: Path, drive: Path
) -> None:
    """Each with its unit, unturned and unscaled; none that is always 0."""
    expected = load_config(ROOT / "config" / "example_vehicle.toml")
    out = tmp_path / "car.toml"

    config = proposed(out, EXAMPLE_DBC, drive)

    assert sources(config) == {
        role: source
        for role, source in sources(expected).items()
        if role not in STILL
    }
    text = out.read_text("utf-8")
    assert all(f"# [signals.{role}]" in text for role in STILL)
    assert all(
        (one.sign, one.scale) == (1, 1.0) for one in config.signals.values()
    )
    assert config.heat.mode == "fused"
    assert config.bus[0].strict
    assert config.bus[0].channel == "can0"


def test_a_car_with_several_signals_of_each_kind(tmp_path: Path) -> None:
    """Measurements before requests, and nothing that does something else.

    The radius follows from angular wheel speeds, the sign of the yaw rate
    from the wheels in bends.
    """
    out = tmp_path / "car.toml"
    dbc = ford_like.write_dbc(tmp_path / "car.dbc")
    log = ford_like.write_log(tmp_path / "drive.log")

    config = proposed(out, dbc, log)

    found = {role: one.signal for role, one in config.signals.items()}
    assert found == ford_like.ROLES
    assert config.signals["yaw_rate"].sign == -1
    assert all(one.scale == 1.0 for one in config.signals.values())
    assert config.vehicle.wheel_radius_m == pytest.approx(
        ford_like.RADIUS_M, rel=2e-3
    )
    text = " ".join(out.read_text("utf-8").replace("# ", "").split())
    assert "also Accel_Data.VehLongAccelGnd_A_Est" in text
    assert 'signal = "AbsActv_B"' in text


def test_without_a_log_it_is_by_name_and_unit_and_said(
    tmp_path: Path, capsys: Capture
) -> None:
    expected = load_config(ROOT / "config" / "example_vehicle.toml")
    out = tmp_path / "car.toml"

    config = proposed(out, EXAMPLE_DBC)

    assert sources(config) == sources(expected)
    text = out.read_text("utf-8")
    assert "No log was given" in text
    assert text.count("By name and unit only") == len(config.signals)
    assert "by name and unit only" in capsys.readouterr().out


def test_every_value_that_is_not_the_cars_is_marked(
    tmp_path: Path, drive: Path
) -> None:
    out = tmp_path / "car.toml"
    proposed(out, EXAMPLE_DBC, drive)

    lines = out.read_text("utf-8").splitlines()

    numbers = [
        line
        for line in lines
        if re.match(r"[a-z_.0-9]+ = [0-9]", line) and "timeout_s" not in line
    ]
    assert len(numbers) > 40
    assert all("typical, replace" in line for line in numbers)


def test_the_typical_brakes_fit_the_front_share(tmp_path: Path) -> None:
    """Feed-Back splits the brake force the way Feed-Forward forms it."""
    config = proposed(tmp_path / "car.toml", EXAMPLE_DBC)

    torque = {
        one.name: PressureTorque.of_corner(one).torque_per_pressure_nm_pa
        for one in config.corner
    }
    front = (torque["FL"] + torque["FR"]) / sum(torque.values())

    assert front == pytest.approx(config.vehicle.front_share, abs=0.01)


def test_an_acceleration_of_wrong_sign_and_scale_is_corrected(
    tmp_path: Path, drive: Path
) -> None:
    dbc = tmp_path / "wrong.dbc"
    text = EXAMPLE_DBC.read_text("utf-8")
    right = "AccelLongitudinal : 0|16@1- (0.001,0)"
    assert right in text
    dbc.write_text(text.replace(right, right.replace("0.001", "-0.002")))

    config = proposed(tmp_path / "car.toml", dbc, drive)

    one = config.signals["acceleration_longitudinal"]
    assert one.sign == -1
    assert one.scale == pytest.approx(0.5, rel=0.02)


def test_ids_outside_the_dbc_and_other_interfaces_are_said(
    tmp_path: Path, drive: Path, capsys: Capture
) -> None:
    log = tmp_path / "more.log"
    lines = drive.read_text("ascii").splitlines()[:60000]
    head = lines[-1].split()[0]
    lines += [f"{head} can0 7AB#00", f"{head} can1 1A0#0000000000000000"]
    log.write_text("\n".join(lines) + "\n", "ascii")
    out = tmp_path / "car.toml"

    config = proposed(out, EXAMPLE_DBC, log)

    assert config.bus[0].ignored_interfaces == ["can1"]
    assert main(["replay", str(log), "-c", str(out)]) == 0
    said = capsys.readouterr().out
    assert "1 ids in the log are not in the DBC: 7AB." in said
    assert "Interface can1 was left out: 1 of its 1 ids" in said
    assert "ids in the log are not in the DBC: 7AB" in out.read_text("utf-8")


def test_frames_longer_than_the_dbc_says_are_pointed_out(
    tmp_path: Path, drive: Path
) -> None:
    """The role is right, but the daemon will refuse the frames."""
    dbc = tmp_path / "short.dbc"
    text = EXAMPLE_DBC.read_text("utf-8")
    dbc.write_text(text.replace("BrakePressure: 8", "BrakePressure: 4"))
    out = tmp_path / "car.toml"

    config = proposed(out, dbc, drive)

    assert "primary_pressure" in config.signals
    assert config.heat.mode == "fb"
    assert "NOT READ: its frames have 8 bytes, the DBC has 4" in " ".join(
        out.read_text("utf-8").replace("#", "").split()
    )


def test_a_file_is_not_overwritten(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "car.toml"
    out.write_text("mine")
    arguments = ["init", "--dbc", str(EXAMPLE_DBC), "-o", str(out)]

    assert main(arguments) == 2
    assert out.read_text() == "mine"
    assert f"{out}: exists already, give --force" in capsys.readouterr().err

    assert main([*arguments, "--force"]) == 0
    assert "[vehicle]" in out.read_text("utf-8")


def test_the_dbc_is_found_from_the_files_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a b"
    folder.mkdir()
    dbc = tmp_path / "car.dbc"
    dbc.write_bytes(EXAMPLE_DBC.read_bytes())

    config = proposed(folder / "car.toml", dbc)

    assert config.bus[0].dbc == "../car.dbc"


@pytest.mark.parametrize(
    ("arguments", "code", "part"),
    [
        (["--dbc", "none.dbc", "-o", "car.toml"], 74, "none.dbc"),
        (["--dbc", str(EXAMPLE_DBC)], 2, "needs -o"),
        (["-o", "car.toml"], 2, "--dbc"),
        (
            ["--dbc", str(EXAMPLE_DBC), "--log", "no.log", "-o", "car.toml"],
            74,
            "no.log",
        ),
    ],
)
def test_what_is_missing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
    arguments: list[str],
    code: int,
    part: str,
) -> None:
    monkeypatch.chdir(tmp_path)

    assert main(["init", *arguments]) == code
    assert part in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_log_of_another_car(tmp_path: Path, capsys: Capture) -> None:
    log = tmp_path / "other.log"
    log.write_text("(1.0) can0 7AB#00\n")
    out = tmp_path / "car.toml"

    code = main(
        ["init", "--dbc", str(EXAMPLE_DBC), "--log", str(log), "-o", str(out)]
    )

    assert code == 65
    assert "no frame has an id of the DBC" in capsys.readouterr().err
    assert not out.exists()


def test_a_log_of_which_no_role_is_sure(
    tmp_path: Path, capsys: Capture
) -> None:
    """One id of the DBC is in the log by chance."""
    database = load_file(EXAMPLE_DBC)
    number = database.messages[0].frame_id
    log = tmp_path / "other.log"
    log.write_text(f"(1.0) can0 {number:03X}#00\n(2.0) can0 7AB#00\n")
    out = tmp_path / "car.toml"

    code = main(
        ["init", "--dbc", str(EXAMPLE_DBC), "--log", str(log), "-o", str(out)]
    )

    assert code == 0
    said = capsys.readouterr().out
    assert f"{out}: no role is sure: check that this is the car's DBC" in said


def test_a_dbc_without_a_speed(tmp_path: Path, capsys: Capture) -> None:
    dbc = tmp_path / "car.dbc"
    dbc.write_text('BO_ 1 A: 8 X\n SG_ b : 0|8@1+ (1,0) [0|0] "" X\n')

    code = main(["init", "--dbc", str(dbc), "-o", str(tmp_path / "c.toml")])

    assert code == 78
    assert "no signal has name and unit of a speed" in capsys.readouterr().err


def real(folder: str, name: str) -> Path:
    return Path(str(REAL)) / folder / name


@needs_recordings
def test_subaru(tmp_path: Path) -> None:
    """The DBC's acceleration is wrong in sign and scale (README)."""
    folder = "subaru-wrx-sti-candump"
    out = tmp_path / "car.toml"

    config = proposed(
        out,
        real(folder, "sample_can_spec.dbc"),
        real(folder, "can_sample.log"),
    )

    found = sources(config)
    assert {f"wheel_speed_{c}" for c in ("fl", "fr", "rl", "rr")} < set(found)
    assert found["vehicle_speed"] == ("ID_D1", "SPEED", "m/s")
    one = config.signals["acceleration_longitudinal"]
    assert (one.signal, one.sign) == ("ACCEL_LONG", -1)
    assert one.scale == pytest.approx(2 / 3, rel=0.05)
    assert found["primary_pressure"] == ("ID_D1", "BRAKE", "bar")
    said = " ".join(out.read_text("utf-8").replace("# ", "").split())
    assert "unit assumed from its highest value of 32" in said
    assert config.heat.mode == "ff"


@needs_recordings
def test_gt86_on_a_stand(tmp_path: Path) -> None:
    """Wheels on rollers stop too fast to tell the unit of a pressure."""
    out = tmp_path / "car.toml"

    config = proposed(
        out,
        real("subaru-wrx-sti-candump", "sample_can_spec.dbc"),
        real("gt86-on-stand-candump", "vsslog.log"),
    )

    assert "primary_pressure" not in sources(config)
    assert "# [signals.primary_pressure]" in out.read_text("utf-8")


@needs_recordings
def test_toyota(tmp_path: Path) -> None:
    """BRAKE_PRESSURE is a neighbouring flag; can1 is another bus."""
    folder = "toyota-rav4-comma2k19"
    out = tmp_path / "car.toml"

    config = proposed(
        out,
        real(folder, "toyota_new_mc_pt_generated.dbc"),
        real(folder, "rav4_bus0_bus1.converted.candump.log"),
    )

    found = sources(config)
    text = out.read_text("utf-8")
    assert {f"wheel_speed_{c}" for c in ("fl", "fr", "rl", "rr")} < set(found)
    one = config.signals["acceleration_longitudinal"]
    assert (one.signal, one.sign, one.scale) == ("ACCEL_X", -1, 1.0)
    assert not any("pressure" in role for role in found)
    assert "takes only 2 values up to 256" in " ".join(text.split())
    assert config.bus[0].channel == "can0"
    assert not config.bus[0].strict
    assert "Interface can1 was left out" in text


@needs_recordings
@pytest.mark.parametrize("with_logs", [True, False])
def test_uwfe(tmp_path: Path, capsys: Capture, *, with_logs: bool) -> None:
    """29-bit ids, psi; the front wheels' sensors read 0 throughout."""
    folder = "uwfe-fsae-ev-can"
    logs = [
        real(folder, f"{name}.converted.candump.log")
        for name in ("NewMotor_LOGS91_LOGS0", "PostMichigan_LOGS30_LOGS0")
    ]
    out = tmp_path / "car.toml"

    config = proposed(
        out, real(folder, "2024CAR.dbc"), *(logs if with_logs else [])
    )

    found = sources(config)
    said = capsys.readouterr().out
    assert found["primary_pressure"] == (
        "VCU_Data",
        "FrontBrakePressure",
        "psi",
    )
    assert 'signal = "RearBrakePressure"' in out.read_text("utf-8")
    assert {"wheel_speed_rl", "wheel_speed_rr"} < set(found)
    assert ("wheel_speed_fl" in found) != with_logs
    assert "StateContactorPositive" in said
    assert "StateContactorNegative" in said
    assert not config.bus[0].strict
