"""The status as Prometheus text, for a file or a loopback page.

Text exposition format 0.0.4. Names have the prefix ``bstm_`` and base units
(seconds, bytes, degrees Celsius); counters end in ``_total`` and count from
the start of the service. What is in one of several states has a series per
state, 1 for the present one. A value that is not known is NaN.
"""

from __future__ import annotations

from math import isfinite, isnan
from typing import TYPE_CHECKING, Final, Literal

from bstm_daemon.bus.link import LinkEvent, LinkState
from bstm_daemon.bus.output_layout import RiskLevel, State, Validity
from bstm_daemon.files import replacing
from bstm_daemon.heat.plausibility import FAULTS
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from enum import IntEnum
    from pathlib import Path

    from bstm_daemon.daemon.status import ServiceStatus

FILE_MODE: Final = 0o644
"""node_exporter runs as another user and must read the file."""

_ESCAPES: Final = str.maketrans(
    {"\\": r"\\", '"': r"\"", "\n": r"\n"},
)
_HELP_ESCAPES: Final = str.maketrans({"\\": r"\\", "\n": r"\n"})

_Labels = dict[str, str]
_Series = tuple[_Labels, float]


def write_metrics(path: Path, status: ServiceStatus) -> None:
    """Replace the file *path*, readable for all, in one step.

    Raises :class:`~bstm_daemon.errors.FileAccessError` where the folder is
    missing or not writable.
    """
    with replacing(path) as temporary:
        temporary.write_text(metrics_text(status), "utf-8")
        temporary.chmod(FILE_MODE)


def metrics_text(status: ServiceStatus) -> str:
    """Return *status* in the text format, ending in a line feed."""
    page = _Page()
    _service(page, status)
    _corners(page, status)
    _buses(page, status)
    _process(page, status)
    return page.text()


