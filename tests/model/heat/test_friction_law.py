"""The law mu(T, p, v): its tables, and that both forms use them alike."""

from __future__ import annotations

from math import exp, nan
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.model.heat.friction_law import (
    LAW_POINTS,
    FrictionLaw,
    friction_factor,
)
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.roles import ROLE_INDEX

from .conftest import STEP_US, Run

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config
    from bstm_daemon.native.loader import Kernel

FADE = FrictionLaw.of(
    temperature_k=lambda t: 1.0 - 0.3 / (1.0 + exp((700.0 - t) / 45.0))
)
RHEE = FrictionLaw.of(
    pressure_pa=lambda p: (max(p, 1e5) / 1e6) ** -0.05,
    speed_ms=lambda v: (max(v, 1.0) / 10.0) ** -0.1,
)


def test_factors_between_and_beyond_the_points() -> None:
    law = FrictionLaw.of(
        temperature_k=lambda t: 2.0 - t / 1000.0, speed_ms=lambda v: 1.0 + v
    ).numbers()

    assert friction_factor(law, 513.0, 0.0, 0.0) == pytest.approx(1.487)
    assert friction_factor(law, 9999.0, 0.0, 2.5) == pytest.approx(0.2 * 3.5)
    assert friction_factor(law, 1.0, 0.0, 0.0) == pytest.approx(1.8)
    assert friction_factor(law, 0.0, 1e9, 999.0) == pytest.approx(81.0)


@given(st.floats(1.0, 2000.0), st.floats(0.0, 3e7), st.floats(0.0, 100.0))
def test_laws_multiply(t: float, p: float, v: float) -> None:
    both = friction_factor(FADE.times(RHEE).numbers(), t, p, v)
    apart = friction_factor(FADE.numbers(), t, p, v) * friction_factor(
        RHEE.numbers(), t, p, v
    )

    assert both == pytest.approx(apart)
    assert FrictionLaw().nominal
    assert not FADE.nominal


@pytest.mark.parametrize("factor", [0.0, -1.0, nan, float("inf")])
def test_no_friction_is_refused(factor: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        FrictionLaw.of(speed_ms=lambda _: factor)
    with pytest.raises(ValueError, match=str(LAW_POINTS)):
        FrictionLaw(speed=(1.0,))


def braked(
    config: Config,
    kernel: Kernel | None,
    law: FrictionLaw | None,
    disc_k: float = 0.0,
) -> Run:
    """Return 2 s at 20 m/s and 40 bar, with *law* on the first corner."""
    roles = ("vehicle_speed", "primary_pressure")
    laws = {} if law is None else {config.corner[0].name: law}
    present = {ROLE_INDEX[role]: 500_000 for role in roles}
    run = Run(plan_samples(config, present, STEP_US, laws=laws), kernel)
    corners = len(config.corner)
    for corner in range(corners):
        run.state.heat_interface(corner, disc_k)
        assert run.state.interface_k(corner) == disc_k
    return run.feed(
        [
            (at, role, value)
            for at in range(0, 2_000_000, 10_000)
            for role, value in zip(roles, (20.0, 40e5), strict=True)
        ]
    )


@pytest.mark.parametrize("mode", ["ff", "fused"])
def test_a_law_scales_what_pressure_gives(
    compiled: Kernel,
    make_car: Any,
    make_corner: Callable[..., Any],
    mode: str,
) -> None:
    """Of its corner, by the same bits in both forms."""
    car = make_car(
        *(make_corner(name) for name in ("FL", "FR")), heat={"mode": mode}
    )
    law = FADE.times(RHEE)
    plain = braked(car, compiled, None, 800.0)
    found = braked(car, compiled, law, 800.0)
    factor = friction_factor(law.numbers(), 800.0, 40e5, 20.0)

    assert 0.5 < factor < 0.75
    for corner, by in ((0, factor), (1, 1.0)):
        (energy, own) = (
            run.column("brake_energy_ff_j", corner)[-1]
            for run in (plain, found)
        )
        assert own == pytest.approx(by * energy)
    assert braked(car, None, law, 800.0).bits() == found.bits()


def test_an_unknown_temperature_gives_no_factor(
    compiled: Kernel, make_car: Any
) -> None:
    car = make_car()
    powers = [
        braked(car, compiled, law).column("brake_power_w")
        for law in (FADE, None)
    ]

    assert powers[0] == powers[1]
