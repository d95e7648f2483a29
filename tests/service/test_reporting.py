"""What the service logs of the validity of its estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.estimate import Input
from bstm_daemon.service.assembly import BusOverride, build_monitor
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.intake import Intake
from bstm_daemon.service.reporting import ServiceReporter
from bstm_daemon.service.sender import Sender
from bstm_daemon.service.status import StateFileStatus

ROOT = Path(__file__).parents[2]
SECOND = 1_000_000


class Lines:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.logged: list[tuple[str, dict[str, Any]]] = []

    def _take(self, event: str, **fields: Any) -> None:
        self.logged.append((event, fields))

    debug = info = warning = error = _take

    def of(self, name: str) -> list[dict[str, Any]]:
        """Return the fields of each line *name*."""
        return [fields for event, fields in self.logged if event == name]


@pytest.mark.parametrize(
    ("mode", "inputs", "reasons"),
    [
        ("fused", Input(0), "start unknown, input missing"),
        ("ff", Input.PRESSURE, "start unknown, input missing, unverified"),
    ],
)
def test_reasons_are_logged_with_the_validity(
    tmp_path: Path, mode: str, inputs: Input, reasons: str
) -> None:
    """Once as they change; what nothing checks once at the start."""
    path = tmp_path / "car.toml"
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    text = text.replace('"../dbc/', f'"{ROOT}/dbc/')
    text = text.replace('interface = "socketcan"', 'interface = "virtual"')
    path.write_text(text.replace('mode = "auto"', f'mode = "{mode}"'), "utf-8")
    monitor = build_monitor(path, BusOverride(), forecast=False)
    axis, lines = SteadyAxis(), Lines()
    intake = Intake(monitor.links(), axis)
    sender = Sender(None, frozenset(), monitor.engine.publication)
    reporter = ServiceReporter(ServiceLog(lines), axis, tmp_path, None)

    reporter.begin(monitor, intake, sender)
    for second in range(3):
        monitor.engine.tick((1_700_000_000 + second) * SECOND)
        reporter.note_flags()
        reporter.report(StateFileStatus(), axis.read())
    reporter.close()
    intake.close()

    assert monitor.engine.unverified == inputs
    unverified = [{"inputs": "pressure"}] if inputs else []
    assert lines.of("inputs_unverified") == unverified
    rear = [
        {key: value for key, value in line.items() if key != "corner"}
        for line in lines.of("validity_changed")
        if line["corner"] == "RR"
    ]
    assert rear[-1] == {"validity": "degraded", "reasons": reasons}
    assert len(rear) == 2
