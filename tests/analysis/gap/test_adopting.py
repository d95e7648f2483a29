"""Effects written into a configuration."""

from __future__ import annotations

from pathlib import Path

from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner

EXAMPLE = Path(__file__).parents[3] / "config" / "example_vehicle.toml"


def effect(strength: float) -> EffectConfig:
    return EffectConfig(
        name="gap_conduction",
        parameters={"strength": strength},
        provenance={"source": "bstm gap", "data": ["a.log"]},
    )


def test_an_effect_is_added_and_comments_stay(tmp_path: Path) -> None:
    new = tmp_path / "new.toml"

    write_changed(EXAMPLE, new, (), "", "", Entries([effect(1.234567)]))

    entry = load_config(new).effect[0]
    assert entry.name == "gap_conduction"
    assert entry.parameters == {"strength": 1.2346}
    assert entry.provenance["data"] == ["a.log"]
    old = EXAMPLE.read_text("utf-8").splitlines()
    kept = new.read_text("utf-8").splitlines()
    comments = [line for line in old if line.startswith("#")]
    assert [line for line in kept if line.startswith("#")] == comments


def test_a_namesake_is_replaced(tmp_path: Path) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"

    write_changed(EXAMPLE, first, (), "", "", Entries([effect(1.0)]))
    write_changed(first, second, (), "", "", Entries([effect(2.0)]))

    entries = load_config(second).effect
    assert [one.parameters["strength"] for one in entries] == [2.0]


def test_terms_of_a_composed_effect_are_its_parameters(tmp_path: Path) -> None:
    """Words as they are, sizes in figures: the file is valid and runs."""
    terms = {
        "disc to air, driving, above 300 degC": 4.20004,
        "fluid to air": 0.3,
    }
    one = EffectConfig(name="composed", parameters=terms)
    new = tmp_path / "new.toml"

    write_changed(EXAMPLE, new, (), "", "", Entries([one]))

    config = load_vehicle(new)[0]
    (entry,) = config.effect
    assert entry.parameters == {**terms, next(iter(terms)): 4.2}
    program = compile_corner(config, config.corner[0])
    assert set(terms) <= set(program.ledger_names)
