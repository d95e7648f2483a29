"""Corners matched together, and whose linings are alike."""

from types import SimpleNamespace
from typing import Any

import pytest

from bstm_daemon.analysis.matching.targets import measured_targets, targets_of
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import LogError
from bstm_daemon.files import shipped_file


def test_alike_corners_are_matched_together(config: Config) -> None:
    found = targets_of(config, ["FL", "FR", "RL"])

    assert [one.corners for one in found] == [("FL", "FR"), ("RL",)]


def test_or_each_by_itself(config: Config) -> None:
    found = targets_of(config, ["FL", "FR"], each=True)

    assert [one.corners for one in found] == [("FL",), ("FR",)]


def test_a_corner_like_a_measured_one_is_alike(config: Config) -> None:
    """Of the same axle, on whatever circuit; by itself no corner is."""
    left, right, *rear = config.corner
    assert [one.name for one in config.corner] == ["FL", "FR", "RL", "RR"]
    diagonal = right.model_copy(update={"circuit": "secondary"})
    same = [left.model_copy(update={"name": one.name}) for one in rear]
    config = config.model_copy(update={"corner": [left, diagonal, *same]})

    def alike(*measured: str, each: bool = False) -> list[tuple[str, ...]]:
        return [one.alike for one in targets_of(config, measured, each=each)]

    assert alike("FL") == [("FR",)]
    assert alike("FR") == [("FL",)]
    assert alike("FL", "FR") == [()]
    assert alike("FL", each=True) == [()]
    thicker = right.model_copy(
        update={"pad": right.pad.model_copy(update={"thickness_m": 0.02})}
    )
    config = config.model_copy(update={"corner": [left, thicker, *rear]})
    assert alike("FL") == [()]


def test_drives_without_a_thermocouple_are_refused() -> None:
    """The message names the drives and what they lack."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    drives: Any = [
        SimpleNamespace(name=name, measured={}) for name in ("one", "two")
    ]
    with pytest.raises(
        LogError, match=r"^one, two: .* roles temp_<corner>_<node>$"
    ):
        measured_targets(config, drives)


def test_corners_without_thermocouples_have_linings_of_a_measured_one(
    config: Config,
) -> None:
    """Of their axle first; each corner's linings are those of one target."""

    def linings(*measured: str, each: bool = False) -> list[tuple[str, ...]]:
        found = targets_of(config, measured, each=each)
        return [one.linings for one in found]

    every = tuple(corner.name for corner in config.disc_corners())
    assert every == ("FL", "FR", "RL", "RR")
    assert linings("FL") == [every]
    assert linings("RR") == [every]
    assert linings("FL", "FR") == [every]
    assert linings("FR", "RL") == [("FL", "FR"), ("RL", "RR")]
    assert linings("FL", "FR", each=True) == [("FL", "RL", "RR"), ("FR",)]


def test_linings_that_fade_otherwise_are_others(config: Config) -> None:
    effects = [
        EffectConfig(
            name="friction_fade", corner=corner, parameters={"strength": fade}
        )
        for corner, fade in (("FL", 0.5), ("FR", 0.5), ("RL", 1.0))
    ]
    other = config.model_copy(update={"effect": effects})

    (found,) = targets_of(other, ["FL"])

    assert found.linings == ("FL", "FR")
