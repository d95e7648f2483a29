"""The page of `bstm heat`: what it says of the sources, in words."""

import numpy as np
import pytest

from bstm_daemon.analysis.identify.heat_comparison import (
    HeatComparison,
    StopFriction,
)
from bstm_daemon.report.heat import SOURCES, heat_page, sentence

NO_FRICTION = StopFriction((), (), "no stop")


def compared(**total_mj: float) -> HeatComparison:
    """Return a drive of two minutes that adds up to *total_mj* by source."""
    time_s = np.linspace(0.0, 120.0, 5)
    rise = np.linspace(0.0, 1.0, 5)
    return HeatComparison(
        time_s=time_s,
        speed_ms=np.full(5, 10.0),
        pressure_pa=np.full(5, 2e6),
        braking=np.ones(5, bool),
        force_n=np.full(5, 1000.0),
        power_w={k: np.full(5, x * 1e6 / 120.0) for k, x in total_mj.items()},
        energy_j={k: rise * x * 1e6 for k, x in total_mj.items()},
        stops=(),
        absent=dict.fromkeys(SOURCES, "no signal"),
        remarks=(),
    )


def test_sources_that_agree_need_no_advice() -> None:
    assert sentence(compared(ff=20.8, fb=20.0)) == (
        "Brake heat of the drive by pressure (Feed-Forward) 20.80 MJ, by "
        "motion (Feed-Back) 20.00 MJ. By pressure (Feed-Forward) it is 1.04 "
        "of that by motion."
    )


@pytest.mark.parametrize(
    ("totals", "advice"),
    [
        (
            {"ff": 14.0, "fb": 20.0},
            (
                "it is 0.70 of that by motion: the pad friction, the "
                "pressure's zero or the piston area is off (bstm identify "
                "brakes)."
            ),
        ),
        (
            {"ff": 20.0, "fb": 20.0, "can": 12.2},
            (
                "By the bus's brake torque it is 0.61 of that by motion: the "
                "torque of the bus is not all of the brake torque of this "
                "car; check its unit and scale in the DBC, and whether it is "
                "of one wheel, of one axle or of regeneration alone, before "
                "using it."
            ),
        ),
    ],
)
def test_a_source_that_differs_says_what_to_check(
    totals: dict[str, float], advice: str
) -> None:
    assert sentence(compared(**totals)).endswith(advice)


def test_without_motion_nothing_is_compared() -> None:
    assert sentence(compared(ff=3.0)) == (
        "Brake heat of the drive by pressure (Feed-Forward) 3.00 MJ."
    )


def test_the_advice_of_several_drives_is_said_once() -> None:
    totals = {"ff": 20.0, "fb": 20.0, "can": 12.0}
    drives = [
        (name, compared(**totals), NO_FRICTION) for name in ("a.log", "b.log")
    ]

    lead = heat_page(drives, "").lead

    assert isinstance(lead, str)
    assert lead.startswith("a.log: Brake heat of the drive by pressure")
    assert lead.count(" b.log: Brake heat of the drive") == 1
    assert lead.count("check its unit and scale") == 1
    assert lead.endswith(
        "By the bus's brake torque it is 0.60 of that by motion."
    )
