"""What a second reading takes over from the first match."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.analysis.matching import workflow
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.tunables import LEVEL, NODES_MS

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target


@pytest.mark.slow
def test_a_second_reading_has_the_table_that_the_search_found(
    target: Target, made: Callable[..., Drive]
) -> None:
    """Factors of a fit are of that table, not of the configured one."""
    drives = [
        made({LEVEL: 3.0}, name=name, noise_k=0.5, seed=seed)
        for name, seed in (("one", 1), ("two", 2))
    ]
    guessed = frozenset({LEVEL, *NODES_MS})
    (match,) = match_drives(
        target.config, [Reading(None, drives)], guessed=guessed, beside=False
    )

    config = workflow._with_values(target.config, [match])

    again = replace(target, config=config)
    assert config.cooling_of(again.corner) == match.after.config.cooling_of(
        match.after.corner
    )
    assert config.thermal_of(again.corner) == match.after.config.thermal_of(
        match.after.corner
    )
