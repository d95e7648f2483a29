"""Drives made by the model with effects, so that what is missing is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pytest

from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.recording import Packed, Recording
from bstm_daemon.bus.signals.columns import Events

from ...made_drives import driven, effect_entries  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.config.sections import Config

PROFILE: Final = (
    (10.0, 6000.0, 700.0),
    (10.0, 0.0, 120.0),
    (36.0, 0.0, 200.0),
    (25.0, 20000.0, 30.0),
    (14.0, 5000.0, 400.0),
    (0.0, 0.0, 1800.0),
)


@pytest.fixture(scope="session")
def made(config: Config) -> Callable[..., Recording]:
    """Return what makes a recording of a car with effects, by strength."""

    def make(
        effects: Mapping[str, float] | None = None,
        name: str = "made",
        *,
        noise_k: float = 0.5,
        seed: int = 1,
        of: Config | None = None,
    ) -> Recording:
        on = effect_entries(dict(effects or {}))
        real = with_effects(of or config, on)
        drive = driven(
            real, name, PROFILE, every=2, noise_k=noise_k, seed=seed
        )
        none = Events(
            np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0)
        )  # fmt: skip
        return Recording(drive, {}, Packed(none), drive.inputs)

    return make
