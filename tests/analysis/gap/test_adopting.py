"""Effects written into a configuration."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.adopting import _provenance
from bstm_daemon.analysis.gap.fitting import FORM_ERROR, NINETY, Fit
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


def test_where_a_strength_comes_from_is_written_beside_it() -> None:
    """In the size that is written, twice that of the search."""
    comparison: Any = SimpleNamespace(
        sizes={"hub_heat": 2.0}, drive_names=("a.log", "b.log")
    )
    naming: Any = SimpleNamespace(
        candidates=[
            SimpleNamespace(name="disc_hat", log_evidence=3.0),
            SimpleNamespace(name="hub_heat", log_evidence=12.34),
        ],
        provenance={"hub_heat": {"probability": 0.99}}.get,
    )
    fit = Fit(np.zeros(1), {"hub_heat": 1.5}, {"hub_heat": 0.1234}, 0.0)
    sd = np.hypot(0.1234, 1.5 * FORM_ERROR)

    found = _provenance(comparison, fit, naming, "hub_heat")

    date = found.pop("date")
    assert len(date) == len("2026-01-31")
    assert found == {
        "source": "bstm gap",
        "data": ["a.log", "b.log"],
        "strength_sd": round(2.0 * sd, 3),
        "strength_90": [
            pytest.approx(2.0 * (1.5 + sign * NINETY * sd), abs=5e-4)
            for sign in (-1.0, 1.0)
        ],
        "probability": 0.99,
        "log_bayes_factor": 12.3,
    }
