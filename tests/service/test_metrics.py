"""The metrics: against the format's grammar and the reference parser."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf, isnan, nan
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from bstm_daemon.bus.live.link import LinkEvent, LinkState
from bstm_daemon.estimate import (
    CarRisk,
    CornerEstimate,
    CornerRisk,
    HeatMode,
    Input,
    Reason,
    RiskLevel,
    State,
    Validity,
)
from bstm_daemon.model.heat.plausibility import FAULTS
from bstm_daemon.service.metrics import StatusMetrics
from bstm_daemon.service.status import (
    BusStatus,
    CornerStatus,
    LoopStatus,
    ServiceStatus,
    StateFileStatus,
)

DOCS = Path(__file__).parents[2] / "docs" / "observing.md"

STATUS = ServiceStatus(
    "1.2.3",
    compiled_kernel=True,
    state=State.DEGRADED,
    heat_mode=HeatMode.FB,
    history_known=True,
    faults=("pressure_missing", "heat_substituted"),
    unverified=Input.TORQUE,
    disagreements=("FL disc",),
    force_difference=0.12,
    residuals_k={("FL", "disc"): 31.0},
    is_publishing=True,
    risk=CarRisk(0.3, 0.05, RiskLevel.HIGH, 434.15, 406.15, 3.0),
    forecast_members=64,
    corners={
        "FL": CornerStatus(
            {"disc": 673.15, "pad_1": 500.0, "fluid": 373.15},
            CornerEstimate(
                fluid_k=373.15,
                boiling_k=428.15,
                level=RiskLevel.ELEVATED,
                validity=Validity.DEGRADED,
                reasons=Reason.INPUT_MISSING | Reason.UNVERIFIED,
                risk=CornerRisk(
                    probability=0.25,
                    fade=RiskLevel.HIGH,
                    fluid_deviation_k=5.5,
                    peak_k=403.15,
                    peak_in_s=600.0,
                    safe_in_s=inf,
                ),
            ),
        ),
        "RR": CornerStatus({"disc": nan, "fluid": nan}),
    },
    buses={
        "chassis": BusStatus(
            "can0",
            LinkState.UP,
            frames=12,
            refused={"wrong_length": 2, "error_frame": 1},
            dropped=3,
            events={LinkEvent.ERROR_FRAME: 4, LinkEvent.BUS_OFF: 5},
            sent=7,
            send_lost=8,
        ),
        "body": BusStatus("can1", LinkState.GONE),
    },
    late_samples=9,
    dropped_samples=10,
    clock_jumps=11,
    clock_steps=12,
    state_file=StateFileStatus(13, 14, 15.5),
    loop=LoopStatus(0.001, 0.002, 16.25, 17_000_000, 18.5),
)

SERIES = re.compile(
    r"(?P<name>[a-zA-Z_:][a-zA-Z0-9_:]*)"
    r"(?:\{(?P<labels>[a-zA-Z_][a-zA-Z0-9_]*="
    r'"(?:[^"\\\n]|\\[\\"n])*"'
    r'(?:,[a-zA-Z_][a-zA-Z0-9_]*="(?:[^"\\\n]|\\[\\"n])*")*)\})?'
    r" (?P<value>-?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?|NaN|[+-]Inf)"
)
"""A line of text format 0.0.4 without a time stamp, which the collector of
text files refuses."""


def metrics_text(status: ServiceStatus) -> str:
    metrics = StatusMetrics()
    metrics.update(status)
    return metrics.text().decode()


def checked(text: str) -> dict[str, list[str]]:
    """Return the series by metric, after every rule of the format."""
    assert text.endswith("\n")
    lines = text[:-1].split("\n")
    found: dict[str, list[str]] = {}
    kind = name = ""
    for number, line in enumerate(lines):
        if line.startswith("# HELP "):
            name, _, words = line.removeprefix("# HELP ").partition(" ")
            assert words
            assert name not in found, "a metric in two places"
            assert lines[number + 1].startswith(f"# TYPE {name} ")
            found[name] = []
        elif line.startswith("# TYPE "):
            _, _, kind = line.removeprefix("# TYPE ").partition(" ")
            assert kind in ("counter", "gauge")
            assert (kind == "counter") == name.endswith("_total")
        else:
            match = SERIES.fullmatch(line)
            assert match, line
            assert match["name"] == name
            found[name].append(match["labels"] or "")
    assert all(found.values()), "a metric without a series"
    for labels in found.values():
        assert len(set(labels)) == len(labels), "a series in two places"
    return found


def value(text: str, name: str, **labels: str) -> float:
    """Return one value as the reference parser reads it."""
    (number,) = (
        sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name == f"bstm_{name}"
        and labels.items() <= sample.labels.items()
    )
    return float(number)


def test_follows_the_format() -> None:
    found = checked(metrics_text(STATUS))

    assert all(name.startswith("bstm_") for name in found)


def test_a_service_that_has_just_started_follows_the_format() -> None:
    checked(metrics_text(ServiceStatus("1", compiled_kernel=False)))


@pytest.mark.parametrize(
    ("name", "labels", "expected"),
    [
        ("build_info", {"version": "1.2.3", "kernel": "compiled"}, 1),
        ("build_info", {"heat_mode": "fb"}, 1),
        ("state", {"state": "degraded"}, 1),
        ("state", {"state": "running"}, 0),
        ("history_known", {}, 1),
        ("input_fault", {"fault": "pressure_missing"}, 1),
        ("input_fault", {"fault": "heat_substituted"}, 1),
        ("input_fault", {"fault": "heat_unknown"}, 0),
        ("publishing", {}, 1),
        ("temperature_celsius", {"corner": "FL", "node": "disc"}, 400),
        ("temperature_celsius", {"corner": "FL", "node": "fluid"}, 100),
        ("boiling_margin_celsius", {"corner": "FL"}, 55),
        ("risk", {"corner": "FL", "level": "elevated"}, 1),
        ("risk", {"corner": "FL", "level": "normal"}, 0),
        ("risk", {"corner": "RR", "level": "unknown"}, 1),
        ("validity", {"corner": "FL", "validity": "degraded"}, 1),
        ("validity", {"corner": "RR", "validity": "not_available"}, 1),
        ("input_unverified", {"input": "torque"}, 1),
        ("input_unverified", {"input": "speed"}, 0),
        ("not_valid_reason", {"corner": "FL", "reason": "unverified"}, 1),
        ("not_valid_reason", {"corner": "FL", "reason": "start_unknown"}, 0),
        ("not_valid_reason", {"corner": "RR", "reason": "unverified"}, 0),
        ("bus_state", {"bus": "chassis", "state": "up"}, 1),
        ("bus_state", {"bus": "body", "state": "gone"}, 1),
        ("bus_state", {"channel": "can1", "state": "up"}, 0),
        ("bus_frames_total", {"bus": "chassis", "channel": "can0"}, 12),
        ("bus_refused_total", {"reason": "wrong_length"}, 2),
        ("bus_dropped_frames_total", {"bus": "chassis"}, 3),
        ("bus_events_total", {"bus": "chassis", "event": "bus_off"}, 5),
        ("bus_events_total", {"bus": "chassis", "event": "error_frame"}, 4),
        ("bus_events_total", {"bus": "body", "event": "restarted"}, 0),
        ("bus_sent_frames_total", {"bus": "chassis"}, 7),
        ("bus_send_lost_frames_total", {"bus": "chassis"}, 8),
        ("bus_frames_total", {"bus": "body"}, 0),
        ("late_samples_total", {}, 9),
        ("dropped_samples_total", {}, 10),
        ("clock_jumps_total", {}, 11),
        ("clock_steps_total", {}, 12),
        ("state_saves_total", {}, 13),
        ("vapour_probability", {"corner": "FL"}, 0.25),
        ("car_vapour_probability", {"when": "now"}, 0.05),
        ("fluid_peak_celsius", {"corner": "FL"}, 130.0),
        ("fluid_safe_seconds", {"corner": "FL"}, inf),
        ("fade", {"corner": "FL", "level": "high"}, 1),
        ("boiling_point_celsius", {"share": "0.01"}, 133.0),
        ("forecast_members", {}, 64),
        ("state_save_failures_total", {}, 14),
        ("state_age_seconds", {}, 15.5),
        ("drain_lag_seconds", {}, 0.001),
        ("drain_max_seconds", {}, 0.002),
        ("cpu_seconds_total", {}, 16.25),
        ("resident_memory_bytes", {}, 17_000_000),
        ("uptime_seconds", {}, 18.5),
    ],
)
def test_value(name: str, labels: dict[str, str], expected: float) -> None:
    assert value(metrics_text(STATUS), name, **labels) == pytest.approx(
        expected
    )


def test_the_docs_list_every_metric_with_its_labels() -> None:
    rows = re.findall(
        r"^- `(bstm_\w+)(?:\{(.+?)\})?`:",
        DOCS.read_text("utf-8"),
        re.MULTILINE,
    )

    told = {name: set(re.findall(r"\w+", labels)) for name, labels in rows}

    assert told == {
        name: set(re.findall(r'(\w+)="', series[0]))
        for name, series in checked(metrics_text(STATUS)).items()
    }


def test_the_docs_list_every_fault() -> None:
    validity = (DOCS.parent / "validity.md").read_text("utf-8")
    _, _, text = validity.partition("\n| bit | name | set where |\n")
    rows = text.partition("\n\n")[0].splitlines()[1:]

    told = {
        name
        for row in rows
        for name in re.findall(r"`(\w+)`", row.split(" | ")[1])
    }

    assert told - {"clock_jump", "settled"} == set(FAULTS)


def test_no_metrics_before_the_first_status() -> None:
    metrics = StatusMetrics()

    assert metrics.text() == b""
    assert metrics.age_s() is None


def test_what_is_not_known_is_nan() -> None:
    text = metrics_text(STATUS)

    assert isnan(value(text, "temperature_celsius", corner="RR", node="disc"))
    assert isnan(value(text, "boiling_margin_celsius", corner="RR"))


@given(
    version=st.text(st.characters(exclude_categories=["Cs"])),
    number=st.floats() | st.sampled_from([inf, -inf, nan]),
)
def test_any_text_and_number_survive(version: str, number: float) -> None:
    status = replace(
        STATUS, version=version, state_file=StateFileStatus(age_s=number)
    )

    text = metrics_text(status)

    checked(text)
    read = value(text, "state_age_seconds")
    assert read == number or (isnan(read) and isnan(number))
    (raw,) = re.findall(
        r'^bstm_build_info\{.*,version="(.*)"\} 1\.0$', text, re.MULTILINE
    )
    unescaped = re.sub(
        r"\\(.)", lambda m: {"n": "\n"}.get(m[1], m[1]), raw, flags=re.DOTALL
    )
    assert unescaped == version
