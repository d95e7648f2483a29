"""Drives made by the model itself, so that the right values are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import pytest

from bstm_daemon.analysis.matching.drives import GRID_S

from ...made_drives import (  # noqa: TID252  (tests are no package)
    NODES,
    Profile,
    driven,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target

PROFILE: Final = (
    (10.0, 0.0, 20.0),
    (10.0, 6000.0, 700.0),
    (10.0, 0.0, 120.0),
    (20.0, 0.0, 120.0),
    (36.0, 0.0, 120.0),
    (25.0, 20000.0, 30.0),
    (14.0, 5000.0, 400.0),
    (0.0, 0.0, 2700.0),
)


@pytest.fixture(scope="session")
def made(target: Target) -> Callable[..., Drive]:
    """Return what makes a drive with the model's own temperatures."""

    def make(
        values: Mapping[str, float] | None = None,
        name: str = "made",
        *,
        profile: Profile = PROFILE,
        nodes: tuple[str, ...] = NODES,
        noise_k: float = 0.0,
        seed: int = 1,
        scale: float = 1.0,
        target: Target = target,
    ) -> Drive:
        right = target.changed(dict(values or {}))
        return driven(
            right.config,
            name,
            profile,
            every=round(1.0 / GRID_S),
            nodes=nodes,
            noise_k=noise_k,
            seed=seed,
            scale=scale,
        )

    return make
