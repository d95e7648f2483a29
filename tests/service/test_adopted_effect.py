"""What ``bstm gap`` adopts is used by the live service without more."""

from __future__ import annotations

from pathlib import Path

import pytest

from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.service.assembly import BusOverride, build_monitor

ROOT = Path(__file__).parents[2]
SECOND = 1_000_000
START_US = 1_700_000_000 * SECOND
HOT_K, AIR_K = 800.0, 290.0

pytest.importorskip("tomlkit")


def pad_after_a_minute_k(car: Path) -> float:
    """Return the pad's face beside a hot disc, parked, by the service."""
    monitor = build_monitor(car, BusOverride(), forecast=False)
    engine = monitor.engine
    for batch, names in engine.estimator.batches:
        for member, corner in enumerate(names):
            network = engine.estimator.programs[corner].network
            for i, node in enumerate(network.nodes):
                hot = node.name == "disc"
                at = member * batch.width + i
                batch.state[at] = HOT_K if hot else AIR_K
    engine.tick(START_US)
    published = engine.tick(START_US + 60 * SECOND)
    assert any(one.frame.name == "BSTM_FL_Temperatures" for one in published)
    assert engine.estimate is not None
    return engine.estimate.corners["FL"].pad_front_k


def test_the_service_uses_what_was_adopted(tmp_path: Path) -> None:
    source, target = tmp_path / "car.toml", tmp_path / "better.toml"
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    source.write_text(
        text.replace('"../dbc/', f'"{ROOT}/dbc/').replace(
            'interface = "socketcan"', 'interface = "virtual"'
        ),
        encoding="utf-8",
    )
    found = EffectConfig(
        name="gap_conduction",
        parameters={"strength": 2.0},
        provenance={"source": "bstm gap"},
    )

    write_changed(source, target, (), "", "", Entries([found]))
    before, after = map(pad_after_a_minute_k, (source, target))

    assert after > before + 20.0
