"""``bstm match`` and ``bstm verify`` from log to file and verdict."""

from __future__ import annotations

import json
import shutil
from html import unescape
from pathlib import Path

import pytest

from bstm_daemon.analysis.gap.heat_only import learned_forces
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.drives import read_drives
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.simulation import Effects, simulate
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.recorder import Encoder, write_candump

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"

pytestmark = [pytest.mark.slow] if load_kernel() is None else []

DRIVE = """
[drive]
name = "own"
description = "a drag, three speeds, a soak"
ambient_c = 15.0
propulsion = "engine"
thermocouple_logger = true

[[segment]]
speed_kmh = 40.0
rate_ms2 = 1.5
gear = 3
duration_s = 500.0
grade_percent = -10.0

[[segment]]
speed_kmh = 70.0
rate_ms2 = 1.5
gear = 4
duration_s = 90.0

[[segment]]
speed_kmh = 120.0
rate_ms2 = 1.5
gear = 4
duration_s = 60.0

[[segment]]
speed_kmh = 0.0
rate_ms2 = 6.0
gear = 0

[[segment]]
parked = true
duration_s = 2400.0
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("match") / "own.log"
    driven = simulate(parse_drive(DRIVE, "own.toml"), sensors="n1", seed=2)
    write_candump(path, driven, Encoder(ROOT / "dbc" / "example_vehicle.dbc"))
    return path


@pytest.fixture(scope="module")
def matched(log: Path) -> Path:
    """Return the folder with the matched car, its JSON and its page."""
    folder = log.parent
    code = main(
        [
            *("match", str(log), "-c", str(EXAMPLE), "--plain"),
            *("-o", str(folder / "new.toml")),
            *("--json", str(folder / "match.json")),
            *("--report", str(folder / "match.html")),
        ]
    )
    assert code == 0
    return folder


@pytest.mark.slow
def test_the_matched_car_is_a_configuration_with_its_comments(
    matched: Path,
) -> None:
    text = (matched / "new.toml").read_text("utf-8")
    old = EXAMPLE.read_text("utf-8")
    config = load_config(matched / "new.toml")

    value = config.thermal.fluid_static_convection_w_k
    line = next(
        one
        for one in text.splitlines()
        if one.startswith("fluid_static_convection_w_k")
    )
    assert f"= {value}" in line
    assert "matched, own.log, 20" in line
    assert ", sd " in line
    assert "was 0.944" in line
    comments = [one for one in old.splitlines() if one.startswith("#")]
    assert set(comments) <= set(text.splitlines())
    assert config.accuracy.fluid_k is not None


@pytest.mark.slow
def test_what_its_forces_showed_is_handed_on(matched: Path, log: Path) -> None:
    vehicle = load_vehicle(matched / "new.toml")
    recording = read_recording(log, *vehicle)

    wanted = learned_forces(vehicle[0], [recording])

    (known,) = vehicle[0].matched
    assert {"hydraulic_lag", "torque lag", "pitch"} <= known.forces.keys()
    assert "mass_error" not in known.forces
    strengths = {name: a for name, (a, _) in wanted.items()}
    assert known.forces == pytest.approx(strengths, abs=0.02)
    deviations = {name: sd for name, (_, sd) in wanted.items()}
    assert known.forces_sd == pytest.approx(deviations, abs=0.02)


@pytest.mark.slow
def test_the_rear_corners_keep_their_own_values(matched: Path) -> None:
    """They have no thermocouples, and keys of their own."""
    before, after = load_config(EXAMPLE), load_config(matched / "new.toml")

    for corner in (2, 3):
        old = before.thermal_of(before.corner[corner])
        assert after.thermal_of(after.corner[corner]) == old


@pytest.mark.slow
def test_json_has_what_the_screen_says(matched: Path) -> None:
    data = json.loads((matched / "match.json").read_text("utf-8"))

    (front,) = data["corners"]
    assert front["corners"] == ["FL", "FR"]
    assert front["joint"]["free_values"] == 12
    assert front["table_4_1"]["free_values"] == 9
    assert len(front["joint"]["covariance"]) == 12
    assert front["held_out_drives"] == 0
    # a single drive: its last third
    assert front["left_out"].startswith("own.log from ")
    assert set(front["held_out_before_k"]) == set(front["held_out_rms_k"])
    assert front["verdict"] == []
    partition = next(
        one for one in front["stages"] if one["title"] == "heat partition"
    )
    assert partition["left_out"] is None
    assert "steps" not in data


@pytest.mark.slow
def test_the_page_has_figure_5_2(matched: Path) -> None:
    page = (matched / "match.html").read_text("utf-8")

    assert "thesis figure 5.2" in page
    assert "matched minus measured" in page


@pytest.mark.slow
def test_the_matched_car_is_verified(
    matched: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(
        [
            *("verify", str(log), "-c", str(matched / "new.toml")),
            *("--require", "floor", "--json", str(matched / "verify.json")),
            *("--report", str(matched / "verify.html")),
            *("--matched-on", str(log)),
        ]
    )

    assert code == 0
    assert "NOT MET" not in _lines(capsys.readouterr().out, "floor")
    data = json.loads((matched / "verify.json").read_text("utf-8"))
    assert data["passed"] is True
    assert data["counted"] > 0
    baseline = [v for v in data["verdicts"] if v["limits"] == "baseline"]
    assert [(v["corner"], v["requirement"]) for v in baseline] == [
        (corner, f"disc, RMS [K], {rival}")
        for corner in ("FL", "FR")
        for rival in (
            "disc of one node fitted to others + 1 K",
            "disc and hat fitted to others + 1 K",
            "3 x disc of one node fitted to it + 1 K",
        )
    ]
    assert baseline[2]["limit"] - 1.0 == pytest.approx(
        3 * (baseline[0]["limit"] - 1.0)
    )
    assert "figures 5.2, 6.4 to 6.7" in (matched / "verify.html").read_text(
        "utf-8"
    )


def test_a_wrong_car_fails(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A fluid that never cools is not within 30 K."""
    text = EXAMPLE.read_text("utf-8").replace(
        "fluid_caliper_thermal_capacity_j_k = 2373.0",
        "fluid_caliper_thermal_capacity_j_k = 700.0",
    )
    (tmp_path / "config").mkdir()
    shutil.copytree(ROOT / "dbc", tmp_path / "dbc")
    wrong = tmp_path / "config" / "wrong.toml"
    wrong.write_text(text, "utf-8")

    code = main(["verify", str(log), "-c", str(wrong)])

    assert code == 1
    assert "NOT MET" in _lines(capsys.readouterr().out, "thesis")