class _Page:
    """Collects metrics; each name once, its series together."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def gauge(self, name: str, text: str, *series: _Series) -> None:
        self._add("gauge", name, text, series)

    def counter(self, name: str, text: str, *series: _Series) -> None:
        self._add("counter", f"{name}_total", text, series)

    def text(self) -> str:
        return "".join(f"{line}\n" for line in self._lines)

    def _add(
        self,
        kind: Literal["counter", "gauge"],
        name: str,
        text: str,
        series: Iterable[_Series],
    ) -> None:
        lines = [
            f"bstm_{name}{_braced(labels)} {_number(value)}"
            for labels, value in series
        ]
        if lines:
            self._lines += [
                f"# HELP bstm_{name} {text.translate(_HELP_ESCAPES)}",
                f"# TYPE bstm_{name} {kind}",
                *lines,
            ]


def _service(page: _Page, status: ServiceStatus) -> None:
    build = {
        "version": status.version,
        "kernel": "compiled" if status.compiled_kernel else "python",
        "heat_mode": status.heat_mode.name.lower(),
    }
    page.gauge("build_info", "Program that runs, and its form.", (build, 1))
    page.gauge(
        "state",
        "What the service does: 1 for the present state.",
        *_one_of(State, status.state, "state", {}),
    )
    page.gauge(
        "history_known",
        "1 if the temperatures before the start are known.",
        ({}, status.history_known),
    )
    page.gauge(
        "input_fault",
        "What is wrong with the inputs or the heat: 1 if it is there.",
        *(({"fault": name}, name in status.faults) for name in FAULTS),
    )
    page.gauge(
        "model_disagrees",
        "1: the model is further from what is measured than it should be.",
        *(
            ({"what": what}, what in status.disagreements)
            for what in (
                "heat",
                *(f"{corner} {node}" for corner, node in status.residuals_k),
            )
        ),
    )
    page.gauge(
        "force_difference_ratio",
        "Braking work by pressure less that by motion, over the larger.",
        ({}, status.force_difference),
    )
    page.gauge(
        "temperature_residual_celsius",
        "Running mean of measured less estimated temperature.",
        *(
            ({"corner": corner, "node": node}, kelvin)
            for (corner, node), kelvin in status.residuals_k.items()
        ),
    )
    page.gauge(
        "publishing",
        "1 if frames are being sent.",
        ({}, status.is_publishing),
    )
    page.counter(
        "late_samples",
        "Samples older than one that was taken before.",
        ({}, status.late_samples),
    )
    page.counter(
        "dropped_samples",
        "Samples with stamps far from their neighbours'.",
        ({}, status.dropped_samples),
    )
    page.counter(
        "clock_jumps",
        "Jumps in the time of the inputs.",
        ({}, status.clock_jumps),
    )
    page.counter(
        "clock_steps",
        "Steps of the wall clock.",
        ({}, status.clock_steps),
    )
    file = status.state_file
    page.counter("state_saves", "Saves of the state file.", ({}, file.saves))
    page.counter(
        "state_save_failures",
        "Saves of the state file that failed.",
        ({}, file.failures),
    )
    page.gauge(
        "state_age_seconds",
        "Time since the last save of the state file.",
        ({}, file.age_s),
    )


def _corners(page: _Page, status: ServiceStatus) -> None:
    corners = status.corners
    page.gauge(
        "temperature_celsius",
        "Estimated temperature of a node of a brake.",
        *(
            ({"corner": name, "node": node}, to_celsius(kelvin))
            for name, corner in corners.items()
            for node, kelvin in corner.nodes_k.items()
        ),
    )
    page.gauge(
        "boiling_margin_celsius",
        "Wet boiling point of the fluid minus its temperature.",
        *(
            ({"corner": name}, corner.margin_k)
            for name, corner in corners.items()
        ),
    )
    page.gauge(
        "risk",
        "How close the fluid is to boiling: 1 for the present level.",
        *(
            series
            for name, corner in corners.items()
            for series in _one_of(
                RiskLevel, corner.risk, "level", {"corner": name}
            )
        ),
    )
    _forecast(page, status)
    page.gauge(
        "validity",
        "Whether the estimate may be used: 1 for the present validity.",
        *(
            series
            for name, corner in corners.items()
            for series in _one_of(
                Validity, corner.validity, "validity", {"corner": name}
            )
        ),
    )


def _forecast(page: _Page, status: ServiceStatus) -> None:
    told = {
        name: corner.forecast
        for name, corner in status.corners.items()
        if corner.forecast is not None
    }
    page.gauge(
        "vapour_probability",
        "Probability of vapour now or within 30 min if the car parks now.",
        *(({"corner": name}, f.probability) for name, f in told.items()),
    )
    page.gauge(
        "fluid_deviation_celsius",
        "Standard deviation of the fluid temperature.",
        *(({"corner": name}, f.fluid_deviation_k) for name, f in told.items()),
    )
    page.gauge(
        "fluid_peak_celsius",
        "Highest fluid temperature within 30 min if the car parks now.",
        *(
            ({"corner": name}, to_celsius(f.peak_k))
            for name, f in told.items()
        ),
    )
    page.gauge(
        "fluid_peak_seconds",
        "Time from the forecast to that temperature.",
        *(({"corner": name}, f.peak_in_s) for name, f in told.items()),
    )
    page.gauge(
        "fluid_safe_seconds",
        "Time from the forecast until vapour stays below 1 %.",
        *(({"corner": name}, f.safe_in_s) for name, f in told.items()),
    )
    page.gauge(
        "fade",
        "Disc and pads against their limits: 1 for the present level.",
        *(
            series
            for name, f in told.items()
            for series in _one_of(RiskLevel, f.fade, "level", {"corner": name})
        ),
    )
    if status.risk is not None:
        risk = status.risk
        page.gauge(
            "car_vapour_probability",
            "Probability of vapour at any corner.",
            ({"when": "now"}, risk.probability_now),
            ({"when": "horizon"}, risk.probability),
        )
        page.gauge(
            "boiling_point_celsius",
            "Boiling point: median, and what 1 % of such fluids lie below.",
            ({"share": "0.5"}, to_celsius(risk.boiling_k)),
            ({"share": "0.01"}, to_celsius(risk.boiling_low_k)),
        )
        page.gauge(
            "forecast_members",
            "Members of the forecast's ensemble.",
            ({}, status.forecast_members),
        )


def _buses(page: _Page, status: ServiceStatus) -> None:
    buses = status.buses
    labels = {
        name: {"bus": name, "channel": bus.channel}
        for name, bus in buses.items()
    }
    page.gauge(
        "bus_state",
        "State of the interface: 1 for the present one.",
        *(
            ({**labels[name], "state": state.value}, bus.state is state)
            for name, bus in buses.items()
            for state in LinkState
        ),
    )
    page.counter(
        "bus_refused",
        "Frames and samples refused, by reason.",
        *(
            ({**labels[name], "reason": reason}, count)
            for name, bus in buses.items()
            for reason, count in sorted(bus.refused.items())
        ),
    )
    page.counter(
        "bus_events",
        "What happened on the bus: error frames, bus-off, restarts.",
        *(
            ({**labels[name], "event": event}, bus.events.get(event, 0))
            for name, bus in buses.items()
            for event in LinkEvent
        ),
    )
    counts: tuple[tuple[str, str, Mapping[str, int]], ...] = (
        (
            "bus_frames",
            "Frames received.",
            {name: bus.frames for name, bus in buses.items()},
        ),
        (
            "bus_dropped_frames",
            "Frames lost because they were not read in time.",
            {name: bus.dropped for name, bus in buses.items()},
        ),
        (
            "bus_sent_frames",
            "Frames sent.",
            {name: bus.sent for name, bus in buses.items()},
        ),
        (
            "bus_send_lost_frames",
            "Frames that were due and that the driver did not take.",
            {name: bus.send_lost for name, bus in buses.items()},
        ),
    )
    for metric, text, by_bus in counts:
        page.counter(
            metric,
            text,
            *((labels[name], count) for name, count in by_bus.items()),
        )


def _process(page: _Page, status: ServiceStatus) -> None:
    loop = status.loop
    page.gauge(
        "drain_lag_seconds",
        "How late the last drain of the buses began.",
        ({}, loop.drain_lag_s),
    )
    page.gauge(
        "drain_max_seconds",
        "Longest drain of the buses since the last status.",
        ({}, loop.drain_max_s),
    )
    page.counter(
        "cpu_seconds", "User and system time of the process.", ({}, loop.cpu_s)
    )
    page.gauge(
        "resident_memory_bytes",
        "Memory of the process.",
        ({}, loop.resident_bytes),
    )
    page.gauge("uptime_seconds", "Time since the start.", ({}, loop.uptime_s))


def _one_of(
    values: type[IntEnum], present: IntEnum, label: str, labels: _Labels
) -> list[_Series]:
    return [
        ({**labels, label: value.name.lower()}, value is present)
        for value in values
    ]


def _braced(labels: _Labels) -> str:
    if not labels:
        return ""
    inside = ",".join(
        f'{name}="{value.translate(_ESCAPES)}"'
        for name, value in labels.items()
    )
    return f"{{{inside}}}"


def _number(value: float) -> str:
    if isfinite(value):
        # bool and int without a point, floats with all their digits
        return str(int(value)) if isinstance(value, int) else repr(value)
    if isnan(value):
        return "NaN"
    return "+Inf" if value > 0 else "-Inf"
