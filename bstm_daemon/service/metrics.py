"""The status as metric families of prometheus-client.

Names have the prefix ``bstm_`` and base units (seconds, bytes, degrees
Celsius); counters end in ``_total`` and count from the start of the service.
A value with several states has one series per state, 1 for the present one.
An unknown value is NaN.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from functools import partial
from operator import attrgetter
from typing import Any, Final, cast

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from bstm_daemon.bus.live.link import LinkEvent, LinkState
from bstm_daemon.estimate import (
    REASON_WORDS,
    Input,
    RiskLevel,
    State,
    Validity,
)
from bstm_daemon.model.heat.plausibility import FAULTS
from bstm_daemon.service.status import ServiceStatus
from bstm_daemon.units import to_celsius

Series = Mapping[Any, float]
"""Values by the tuple of their labels' values."""

Rows = tuple[tuple[str, str, str], ...]
"""Metric, attribute it is the value of, and what it means."""

_GAUGES: Final[Rows] = (
    ("history_known", "history_known", "1: start temperatures are known."),
    (
        "force_difference_ratio",
        "force_difference",
        "Braking work by pressure minus work by motion, over the larger.",
    ),
    ("publishing", "is_publishing", "1 if frames are being sent."),
    ("state_age_seconds", "state_file.age_s", "Time since the last save."),
    ("drain_lag_seconds", "loop.drain_lag_s", "Delay of the last drain."),
    ("drain_max_seconds", "loop.drain_max_s", "Longest since last status."),
    ("resident_memory_bytes", "loop.resident_bytes", "Resident memory."),
    ("uptime_seconds", "loop.uptime_s", "Time since the start."),
)
_COUNTERS: Final[Rows] = (
    ("late_samples", "late_samples", "Samples older than their predecessor."),
    ("dropped_samples", "dropped_samples", "Samples with outlying stamps."),
    ("clock_jumps", "clock_jumps", "Jumps in the time of the inputs."),
    ("clock_steps", "clock_steps", "Steps of the wall clock."),
    ("state_saves", "state_file.saves", "Saves of the state file."),
    ("state_save_failures", "state_file.failures", "Saves that failed."),
    ("cpu_seconds", "loop.cpu_s", "User and system time of the process."),
)
_FORECAST_GAUGES: Final[Rows] = (
    (
        "vapour_probability",
        "probability",
        "Probability of vapour now or within 30 min if the car parks now.",
    ),
    (
        "fluid_deviation_celsius",
        "fluid_deviation_k",
        "Standard deviation of the fluid temperature.",
    ),
    (
        "fluid_peak_seconds",
        "peak_in_s",
        "Time from the forecast to the highest fluid temperature.",
    ),
    (
        "fluid_safe_seconds",
        "safe_in_s",
        "Time from the forecast until vapour stays below 1 %.",
    ),
)
_BUS_COUNTERS: Final[Rows] = (
    ("bus_frames", "frames", "Frames received."),
    ("bus_dropped_frames", "dropped", "Frames not read in time."),
    ("bus_sent_frames", "sent", "Frames sent."),
    ("bus_send_lost_frames", "send_lost", "Frames the driver did not accept."),
)


class StatusMetrics(Collector):
    """The newest status as metrics, formed whenever they are read."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Hold no status yet: there are no metrics."""
        self.registry = CollectorRegistry()
        self.registry.register(self)
        self._clock = clock
        self._newest: tuple[ServiceStatus, float] | None = None

    def update(self, status: ServiceStatus) -> None:
        """Show *status* from now on; never blocks."""
        self._newest = status, self._clock()

    def age_s(self) -> float | None:
        """Return the time since the last update, None before the first."""
        newest = self._newest
        return None if newest is None else self._clock() - newest[1]

    def collect(self) -> Iterator[Metric]:
        """Yield every family that has a series."""
        if self._newest is None:
            return
        status, _ = self._newest
        for families in (_of_service, _of_corners, _of_forecast, _of_buses):
            for family in families(status):
                if family.samples:
                    yield family

    def text(self) -> bytes:
        """Return the metrics in text format 0.0.4."""
        return generate_latest(self.registry)


def _of_service(status: ServiceStatus) -> Iterator[Metric]:
    kernel = "compiled" if status.compiled_kernel else "python"
    build = (status.version, kernel, status.heat_mode.name.lower())
    yield _gauge(
        "build_info",
        "Program that runs, and its form.",
        {build: 1},
        *("version", "kernel", "heat_mode"),
    )
    yield _gauge(
        "state",
        "What the service does: 1 for the present state.",
        _states(State, {(): status.state}),
        "state",
    )
    yield _gauge(
        "input_fault",
        "Fault of the inputs or the heat: 1 if present.",
        {(name,): name in status.faults for name in FAULTS},
        "fault",
    )
    yield _gauge(
        "input_unverified",
        "Whether no mapped role can check the input: 1 if so.",
        {(one.words[0],): one in status.unverified for one in Input},
        "input",
    )
    subjects = (
        "heat",
        *(f"{corner} {node}" for corner, node in status.residuals_k),
    )
    yield _gauge(
        "model_disagrees",
        "1: the model differs from the measurement by more than it should.",
        {(what,): what in status.disagreements for what in subjects},
        "what",
    )
    yield _gauge(
        "temperature_residual_celsius",
        "Running mean of measured minus estimated temperature.",
        status.residuals_k,
        *("corner", "node"),
    )
    for name, attribute, text in _GAUGES:
        yield _gauge(name, text, {(): attrgetter(attribute)(status)})
    for name, attribute, text in _COUNTERS:
        yield _counter(name, text, {(): attrgetter(attribute)(status)})


