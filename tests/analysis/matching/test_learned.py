"""What a match hands on through the configuration file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.changes import learned
from bstm_daemon.analysis.matching.learned import (
    DAY_TO_DAY,
    known_covariance,
    known_keys,
    settings_of,
)
from bstm_daemon.analysis.matching.refine import NodeAccuracy
from bstm_daemon.analysis.matching.tunables import (
    BEYOND_MS,
    MASS,
    SLOW,
    TUNABLES,
    Target,
)
from bstm_daemon.config.reading import load_config

if TYPE_CHECKING:
    from bstm_daemon.config.estimates import MatchedConfig

EXAMPLE = Path(__file__).parents[3] / "config" / "example_vehicle.toml"
KEYS = (MASS, "thermal.disc_emissivity", SLOW)
PRIOR = np.array([0.08, 0.2, 0.2])
COVARIANCE = np.array(
    [[1e-4, 4e-4, 0.0], [4e-4, 2.5e-3, 1e-3], [0.0, 1e-3, 1e-2]]
)


def table(
    target: Target, *, misfit: float = 1.0, shifts: Any = ()
) -> MatchedConfig:
    """Return what a match of three values learned."""
    match: Any = SimpleNamespace(
        joint=SimpleNamespace(
            keys=KEYS, covariance=COVARIANCE, prior=PRIOR, misfit=misfit
        ),
        accuracy=SimpleNamespace(shifts=np.array(shifts), left_out="a"),
        after=target,
        corners=target.corners,
        drives=[0, 1],
        form={"disc": NodeAccuracy(3.0, 0.01)},
    )
    return learned(match)


def with_table(target: Target, one: MatchedConfig) -> Target:
    config = target.config.model_copy(update={"matched": [one]})
    return replace(target, config=config)


def test_values_and_covariance_go_through_the_file(
    target: Target, tmp_path: Path
) -> None:
    new = tmp_path / "new.toml"

    write_changed(EXAMPLE, new, (), "", "", Entries(matched=[table(target)]))
    read = load_config(new)
    there = Target(read, target.corners)

    assert known_keys(there)[:3] == list(KEYS)
    found = known_covariance(there, KEYS) - DAY_TO_DAY**2 * np.eye(3)
    assert found == pytest.approx(COVARIANCE, rel=1e-3, abs=1e-7)
    one = read.matched_of("FL")
    assert one is not None
    assert one.form_k == {"disc": 3.0}
    assert one.drives == 2
    assert one.values[2] == pytest.approx(target.setting(SLOW), rel=1e-4)
    again = tmp_path / "again.toml"
    write_changed(new, again, (), "", "", Entries(matched=[one]))
    assert load_config(again).matched == [one]


def test_an_edited_value_counts_as_never_matched(target: Target) -> None:
    there = with_table(target, table(target))
    edited = there.changed({MASS: 1.02 * target.setting(MASS)})

    found = known_covariance(edited, KEYS)

    assert found[0].tolist() == [pytest.approx(0.08**2), 0.0, 0.0]
    kept = known_covariance(there, KEYS)
    assert found[1:, 1:].tolist() == kept[1:, 1:].tolist()


def test_what_the_form_shifts_widens_and_the_prior_is_the_most(
    target: Target,
) -> None:
    """Values that move when a drive is left out are known less well."""
    shifts = [[0.02, 0.0, 0.9], [-0.02, 0.0, -0.9]]

    there = with_table(target, table(target, misfit=2.0, shifts=shifts))
    found = np.diag(known_covariance(there, KEYS)) - DAY_TO_DAY**2

    wanted = [2e-4 + 4e-4, 5e-3, PRIOR[2] ** 2]
    assert found == pytest.approx(wanted, rel=1e-3)


def test_what_was_not_fitted_stays_as_known_as_it_was(target: Target) -> None:
    """As after another rim, when only the cooling is matched."""
    still = "cooling.standstill_convection_fraction"
    plain = table(target)
    place = plain.names.index(still)
    assert plain.factor[place][place] == pytest.approx(
        TUNABLES[still].prior, rel=1e-4
    )
    known = plain.model_copy(
        update={
            "factor": [
                [*row[:-1], 0.05 if i == place else row[-1]]
                for i, row in enumerate(plain.factor)
            ]
        }
    )

    again = table(with_table(target, known))

    assert again.names == plain.names
    assert again.factor[place][place] == pytest.approx(
        np.hypot(0.05, DAY_TO_DAY), rel=1e-4
    )
    assert again.factor[:3] == plain.factor[:3]


def test_a_key_of_another_version_is_left_out(target: Target) -> None:
    one = table(target)
    other = one.model_copy(update={"names": ["of.later", *one.names[1:]]})

    assert known_keys(with_table(target, other)) == one.names[1:]


def test_a_table_that_got_further_speeds_is_written_with_them(
    target: Target,
) -> None:
    further = next(iter(BEYOND_MS))
    slow, fast = ({key: 1.2} for key in (SLOW, further))

    with_slow = settings_of(target, target.changed(slow), slow)
    with_both = settings_of(target, target.changed(fast), fast | {MASS: 1.1})

    changed = target.changed(fast)
    table = changed.config.cooling_of(changed.corner)
    assert set(with_slow) == {"cooling.s_per_s"}
    assert with_both == {
        MASS: 1.1,
        "cooling.speed_ms": tuple(table.speed_ms),
        "cooling.s_per_s": tuple(table.s_per_s),
    }
    assert BEYOND_MS[further] in table.speed_ms
