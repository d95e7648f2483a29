"""What matched cars of a type say of a further one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.tunables import (
    MASS,
    SLOW,
    STILL,
    TUNABLES,
    Target,
    targets_of,
)
from bstm_daemon.config.estimates import ChangeConfig, MatchedConfig
from bstm_daemon.config.reading import load_config
from bstm_daemon.fleet.learning import type_prior
from bstm_daemon.fleet.priors import write_prior

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
EMISSIVITY = "thermal.disc_emissivity"


def matched(
    folder: Path, name: str, mass: float, s_slow: float, still_sd: float = 1.0
) -> Path:
    """Write a car whose front corners were matched."""
    path = folder / f"{name}.toml"
    values = [mass, s_slow, 0.29]
    known = MatchedConfig(
        corners=["FL", "FR"],
        names=[MASS, SLOW, STILL],
        values=values,
        factor=[[0.01], [0.003, 0.02], [0.0, 0.0, still_sd]],
    )
    change = ChangeConfig(name="disc_capacity", factor=0.9)
    write_changed(EXAMPLE, path, [], "", "", Entries((), [change], [known]))
    return path


def front(path: Path) -> Target:
    return targets_of(load_config(path), ["FL", "FR"])[0]


def prior_of(values: Sequence[float], sds: Sequence[float], key: str) -> tuple:
    return type_prior(np.log(values), np.array(sds), TUNABLES[key].prior)


def test_the_next_car_begins_with_what_its_type_has(tmp_path: Path) -> None:
    masses, slow = (1.02, 1.05, 0.99, 1.03, 1.01), (2e-3, 2.2e-3, 2.1e-3)
    slow = (*slow, 1.9e-3, 2.05e-3)
    cars = [
        matched(tmp_path, f"car{i}", *pair)
        for i, pair in enumerate(zip(masses, slow, strict=True))
    ]
    out = tmp_path / "type.toml"

    assert write_prior("golf", [*cars, EXAMPLE], out) == 5

    config = load_config(out)
    assert config.matched == config.change == []
    (known,) = config.priors
    assert (known.corners, known.cars) == (["FL", "FR"], 5)
    # no match knew it, so the type has nothing to say
    assert STILL not in known.names
    mean, sd = prior_of(masses, [0.01] * 5, MASS)
    target = front(out)
    assert target.value(TUNABLES[MASS]) == pytest.approx(
        np.exp(mean), rel=1e-4
    )
    assert target.setting(SLOW) == pytest.approx(known.values[1], rel=1e-4)
    assert known.values[1] == pytest.approx(2.05e-3, rel=0.02)
    # bstm match asks the target
    assert target.tunable(MASS).prior == pytest.approx(sd, rel=1e-4)
    assert sd < 0.8 * TUNABLES[MASS].prior
    assert target.tunable(SLOW).prior < TUNABLES[SLOW].prior
    assert target.tunable(EMISSIVITY) == TUNABLES[EMISSIVITY]


def test_a_value_that_was_edited_has_the_usual_prior(tmp_path: Path) -> None:
    cars = [
        matched(tmp_path, f"car{i}", 1.0 + 0.01 * i, 2e-3) for i in range(5)
    ]
    out = tmp_path / "type.toml"
    write_prior("golf", cars, out)

    edited = front(out).changed({MASS: 1.2})

    assert edited.tunable(MASS) == TUNABLES[MASS]
    # and what nobody has measured stays wide
    guessed = Target(load_config(out), ("FL", "FR"), frozenset({MASS}))
    assert guessed.tunable(MASS).prior == 1.0


def test_one_matched_car_is_no_type(tmp_path: Path) -> None:
    car = matched(tmp_path, "car", 1.0, 2e-3)
    out = tmp_path / "type.toml"

    assert write_prior("golf", [car, EXAMPLE], out) == 0
    assert write_prior("golf", [], out) == 0
    assert not out.exists()
