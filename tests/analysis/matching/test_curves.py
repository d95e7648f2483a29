"""Measured and modelled temperatures of a match."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.matching.curves import curves_of
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from tests.made_drives import EXAMPLE, driven


def test_a_match_that_added_an_edge_has_curves() -> None:
    """The drive is that of the model after it, which the curves show."""
    before = load_config(EXAMPLE)
    added = EffectConfig(name="contact_conductance", parameters={})
    after = before.model_copy(update={"effect": [added]})
    profile = ((20.0, 0.0, 5.0), (20.0, 30e3, 30.0), (20.0, 0.0, 60.0))
    drive = driven(after, "made", profile, every=1)
    match: Any = SimpleNamespace(
        before=SimpleNamespace(config=before, corner=before.corner[0]),
        after=SimpleNamespace(config=after, corner=after.corner[0]),
    )

    found = {one.couple: one for one in curves_of(match, drive, "FL")}

    assert list(found) == ["disc", "pad_front", "pad_back", "fluid"]
    for one in found.values():
        assert one.after_c == pytest.approx(one.measured_c, abs=0.01)
    face = found["pad_front"]
    assert np.abs(face.before_c - face.after_c).max() > 1.0


def test_a_corner_without_thermocouples_has_none() -> None:
    config = load_config(EXAMPLE)
    drive = driven(config, "made", ((20.0, 0.0, 5.0),), every=1, nodes=())
    one = SimpleNamespace(config=config, corner=config.corner[0])
    match: Any = SimpleNamespace(before=one, after=one)

    assert curves_of(match, drive, "FL") == []
