"""The line that ``systemctl status`` shows."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import pytest

from bstm_daemon.bus.live.link import LinkState
from bstm_daemon.estimate import (
    CarRisk,
    CornerEstimate,
    Input,
    RiskLevel,
    State,
    Validity,
)
from bstm_daemon.service.status import (
    BusStatus,
    CornerStatus,
    ServiceStatus,
    status_line,
)

NORMAL = CornerEstimate(
    fluid_k=365.15,
    boiling_k=427.55,
    level=RiskLevel.NORMAL,
    validity=Validity.VALID,
)
FRONT = CornerStatus({"disc": 685.15, "fluid": 365.15}, NORMAL)
REAR = CornerStatus(
    {"disc": 500.0, "fluid": 370.0}, NORMAL._replace(fluid_k=369.95)
)
RUNNING = ServiceStatus(
    "1.2.3",
    compiled_kernel=True,
    state=State.RUNNING,
    history_known=True,
    corners={"FL": FRONT, "RL": REAR},
    buses={"chassis": BusStatus("can0", LinkState.UP, frames=1200)},
)


def test_running() -> None:
    assert status_line(RUNNING) == (
        "running, disc FL 412 degC, fluid RL 97 degC, risk normal, "
        "margin 58 K, 1200 frames"
    )


def test_waiting_for_an_interface() -> None:
    waiting = ServiceStatus(
        "1.2.3",
        compiled_kernel=True,
        buses={
            "chassis": BusStatus(
                "can0", LinkState.GONE, "can0: No such device"
            ),
            "body": BusStatus(
                "can1", LinkState.UP, "can1 is bus-off", 3, dropped=2
            ),
        },
    )

    assert status_line(waiting) == (
        "starting, can0: No such device, can1 is bus-off, history unknown, "
        "3 frames, 2 lost"
    )


def test_suspect_inputs_and_foreign_heat_are_told() -> None:
    """Missing inputs are not: a car may have no torque on its bus."""
    faults = ("torque_missing", "wheel_speed_suspect", "stuck", "heat_unknown")

    line = status_line(replace(RUNNING, faults=faults))

    assert line.startswith("running, wheel speed suspect, heat unknown, disc ")
    assert "stuck" not in line


def test_what_nothing_checks_is_in_the_line() -> None:
    """It degrades the estimate all the time."""
    unverified = Input.SPEED | Input.PRESSURE

    line = status_line(replace(RUNNING, unverified=unverified))

    assert line.startswith("running, unverified: speed, pressure, disc ")


def test_no_number_is_not_shown() -> None:
    corner = CornerStatus({"disc": nan, "fluid": nan})

    line = status_line(replace(RUNNING, corners={"FL": corner}))

    assert line == "running, risk unknown, 1200 frames"


@pytest.mark.parametrize(
    ("levels", "shown"),
    [
        ((RiskLevel.NORMAL, RiskLevel.UNKNOWN), "unknown"),
        ((RiskLevel.HIGH, RiskLevel.UNKNOWN), "high"),
        ((RiskLevel.NORMAL, RiskLevel.ELEVATED), "elevated"),
        ((RiskLevel.CRITICAL, RiskLevel.NORMAL), "critical"),
        ((RiskLevel.NORMAL, RiskLevel.NORMAL), "normal"),
    ],
)
def test_the_worst_level_is_shown(
    levels: tuple[RiskLevel, RiskLevel], shown: str
) -> None:
    corners = {
        name: CornerStatus(FRONT.nodes_k, NORMAL._replace(level=level))
        for name, level in zip(("FL", "FR"), levels, strict=True)
    }

    assert f"risk {shown}," in status_line(replace(RUNNING, corners=corners))


def test_one_line() -> None:
    assert "\n" not in status_line(RUNNING)


def test_the_risk_of_an_unknown_start_is_at_most_as_shown() -> None:
    critical = NORMAL._replace(level=RiskLevel.CRITICAL)
    front = CornerStatus(FRONT.nodes_k, critical)
    status = replace(
        RUNNING,
        history_known=False,
        corners={"FL": front, "RL": REAR},
        risk=CarRisk(probability=0.875),
    )

    line = status_line(status)

    assert "risk at most critical, margin 58 K" in line
    assert "vapour at most 87.5 %, history unknown" in line
