"""A new effect is one class in one file: found, applied and searched for."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.signatures import candidates
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.model.effects import entries
from bstm_daemon.model.effects.catalogue import (
    effect_class,
    effect_names,
    problems_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "new-effect.md"
EXAMPLE = ROOT / "config" / "example_vehicle.toml"


def forget() -> None:
    effect_names.cache_clear()
    effect_class.cache_clear()


@pytest.fixture
def rim_fan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Put the effect of the page into a folder of entries."""
    block = re.search(
        r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL
    )
    assert block is not None
    lines = block[1].splitlines()
    text = "\n".join(line.removeprefix("   ") for line in lines)
    (tmp_path / "rim_fan.py").write_text(text + "\n", encoding="utf-8")
    folders = [*entries.__path__, str(tmp_path)]
    monkeypatch.setattr(entries, "__path__", folders)
    # files are looked for once in a process
    forget()
    yield "rim_fan"
    monkeypatch.undo()
    forget()
    sys.modules.pop(f"{entries.__name__}.rim_fan", None)


def test_one_file_makes_it_known_everywhere(rim_fan: str) -> None:
    config = load_vehicle(EXAMPLE)[0]

    assert rim_fan in effect_names()
    assert effect_class(rim_fan).__name__ == "RimFan"
    assert effect_class(rim_fan).number == 99
    assert rim_fan in candidates(config)


def test_it_is_checked_and_applied(rim_fan: str) -> None:
    config = load_vehicle(EXAMPLE)[0]
    entry = EffectConfig(
        name=rim_fan, parameters={"strength": 1.0, "loss_ws_mk": 0.2}
    )
    wrong = EffectConfig(name=rim_fan, parameters={"loss_ws_mk": 50.0})

    plain = corner_model(config, config.corner[0]).network
    fanned = with_effects(config, [entry])
    network = corner_model(fanned, fanned.corner[0]).network

    assert problems_of([entry]) == []
    assert "loss_ws_mk" in problems_of([wrong])[0]
    added = {one.name for one in network.links} - {
        one.name for one in plain.links
    }
    assert added == {"rim_fan"}


def test_without_the_file_it_is_unknown() -> None:
    assert "rim_fan" not in effect_names()
    with pytest.raises(KeyError):
        effect_class("rim_fan")