@pytest.mark.slow  # a second match
def test_only_cooling_writes_only_cooling(log: Path, tmp_path: Path) -> None:
    target = tmp_path / "rim.toml"

    code = main(
        [
            *("match", str(log), "-c", str(EXAMPLE), "-o", str(target)),
            *("--only", "cooling"),
        ]
    )

    assert code == 0
    before, after = load_config(EXAMPLE), load_config(target)
    changed = {
        key
        for key, value in after.thermal.model_dump().items()
        if value != getattr(before.thermal, key)
    }
    assert changed <= {
        "fluid_static_convection_w_k",
        "fluid_dynamic_convection_ws_mk",
    }
    assert after.cooling.s_per_s != before.cooling.s_per_s


@pytest.mark.full  # two matches and two searches
@pytest.mark.slow
def test_what_the_drives_hide_is_found_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pad that stays near the disc, in both drives of the match."""
    logs = []
    short = DRIVE.replace("2400.0", "1200.0")
    slower = short.replace("40.0", "55.0").replace(
        "duration_s = 90", "duration_s = 400"
    )
    for seed, text in enumerate((short, slower)):
        logs.append(tmp_path / f"{seed}.log")
        driven = simulate(
            parse_drive(text, "own.toml"),
            preset=Effects(gap_conduction=1.0),
            sensors="n1",
            seed=seed,
        )
        encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
        write_candump(logs[-1], driven, encoder)
    (tmp_path / "config").mkdir()
    shutil.copytree(ROOT / "dbc", tmp_path / "dbc")
    target = tmp_path / "config" / "new.toml"

    code = main(
        [
            *("match", *map(str, logs), "-c", str(EXAMPLE)),
            *("-o", str(target), "--json", str(tmp_path / "match.json")),
            *("--report", str(tmp_path / "match.html")),
        ]
    )

    out = capsys.readouterr().out
    data = json.loads((tmp_path / "match.json").read_text("utf-8"))
    first, *_, last = data["steps"]
    assert (first["added"], first["kept"]) == ("gap_conduction", True)
    for node in ("fluid", "pad_front", "pad_back"):
        before_k = first["held_out_before_k"][node]
        assert first["held_out_after_k"][node] < 0.5 * before_k
    assert last["answer"] == "nothing"
    assert code == 0
    assert data["corners"][0]["verdict"] == []
    (effect,) = load_config(target).effect
    assert effect.name == "gap_conduction"
    assert effect.parameters["strength"] == pytest.approx(1.0, abs=0.15)
    assert effect.provenance["source"] == "bstm match"
    (known,) = load_config(target).matched
    assert "effect.gap_conduction.strength" in known.names
    lines = [one for one in out.splitlines() if one.startswith("  step ")]
    page = unescape((tmp_path / "match.html").read_text("utf-8"))
    assert len(lines) == len(data["steps"])
    assert ": kept" in lines[0]
    assert all(one.strip() in page for one in lines)


FADE = """
[[effect]]
name = "friction_fade"
corner = "all"
parameters = { onset_c = 150.0 }
"""


@pytest.mark.full  # four matches
@pytest.mark.slow
def test_heat_is_formed_anew_with_the_matched_temperatures(
    log: Path, tmp_path: Path
) -> None:
    """A brake that fades gets the friction of the matched model."""
    car = tmp_path / "config" / "fades.toml"
    car.parent.mkdir()
    shutil.copytree(ROOT / "dbc", tmp_path / "dbc")
    car.write_text(EXAMPLE.read_text("utf-8") + FADE, "utf-8")
    config, signal_map = load_vehicle(car)

    code = main(
        [
            *("match", str(log), "-c", str(car), "--only", "cooling"),
            *("-o", str(tmp_path / "config" / "new.toml")),
        ]
    )

    assert code == 0
    by, found = config, []
    for _ in range(2):
        drives = read_drives([log], by, signal_map)
        (match,) = match_drives(
            config, [Reading(None, drives)], only="cooling", beside=False
        )
        by = match.after.config
        found.append(by.cooling_of(by.corner[0]).s_per_s)
    new = load_config(tmp_path / "config" / "new.toml")
    written = new.cooling_of(new.corner[0]).s_per_s
    assert written == pytest.approx(found[1], rel=1e-3)
    assert written != pytest.approx(found[0], rel=1e-3)


@pytest.mark.parametrize(
    ("wanted", "frames"),
    [("speed", (" 1A0#", " 1B0#")), ("pressure", (" 1A4#",))],
)
@pytest.mark.parametrize("command", ["match", "verify"])
def test_without_what_heat_is_formed_from_nothing_is_matched(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    wanted: str,
    frames: tuple[str, ...],
) -> None:
    """Without a speed the disc was off by 364 K, without a pressure by 17."""
    bare = tmp_path / "bare.log"
    lines = log.read_text("ascii").splitlines(keepends=True)[:200_000]
    bare.write_text(
        "".join(
            line for line in lines if not any(part in line for part in frames)
        ),
        "ascii",
    )

    assert main([command, str(bare), "-c", str(EXAMPLE)]) == 65
    assert f"bare.log: no {wanted} in this log" in capsys.readouterr().err


def test_a_file_that_exists_is_not_replaced(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "there.toml"
    target.write_text("mine", "utf-8")

    code = main(["match", str(log), "-c", str(EXAMPLE), "-o", str(target)])

    assert code == 2
    assert target.read_text("utf-8") == "mine"
    assert "--force" in capsys.readouterr().err


def _lines(out: str, limits: str) -> str:
    return "\n".join(
        line for line in out.splitlines() if line.startswith(limits)
    )
