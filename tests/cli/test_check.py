"""``bstm check``: what it prints, what it finds, how it ends."""

import json
from pathlib import Path

import pytest

from bstm_daemon.cli.check import problems_of, summary
from bstm_daemon.cli.main import main
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "config").glob("*.toml"))
SUBARU = ROOT / "config" / "subaru_wrx_sti.toml"
SUBARU_DBC = ROOT / "dbc" / "third_party" / "subaru_wrx_sti"
DBC_KEY = 'dbc = "../dbc/third_party/subaru_wrx_sti/sample_can_spec.dbc"'


@pytest.fixture
def edited(tmp_path: Path) -> "Edited":
    """Return a maker of files like the Subaru's with one thing changed."""
    return Edited(tmp_path)


class Edited:
    """Writes the Subaru's configuration with replacements."""

    def __init__(self, folder: Path) -> None:
        """Write into *folder*."""
        self.folder = folder

    def __call__(self, *changes: tuple[str, str]) -> Path:
        """Replace each (old, new) and return the path of the file."""
        text = SUBARU.read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        dbc = (SUBARU_DBC / "sample_can_spec.dbc").as_posix()
        path = self.folder / "car.toml"
        path.write_text(text.replace(DBC_KEY, f'dbc = "{dbc}"'), "utf-8")
        return path


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_files_pass(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each file under config/ fits its DBC; exit code 0."""
    code = main(["check", str(path)])

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert out.startswith(f"{path}: no problems\n")


def test_summary_names_sources_and_corners(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The summary shows what the model will do with which signals."""
    main(["check", "-c", str(SUBARU)])

    lines = [
        " ".join(line.split()) for line in capsys.readouterr().out.splitlines()
    ]
    assert "heat ff, from brake pressure and friction" in lines
    assert "publish listen only, nothing is sent" in lines
    assert "primary_pressure ID_D1.BRAKE bar 0.5 s" in lines
    assert "park_brake ID_154.EBRAKE bool 5 s" in lines
    assert (
        "FL disc primary 3 x 9.2 cm2 8 kg grey-iron 10 mm, 10 slabs" in lines
    )
    assert (
        "pressure FL FR RL RR nothing: unverified, its corners are degraded"
        in lines
    )


def test_summary_says_what_is_assumed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A torque that is assumed and not measured is called so."""
    main(["check", str(ROOT / "config" / "toyota_rav4.toml")])

    assert "ASSUMED: powertrain torque 0 Nm" in capsys.readouterr().out


def test_flat_road_is_said(
    edited: Edited, capsys: pytest.CaptureFixture[str]
) -> None:
    """Feed-Back without an accelerometer knows no grade, and says so."""
    path = edited(
        ('mode = "auto"', 'mode = "fb"\nassume_powertrain_torque_nm = 0.0'),
        ("[signals.acceleration_longitudinal]", "[signals.pitch]"),
        ('unit = "m/s2"\nscale', 'unit = "rad"\nscale'),
    )

    assert main(["check", str(path)]) == 0
    assert "the road is assumed flat" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        (
            'signal = "BRAKE"',
            'signal = "BRAKES"',
            ["[signals.primary_pressure] signal", "BRAKES", "BRAKE"],
        ),
        (
            'message = "ID_D1"\nsignal = "BRAKE"',
            'message = "ID_D9"\nsignal = "BRAKE"',
            ["[signals.primary_pressure] message", "ID_D9"],
        ),
        (
            'signal = "BRAKE"',
            'expression = "BRAKE +* 2"',
            ["[signals.primary_pressure] expression", "BRAKE +* 2"],
        ),
        (DBC_KEY, 'dbc = "none.dbc"', ["[[bus]]", "none.dbc"]),
        (
            DBC_KEY,
            f'dbc = "{(SUBARU_DBC / "LICENSE").as_posix()}"',
            ["[[bus]]", "LICENSE", "not a DBC"],
        ),
        (
            "[heat]",
            '[[effect]]\nname = "disk_wear"\n\n[heat]',
            ["[[effect]]", "disk_wear"],
        ),
    ],
    ids=[
        "signal not in DBC",
        "message not in DBC",
        "expression",
        "DBC missing",
        "DBC unreadable",
        "effect unknown",
    ],
)
def test_problem_outside_the_file(
    edited: Edited,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
    parts: list[str],
) -> None:
    """DBC and effect problems name file, section and value; exit code 78."""
    path = edited((old, new))

    code = main(["check", str(path)])

    out, err = capsys.readouterr()
    assert (code, out) == (78, "")
    first = err.splitlines()[0]
    assert first.startswith(f"{path}: ")
    assert all(part in first for part in parts)


def test_everything_is_found_at_once(
    edited: Edited, capsys: pytest.CaptureFixture[str]
) -> None:
    """One run finds problems of the file, of its DBC and of its effects."""
    path = edited(
        ("mass_kg = 1640.0", "mass_kg = -3"),
        ('signal = "SPEED"', 'signal = "SPED"'),
        ('unit = "bar"', 'unit = "Nm"'),
        ("[heat]", '[[effect]]\nname = "disk_wear"\n\n[heat]'),
    )

    code = main(["check", str(path)])

    *lines, count = capsys.readouterr().err.splitlines()
    sections = [line.removeprefix(f"{path}: ").split(" ")[0] for line in lines]
    assert code == 78
    assert count == "4 problems"
    assert sections == [
        "[vehicle]",
        "[signals.primary_pressure]",
        "[signals.vehicle_speed]",
        "[[effect]]",
    ]


def test_broken_bus_does_not_blame_its_signals(edited: Edited) -> None:
    """With the bus unusable, only the bus is reported."""
    (line,) = problems_of(edited(("bitrate = 500000", "bitrate = -1")))

    assert "[[bus]] chassis bitrate = -1" in line


def test_model_that_cannot_be_built(edited: Edited) -> None:
    """A form of the model that does not exist is named, corner by corner."""
    lines = problems_of(
        edited(("[fluid]", '[thermal]\nfluid_model = "lmp"\n\n[fluid]'))
    )

    assert len(lines) == 4
    assert all(
        "thermal.fluid_model" in line and "lmp" in line for line in lines
    )


def test_json_of_a_good_file(tmp_path: Path) -> None:
    """The JSON result holds the configuration with all defaults."""
    result = tmp_path / "result.json"

    assert main(["check", str(SUBARU), "--json", str(result)]) == 0

    data = json.loads(result.read_text(encoding="utf-8"))
    assert data["file"] == str(SUBARU)
    assert data["problems"] == []
    assert data["configuration"]["vehicle"]["mass_kg"] == 1640.0
    assert data["configuration"]["cooling"]["blend_end_ms"] == 5.0
    assert data["verified_by"][0] == {
        "input": "speed",
        "corners": "FL FR RL RR",
        "verified by": "other speeds and acceleration",
    }


def test_json_of_a_bad_file(edited: Edited, tmp_path: Path) -> None:
    """The JSON result lists the problems, and the exit code is still 78."""
    result = tmp_path / "result.json"
    path = edited(("mass_kg = 1640.0", "mass_kg = -3"))

    assert main(["check", str(path), "--json", str(result)]) == 78

    data = json.loads(result.read_text(encoding="utf-8"))
    assert data == {
        "file": str(path),
        "problems": [
            f"{path}: [vehicle] mass_kg = -3: must be from 100 to 60000"
        ],
    }


def test_json_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A result that has no place to go is an access error."""
    result = tmp_path / "none" / "result.json"

    assert main(["check", str(SUBARU), "--json", str(result)]) == 74
    assert f"{result}: cannot be written" in capsys.readouterr().err


def test_missing_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A missing configuration is exit code 74."""
    path = tmp_path / "none.toml"

    assert main(["check", str(path)]) == 74
    assert str(path) in capsys.readouterr().err


def test_syntax_error(
    edited: Edited, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file that is no TOML is exit code 78 with line and column."""
    path = edited(("mass_kg = 1640.0", "mass_kg 1640.0"))

    assert main(["check", str(path)]) == 78
    assert f"{path}: line " in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [[], ["a.toml", "-c", "b.toml"], ["a.toml", "b.toml"]]
)
def test_needs_one_configuration(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """None or two configurations are a usage error."""
    assert main(["check", *arguments]) == 2
    assert capsys.readouterr().err


def test_own_ids_must_not_be_those_that_are_read(edited: Edited) -> None:
    """Publishing on an id of the car would feed on itself."""
    path = edited(
        ("[fluid]", "[publish]\nenabled = true\nid_base = 0xCE\n\n[fluid]")
    )

    assert any(
        "the id 0xD1 of message" in problem for problem in problems_of(path)
    )


def test_an_effect_that_does_not_fit_the_parts(edited: Edited) -> None:
    """What a replay would refuse is found by the check."""
    model = (
        'fluid_model = "bstm_daemon.model.thermal.brake_corner:lumped_disc"'
    )
    path = edited(("[fluid]", f"[thermal]\n{model}\n\n[fluid]"))

    assert problems_of(path)


def test_summary_names_structure_and_effects() -> None:
    """What the base model holds, and what the file adds at which strength."""
    path = ROOT / "config" / "example_vehicle.toml"
    config = load_config(path)
    effect = EffectConfig(name="wet_disc", parameters={"strength": 0.5})
    thermal = config.thermal.model_copy(update={"structure": "extended"})
    edited = config.model_copy(update={"thermal": thermal, "effect": [effect]})

    assert "effects  structure thesis\n" in summary(config, path)
    assert (
        "effects  structure extended (11 effects), "
        "wet_disc (all, strength 0.5)\n"
    ) in summary(edited, path)