def _of_corners(status: ServiceStatus) -> Iterator[Metric]:
    corners = status.corners
    estimates = {name: one.estimate for name, one in corners.items()}
    yield _gauge(
        "temperature_celsius",
        "Estimated temperature of a node of a brake.",
        {
            (name, node): to_celsius(kelvin)
            for name, corner in corners.items()
            for node, kelvin in corner.nodes_k.items()
        },
        *("corner", "node"),
    )
    yield _gauge(
        "boiling_margin_celsius",
        "Wet boiling point of the fluid minus its temperature.",
        {(name,): one.margin_k for name, one in estimates.items()},
        "corner",
    )
    yield _gauge(
        "risk",
        "How close the fluid is to boiling: 1 for the present level.",
        _states(RiskLevel, {(n,): c.level for n, c in estimates.items()}),
        *("corner", "level"),
    )
    yield _gauge(
        "validity",
        "Whether the estimate may be used: 1 for the present validity.",
        _states(Validity, {(n,): c.validity for n, c in estimates.items()}),
        *("corner", "validity"),
    )
    yield _gauge(
        "not_valid_reason",
        "Why the estimate is not valid: 1 if the reason is there.",
        {
            (name, str(one.name).lower()): one in estimate.reasons
            for name, estimate in estimates.items()
            for one in REASON_WORDS
        },
        *("corner", "reason"),
    )


def _of_forecast(status: ServiceStatus) -> Iterator[Metric]:
    forecasts = {
        (name,): forecast
        for name, corner in status.corners.items()
        if (forecast := corner.estimate.risk) is not None
    }
    for name, attribute, text in _FORECAST_GAUGES:
        values = {key: getattr(f, attribute) for key, f in forecasts.items()}
        yield _gauge(name, text, values, "corner")
    yield _gauge(
        "fluid_peak_celsius",
        "Highest fluid temperature within 30 min if the car parks now.",
        {key: to_celsius(f.peak_k) for key, f in forecasts.items()},
        "corner",
    )
    yield _gauge(
        "fade",
        "Disc and pads against their limits: 1 for the present level.",
        _states(RiskLevel, {key: f.fade for key, f in forecasts.items()}),
        *("corner", "level"),
    )
    risk = status.risk
    if risk is None:
        return
    yield _gauge(
        "car_vapour_probability",
        "Probability of vapour at any corner.",
        {("now",): risk.probability_now, ("horizon",): risk.probability},
        "when",
    )
    yield _gauge(
        "boiling_point_celsius",
        "Boiling point: median and 1 % quantile.",
        {
            ("0.5",): to_celsius(risk.boiling_k),
            ("0.01",): to_celsius(risk.boiling_low_k),
        },
        "share",
    )
    yield _gauge(
        "forecast_members",
        "Members of the forecast's ensemble.",
        {(): status.forecast_members},
    )


def _of_buses(status: ServiceStatus) -> Iterator[Metric]:
    labels = ("bus", "channel")
    buses = {(name, bus.channel): bus for name, bus in status.buses.items()}
    yield _gauge(
        "bus_state",
        "State of the interface: 1 for the present one.",
        {
            (*key, state.value): bus.state is state
            for key, bus in buses.items()
            for state in LinkState
        },
        *(*labels, "state"),
    )
    yield _counter(
        "bus_refused",
        "Frames and samples refused, by reason.",
        {
            (*key, reason): count
            for key, bus in buses.items()
            for reason, count in sorted(bus.refused.items())
        },
        *(*labels, "reason"),
    )
    yield _counter(
        "bus_events",
        "What happened on the bus: error frames, bus-off, restarts.",
        {
            (*key, event.value): bus.events.get(event, 0)
            for key, bus in buses.items()
            for event in LinkEvent
        },
        *(*labels, "event"),
    )
    for name, attribute, text in _BUS_COUNTERS:
        counts = {key: getattr(bus, attribute) for key, bus in buses.items()}
        yield _counter(name, text, counts, *labels)


def _family(
    kind: Callable[..., Any],
    name: str,
    text: str,
    series: Series,
    *labels: str,
) -> Metric:
    family = kind(f"bstm_{name}", text, labels=labels)
    for label_values, value in series.items():
        family.add_metric(label_values, value)
    return cast("Metric", family)


_gauge = partial(_family, GaugeMetricFamily)
_counter = partial(_family, CounterMetricFamily)


def _states(
    states: type[IntEnum], present: Mapping[tuple[str, ...], IntEnum]
) -> Series:
    """Return a series per state, 1 for the *present* one of its labels."""
    return {
        (*key, state.name.lower()): state is now
        for key, now in present.items()
        for state in states
    }
