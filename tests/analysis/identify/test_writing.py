"""Identified values in a copy of the configuration."""

from pathlib import Path

from bstm_daemon.analysis.identify.writing import Change, write_changed
from bstm_daemon.config.reading import load_config

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"

CHANGES = [
    Change("vehicle", "drag_area_m2", 0.8123456),
    Change("corner", "friction_coefficient", 0.4, "RL"),
    Change("corner", "pushout_pressure_pa", 50_000, "RR"),
    Change("heat", "primary_lag_s", 0.15),
]


def test_only_the_values_change(tmp_path: Path) -> None:
    """Every other line stays as it was, comments and layout too."""
    target = tmp_path / "new.toml"

    write_changed(EXAMPLE, target, CHANGES, "bstm identify")

    old = EXAMPLE.read_text("utf-8").splitlines()
    new = target.read_text("utf-8").splitlines()
    gone = [line for line in old if line not in new]
    came = [line for line in new if line not in old]
    assert len(gone) == 4
    assert gone[0] == "drag_area_m2 = 0.70"
    assert came[0] == "drag_area_m2 = 0.81235 # bstm identify; was 0.7"
    assert len(came) == 5
    assert any(line.startswith("dbc = ") for line in came)
    assert any(
        "was 0.38 (typical, Limpert: 0.35 to 0.42 cold)" in line
        for line in came
    )


def test_lists_and_dotted_keys(tmp_path: Path) -> None:
    """A table of one corner, and of the section that all share."""
    target = tmp_path / "new.toml"
    table = (1e-3, 2e-3, 3.123456e-3)
    changes = [
        Change("cooling", "speed_ms", (0.0, 10.0, 20.0)),
        Change("cooling", "s_per_s", table),
        *(
            Change("corner", f"cooling.{key}", numbers, corner)
            for corner in ("FR", "RL", "RR")
            for key, numbers in (
                ("speed_ms", (0.0, 10.0, 30.0)),
                ("s_per_s", table),
            )
        ),
    ]

    write_changed(EXAMPLE, target, changes, "bstm identify")

    config = load_config(target)
    assert config.cooling.s_per_s == [1e-3, 2e-3, 3.1235e-3]
    of = {c.name: config.cooling_of(c).speed_ms for c in config.corner}
    assert of["FL"] == [0.0, 10.0, 20.0]
    assert of["FR"] == of["RL"] == of["RR"] == [0.0, 10.0, 30.0]
    assert str(changes[1]) == "[cooling] s_per_s = [0.001, 0.002, 0.0031235]"


def test_the_copy_is_a_valid_configuration(tmp_path: Path) -> None:
    """In another folder as well: the path of its DBC is moved along."""
    folder = tmp_path / "deep" / "below"
    folder.mkdir(parents=True)
    target = folder / "new.toml"

    write_changed(EXAMPLE, target, CHANGES, "found")

    config = load_config(target)
    corners = {corner.name: corner for corner in config.corner}
    assert config.vehicle.drag_area_m2 == 0.81235
    assert corners["RL"].friction_coefficient == 0.4
    assert corners["RR"].pushout_pressure_pa == 50_000
    assert corners["RL"].pushout_pressure_pa == 0.0
    assert config.heat.primary_lag_s == 0.15
    assert (folder / config.bus[0].dbc).resolve().is_file()


def test_a_section_that_is_not_there_is_added(tmp_path: Path) -> None:
    source = tmp_path / "old.toml"
    source.write_text('# mine\n[vehicle]\nid = "car"\n', "utf-8")
    target = tmp_path / "new.toml"

    write_changed(source, target, CHANGES[3:], "found")

    text = target.read_text("utf-8")
    assert text.startswith('# mine\n[vehicle]\nid = "car"\n')
    assert "[heat]\nprimary_lag_s = 0.15 # found\n" in text
