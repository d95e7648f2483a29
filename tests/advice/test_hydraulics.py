"""A3 and A5: gradual, and below the worst-case boiling point."""

from __future__ import annotations

from math import isnan

import pytest

from bstm_daemon.advice.conditions import Conditions
from bstm_daemon.advice.hydraulics import FrontIsolation, PedalFeel
from bstm_daemon.config.estimates import AdviceConfig
from bstm_daemon.estimate import (
    CornerEstimate,
    CornerRisk,
    Isolation,
    Validity,
)

BOILING_K = 428.15


def at(
    time_s: float,
    front_k: float,
    rear_k: float = 100.0,
    speed_ms: float = 8.0,
    validity: Validity = Validity.VALID,
    **driver: float,
) -> Conditions:
    """Return conditions with margins of *front_k* and *rear_k*."""
    corners = {
        name: CornerEstimate(
            fluid_k=BOILING_K - margin_k,
            boiling_k=BOILING_K,
            validity=validity,
        )
        for name, margin_k in (("FL", front_k), ("RL", rear_k))
    }
    return Conditions(round(time_s * 1e6), corners, speed_ms, driver=driver)


def test_feel_falls_gradually_to_its_least() -> None:
    pedal = PedalFeel(AdviceConfig())
    assert pedal.update(at(0.0, 80.0)) == 1.0

    first = [pedal.update(at(i / 10, 0.0)) for i in range(1, 11)]
    last = [pedal.update(at(1 + i / 10, 0.0)) for i in range(1, 300)]

    assert first[-1] == pytest.approx(0.98)
    assert last[-1] == pytest.approx(0.5)
    assert sorted([*first, *last], reverse=True) == [*first, *last]


def test_feel_half_way() -> None:
    pedal = PedalFeel(AdviceConfig())
    for i in range(600):
        feel = pedal.update(at(i / 10, 30.0))

    assert feel == pytest.approx(0.75)


def test_feel_of_an_invalid_estimate_is_unknown() -> None:
    pedal = PedalFeel(AdviceConfig())

    assert isnan(pedal.update(at(0.0, 10.0, validity=Validity.INVALID)))


def test_isolation_keeps_the_front_below_the_worst_case() -> None:
    """On at 10 K, off at 20 K."""
    front = FrontIsolation(AdviceConfig())
    margins = (30.0, 11.0, 9.0, 15.0, 19.0, 21.0, 15.0)

    found = [front.update(at(i, k)) for i, k in enumerate(margins)]

    on = Isolation.REQUESTED
    off = Isolation.NONE
    assert found == [off, off, on, on, on, off, off]


@pytest.mark.parametrize(
    "conditions",
    [
        at(0.0, 5.0, rear_k=20.0),
        at(0.0, 5.0, speed_ms=20.0),
        at(0.0, 5.0, speed_ms=float("nan")),
        at(0.0, 5.0, abs_active=1.0),
        at(0.0, 5.0, esc_active=1.0),
        at(0.0, 5.0, validity=Validity.INVALID),
    ],
)
def test_no_isolation_where_it_would_not_be_safe(
    conditions: Conditions,
) -> None:
    """Hot rear brakes, speed, a skid, no estimate."""
    front = FrontIsolation(AdviceConfig())

    assert front.update(conditions) is Isolation.NONE


def test_no_isolation_while_a_rear_brake_is_not_known() -> None:
    """Nor with none at all: it may be as hot as the front ones."""
    known = at(0.0, 5.0)
    one = known.corners["RL"]._replace(validity=Validity.INVALID)
    for rear in ({"RL": known.corners["RL"], "RR": one}, {}):
        corners = {"FL": known.corners["FL"], **rear}
        now = Conditions(known.time_us, corners, known.speed_ms)

        assert FrontIsolation(AdviceConfig()).update(now) is Isolation.NONE


def test_the_deviation_counts_against_the_margin() -> None:
    corner = CornerEstimate(
        fluid_k=400.0,
        boiling_k=420.0,
        risk=CornerRisk(fluid_deviation_k=8.0),
    )

    assert corner.cautious_margin_k == pytest.approx(12.0)
