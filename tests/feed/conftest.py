"""Estimates to publish, and a socket to publish them on."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import (
    Advice,
    CarRisk,
    CornerEstimate,
    CornerRisk,
    Downshift,
    Estimate,
    HeatMode,
    Message,
    Reason,
    RiskLevel,
    State,
    Status,
    Validity,
    WearEstimate,
    WearLevel,
    WearSource,
)
from bstm_daemon.files import shipped_file

START_US = 1_700_000_000_000_000


@pytest.fixture(scope="session")
def config() -> Config:
    return load_config(shipped_file("config/example_vehicle.toml"))


def made_estimate(number: int = 0) -> Estimate:
    """Return an estimate whose temperatures rise with *number*.

    FL is valid, FR degraded, RL invalid; RR is known to nobody.
    """
    risk = CornerRisk(
        probability=0.02,
        level=RiskLevel.ELEVATED,
        sure_level=RiskLevel.ELEVATED,
        fade=RiskLevel.HIGH,
        peak_k=400.15,
        peak_in_s=600.0,
        safe_in_s=math.inf,
    )
    wear = WearEstimate(
        thickness_m=0.0055,
        source=WearSource.CONFIGURED,
        level=WearLevel.CHECK,
    )
    valid = CornerEstimate(
        disc_k=573.15 + number,
        pad_front_k=523.15,
        pad_back_k=423.15,
        fluid_k=373.15,
        boiling_k=428.15,
        validity=Validity.VALID,
        level=RiskLevel.ELEVATED,
        sure_level=RiskLevel.ELEVATED,
        risk=risk,
        forecast_age_s=1.0,
        wear=wear,
    )
    return Estimate(
        START_US + 100_000 * number,
        {
            "FL": valid,
            "FR": valid._replace(
                validity=Validity.DEGRADED,
                reasons=Reason.INPUT_MISSING | Reason.UNVERIFIED,
            ),
            "RL": valid._replace(
                validity=Validity.INVALID,
                reasons=Reason.HEAT_UNKNOWN,
                level=RiskLevel.UNKNOWN,
            ),
            "RR": CornerEstimate(),
        },
        Status(State.RUNNING, HeatMode.FUSED, history_known=True),
        Advice(
            message=Message.BRAKES_HOT,
            shift_advice=Downshift.SHIFT_DOWN,
            waiting_s=math.inf,
            validity=Validity.VALID,
        ),
        CarRisk(0.02, 0.0, RiskLevel.ELEVATED, 430.0, 425.15),
    )


@pytest.fixture
def estimate() -> Callable[[int], Estimate]:
    return made_estimate


@pytest.fixture
def socket_path(tmp_path: Path) -> Path:
    path = tmp_path / "feed.sock"
    if len(str(path)) > 100:
        pytest.skip("the temporary folder's name is too long for a socket")
    return path
