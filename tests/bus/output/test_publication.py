"""The published bytes against dbc/bstm.dbc as cantools reads it."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.output import layout as output_layout
from bstm_daemon.bus.output.e2e import CheckStatus, Profile2Checker
from bstm_daemon.bus.output.layout import (
    BLOCK_IDS,
    CORNERS,
    own_ids,
    published_frames,
)
from bstm_daemon.bus.output.publication import OutputFrame, Publication
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimate import (
    Advice,
    Assist,
    CarRisk,
    CornerEstimate,
    CornerRisk,
    Downshift,
    Estimate,
    HeatMode,
    Input,
    Intervention,
    Isolation,
    Message,
    Reason,
    RiskLevel,
    Sound,
    State,
    Status,
    Validity,
    WearEstimate,
    WearLevel,
    WearSource,
)

ROOT = Path(__file__).parents[3]
ID_BASE = 0x5B0
FRAMES = published_frames(CORNERS)
FULL_SECOND_US = 1_000_000
ALL_PHASES_US = range(0, FULL_SECOND_US, 100_000)

DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")

any_float = st.floats(allow_nan=True, allow_infinity=True)
corner_snapshots = st.builds(
    CornerEstimate,
    disc_k=any_float,
    pad_front_k=any_float,
    pad_back_k=any_float,
    fluid_k=any_float,
    boiling_k=any_float,
    level=st.sampled_from(RiskLevel),
    reasons=st.builds(Reason, st.integers(0, 127)),
    validity=st.sampled_from(Validity),
)
status_snapshots = st.builds(
    Status,
    state=st.sampled_from(State),
    heat_mode=st.sampled_from(HeatMode),
    history_known=st.booleans(),
    compiled_kernel=st.booleans(),
    oldest_input_age_s=any_float,
    rejected_frames=st.integers(),
    dropped_frames=st.integers(),
    speed_stale=st.booleans(),
    pressure_stale=st.booleans(),
    acceleration_stale=st.booleans(),
    torque_stale=st.booleans(),
    ambient_stale=st.booleans(),
    clock_jump=st.booleans(),
    input_suspect=st.booleans(),
    model_disagrees=st.booleans(),
    heat_substituted=st.booleans(),
    unverified=st.builds(Input, st.integers(0, 31)),
)
snapshots = st.builds(
    Estimate,
    time_us=st.sampled_from(ALL_PHASES_US),
    corners=st.dictionaries(st.sampled_from(CORNERS), corner_snapshots),
    status=status_snapshots,
)


def _decoded(frame: OutputFrame) -> dict[str, Any]:
    values = DATABASE.decode_message(frame.can_id, frame.data)
    assert isinstance(values, dict)
    return values


def _second(snapshot: Estimate, *corners: str) -> dict[str, OutputFrame]:
    """Every frame of one second, by name (the last of each)."""
    publication = Publication(corners or CORNERS, ID_BASE)
    return {
        frame.name: frame
        for time_us in ALL_PHASES_US
        for frame in publication.encode(replace(snapshot, time_us=time_us))
    }


# encode and decode


@pytest.mark.slow
@given(snapshots)
def test_encode_never_raises_and_cantools_encodes_the_same_bytes(
    snapshot: Estimate,
) -> None:
    """Whatever the estimate holds, the frame obeys the DBC."""
    for frame in Publication(CORNERS, ID_BASE).encode(snapshot):
        assert len(frame.data) == 8
        assert not frame.extended
        assert DATABASE.encode_message(frame.can_id, _decoded(frame)) == (
            frame.data
        )


@given(
    st.floats(-59.9, 1900.0),
    st.floats(-59.9, 349.2),
    st.floats(-399.9, 418.5),
    st.sampled_from(Validity),
)
def test_values_survive_the_bus_within_half_a_step(
    disc_c: float, fluid_c: float, margin_k: float, validity: Validity
) -> None:
    """Resolution 0.5 K for disc and pads, 0.1 K for fluid, 0.2 K margin."""
    corner = CornerEstimate(
        disc_k=disc_c + 273.15,
        pad_front_k=disc_c + 273.15 - 1.0,
        pad_back_k=disc_c + 273.15 + 2.0,
        fluid_k=fluid_c + 273.15,
        boiling_k=fluid_c + 273.15 + margin_k,
        validity=validity,
    )
    frames = _second(Estimate(0, {"RL": corner}), "RL")

    temperatures = _decoded(frames["BSTM_RL_Temperatures"])
    risk = _decoded(frames["BSTM_RL_Risk"])

    assert temperatures["Disc"] == pytest.approx(disc_c, abs=0.2501)
    assert temperatures["PadFront"] == pytest.approx(
        max(disc_c - 1.0, -60.0), abs=0.2501
    )
    assert temperatures["PadBack"] == pytest.approx(disc_c + 2.0, abs=0.2501)
    assert temperatures["Fluid"] == pytest.approx(fluid_c, abs=0.0501)
    assert temperatures["Validity"] == validity.name.lower()
    assert risk["Margin"] == pytest.approx(margin_k, abs=0.1001)
    boiling_c = min(max(fluid_c + margin_k, -60.0), 349.2)
    assert risk["WetBoilingPoint"] == pytest.approx(boiling_c, abs=0.1001)
    assert risk["Probability"] == "not_available"


@given(status_snapshots.filter(lambda s: isfinite(s.oldest_input_age_s)))
def test_status_survives_the_bus(status: Status) -> None:
    """Every field of the status, counters clipped instead of wrapped."""
    corners = dict.fromkeys(("FL", "RR"), CornerEstimate())
    frame = _second(Estimate(0, corners, status))["BSTM_Status"]

    values = _decoded(frame)

    assert values["LayoutVersion"] == output_layout.LAYOUT_VERSION
    assert values["State"] == status.state.name.lower()
    assert values["HeatMode"] == status.heat_mode.name.lower()
    assert values["CornersModelled"] == 2
    assert values["HistoryKnown"] == ("unknown", "known")[status.history_known]
    assert values["CompiledKernel"] == (
        "compiled" if status.compiled_kernel else "python"
    )
    assert values["OldestInputAge"] == pytest.approx(
        min(max(status.oldest_input_age_s, 0.0), 25.3), abs=0.0501
    )
    assert values["RejectedFrames"] == min(max(status.rejected_frames, 0), 253)
    assert values["DroppedFrames"] == min(max(status.dropped_frames, 0), 125)
    assert values["ClockJump"] == ("jumped" if status.clock_jump else "none")
    disagrees = ("none", "disagrees")[status.model_disagrees]
    assert values["ModelDisagrees"] == disagrees
    assert values["InputSuspect"] == ("none", "suspect")[status.input_suspect]
    assert values["HeatSubstituted"] == (
        "substituted" if status.heat_substituted else "own"
    )
    for kind in ("speed", "pressure", "acceleration", "torque", "ambient"):
        stale = getattr(status, f"{kind}_stale")
        assert values[f"{kind.title()}Stale"] == (
            "stale" if stale else "fresh"
        )


@pytest.mark.parametrize(
    ("value", "sent"),
    [(nan, "not_available"), (inf, "error"), (-inf, "error")],
)
def test_a_value_that_is_no_number_is_named(value: float, sent: str) -> None:
    """NaN: there is none. Infinite: something went wrong."""
    corner = CornerEstimate(value, value, value, value, boiling_k=400.0)
    status = Status(oldest_input_age_s=value)
    frames = _second(Estimate(0, {"FL": corner}, status), "FL")

    temperatures = _decoded(frames["BSTM_FL_Temperatures"])
    risk = _decoded(frames["BSTM_FL_Risk"])

    for name in ("Disc", "PadFront", "PadBack", "Fluid"):
        assert temperatures[name] == sent
    assert risk["Margin"] == sent
    assert risk["WetBoilingPoint"] == pytest.approx(126.85, abs=0.0501)
    assert _decoded(frames["BSTM_Status"])["OldestInputAge"] == sent


@pytest.mark.parametrize(
    ("kelvin", "disc_c", "fluid_c"),
    [(0.0, -60.0, -60.0), (1e308, 1986.5, 349.3)],
)
def test_a_temperature_out_of_range_is_sent_as_the_end_of_the_range(
    kelvin: float, disc_c: float, fluid_c: float
) -> None:
    """Saturated, not wrapped, and never one of the reserved values."""
    corner = CornerEstimate(disc_k=kelvin, fluid_k=kelvin)
    frames = _second(Estimate(0, {"FR": corner}), "FR")

    values = _decoded(frames["BSTM_FR_Temperatures"])

    assert values["Disc"] == pytest.approx(disc_c)
    assert values["Fluid"] == pytest.approx(fluid_c)


def test_a_corner_without_estimate_is_not_available() -> None:
    """The frame still comes, so that its absence means a dead daemon."""
    valid = CornerEstimate(disc_k=400.0, validity=Validity.VALID)
    corners = {"FL": valid, "FR": CornerEstimate()}
    frames = _second(Estimate(0, corners), "FL", "FR")

    missing = _decoded(frames["BSTM_FR_Temperatures"])

    assert missing["Validity"] == "not_available"
    assert missing["Disc"] == "not_available"
    assert _decoded(frames["BSTM_FR_Risk"])["Level"] == "unknown"
    assert _decoded(frames["BSTM_Status"])["Validity"] == "not_available"


def test_status_carries_the_worst_validity_of_the_corners() -> None:
    """One frame tells whether all corners can be used."""
    corners = {
        "FL": CornerEstimate(validity=Validity.VALID),
        "FR": CornerEstimate(validity=Validity.DEGRADED),
    }
    frames = _second(Estimate(0, corners), "FL", "FR")

    assert _decoded(frames["BSTM_Status"])["Validity"] == "degraded"


# when, with which id and counter


def test_reasons_are_sent_corner_by_corner() -> None:
    """Bits in the order of the table; a drum has no estimate to doubt."""
    corners = {
        "FL": CornerEstimate(validity=Validity.VALID),
        "FR": CornerEstimate(
            validity=Validity.DEGRADED,
            reasons=Reason.START_UNKNOWN | Reason.MODEL_DISAGREES,
        ),
        "RL": CornerEstimate(
            validity=Validity.INVALID, reasons=Reason.HEAT_UNKNOWN
        ),
    }
    status = Status(unverified=Input.PRESSURE | Input.TEMPERATURE)

    frames = _second(Estimate(0, corners, status))

    sent = _decoded(frames["BSTM_Reasons"])
    assert sent["Validity"] == "invalid"
    assert sent["ReasonsFL"] == "none"
    assert sent["ReasonsFR"] == 33
    assert sent["ReasonsRL"] == "heat_unknown"
    assert sent["ReasonsRR"] == "not_available"
    assert sent["Unverified"] == 18


def test_cycles_hold_on_the_grid_and_nothing_is_due_off_it() -> None:
    """10, 1 and 0.1 Hz, over 30 s of 10 ms ticks."""
    publication = Publication(CORNERS, ID_BASE, requests=True)
    times: dict[str, list[int]] = {}
    for time_us in range(0, 30 * FULL_SECOND_US, 10_000):
        for name in publication.due(time_us):
            times.setdefault(name, []).append(time_us)

    for frame in FRAMES:
        steps = {b - a for a, b in pairwise(times[frame.name])}
        assert steps == {frame.cycle_us}
    assert publication.due(50_000) == ()
    assert publication.due(100_001) == ()


def test_no_tick_fills_the_transmit_queue() -> None:
    """It holds ten frames by default; two slow ones at most join a tick."""
    publication = Publication(CORNERS, ID_BASE, requests=True)

    counts = {
        len(publication.due(time_us))
        for time_us in range(0, 10_000_000, 100_000)
    }

    assert counts == {7, 8}


@given(st.integers(-(2**60), 2**60), st.permutations(CORNERS))
def test_encode_sends_what_is_due(time_us: int, corners: list[str]) -> None:
    """Also before the epoch of the clock; order of corners is no matter."""
    publication = Publication(corners, ID_BASE)

    frames = publication.encode(Estimate(time_us, {}))

    assert tuple(frame.name for frame in frames) == publication.due(time_us)
    ids = [frame.can_id for frame in frames]
    assert ids == sorted(ids)


def test_a_receiver_finds_every_frame_in_sequence_over_a_restart() -> None:
    """The counters handed over continue without a gap."""
    checkers = {
        frame.name: Profile2Checker(frame.data_ids) for frame in FRAMES
    }
    counters: dict[str, int] = {}
    statuses = []
    for run in range(3):
        publication = Publication(CORNERS, ID_BASE, counters)
        for step in range(25):
            time_us = (25 * run + step) * 100_000
            statuses += [
                checkers[frame.name].check(frame.data)
                for frame in publication.encode(Estimate(time_us, {}))
            ]
        counters = publication.counters

    assert len(statuses) == 75 * 6 + 8 * 4 + 7 * 5 + 4
    assert set(statuses) == {CheckStatus.OK}


def test_counters_start_at_zero_and_forget_foreign_names() -> None:
    """A corner that is no longer modelled leaves nothing behind."""
    publication = Publication(["FL"], ID_BASE, {"BSTM_RR_Risk": 7})

    (status, _, temperatures, _) = publication.encode(Estimate(0, {}))

    assert status.data[1] & 0x0F == 0
    assert temperatures.data[1] & 0x0F == 0
    assert set(publication.counters) == {
        "BSTM_Status",
        "BSTM_Reasons",
        "BSTM_Risk",
        "BSTM_FL_Temperatures",
        "BSTM_FL_Risk",
        "BSTM_FL_Forecast",
        "BSTM_FL_Wear",
    }


@given(st.integers(0, 0x7FF - BLOCK_IDS + 1))
def test_ids_move_with_the_base_and_the_bytes_do_not(id_base: int) -> None:
    """The data ids belong to the frame, not to the CAN id."""
    here = Publication(CORNERS, ID_BASE).encode(Estimate(100_000, {}))
    there = Publication(CORNERS, id_base).encode(Estimate(100_000, {}))

    assert [(f.can_id - id_base, f.data, f.name) for f in there] == [
        (f.can_id - ID_BASE, f.data, f.name) for f in here
    ]


@pytest.mark.parametrize("id_base", [-1, 0x7FF - BLOCK_IDS + 2, 0x7FF])
def test_a_base_that_leaves_eleven_bits_is_a_configuration_error(
    id_base: int,
) -> None:
    """The message says which bases do fit."""
    with pytest.raises(ConfigError, match=re.escape("use 0x0 to 0x7EC")):
        Publication(CORNERS, id_base)


def test_an_unknown_corner_is_refused() -> None:
    """Not silently left out."""
    with pytest.raises(ValueError, match="'XX'"):
        Publication(["FL", "XX"], ID_BASE)


def test_own_ids_are_those_sent() -> None:
    """The collision check watches what we send, reserve excluded."""
    publication = Publication(CORNERS, ID_BASE, requests=True)
    sent = {
        frame.can_id
        for time_us in range(0, 10 * FULL_SECOND_US, 100_000)
        for frame in publication.encode(Estimate(time_us, {}))
    }

    assert set(own_ids(ID_BASE, CORNERS)) == sent
    assert Publication(CORNERS, ID_BASE).ids == own_ids(ID_BASE, CORNERS)
    assert own_ids(0x100, ["RR"]) == (
        *(0x100, 0x101, 0x102, 0x103),
        *(0x107, 0x10B, 0x10F, 0x113),
    )


# risk level


@pytest.mark.parametrize("level", RiskLevel)
def test_level_is_sent_in_the_risk_frame(level: RiskLevel) -> None:
    corner = CornerEstimate(level=level, validity=Validity.VALID)
    frames = _second(Estimate(0, {"FL": corner}), "FL")

    assert _decoded(frames["BSTM_FL_Risk"])["Level"] == level.name.lower()


# each signal has its own quantity

EVERYTHING = Estimate(
    0,
    {
        "FR": CornerEstimate(
            disc_k=700.0,
            fluid_k=383.15,
            boiling_k=428.15,
            validity=Validity.DEGRADED,
            level=RiskLevel.HIGH,
            risk=CornerRisk(
                probability=0.42,
                probability_now=0.17,
                level=RiskLevel.CRITICAL,
                fade=RiskLevel.ELEVATED,
                fluid_deviation_k=6.5,
                peak_k=415.65,
                peak_in_s=540.0,
                safe_in_s=2460.0,
                duty_peak_k=466.15,
                duty_in_s=900.0,
            ),
            forecast_age_s=7.0,
            wear=WearEstimate(
                thickness_m=8.76e-3,
                std_m=0.54e-3,
                disc_loss_m=0.32e-3,
                remaining_distance_m=12.35e6,
                source=WearSource.FIRST_INDICATOR,
                level=WearLevel.CHECK,
            ),
        )
    },
    advice=Advice(
        message=Message.WAIT_BEFORE_DEPARTURE,
        sound=Sound.CHIME,
        waiting_s=754.0,
        shift_advice=Downshift.SHIFT_DOWN,
        gearbox_request=Downshift.NONE,
        front_isolation=Isolation.REQUESTED,
        emergency_assist=Assist.DETECTED,
        intervention=Intervention.ISOLATE_FRONT,
        pedal_feel=0.8,
        detector_score=0.35,
        validity=Validity.VALID,
    ),
    risk=CarRisk(
        probability=0.53,
        probability_now=0.21,
        level=RiskLevel.CRITICAL,
        boiling_k=434.15,
        boiling_low_k=406.15,
        water_percent=3.4,
    ),
)
"""Every value is unlike all others."""


@pytest.mark.parametrize(
    ("name", "sent"),
    [
        (
            "FR_Risk",
            {
                "Validity": "degraded",
                "Margin": 45.0,
                "WetBoilingPoint": 155.0,
                "Probability": 42.0,
                "Level": "high",
                "FadeLevel": "elevated",
            },
        ),
        (
            "FR_Forecast",
            {
                "Validity": "degraded",
                "Peak": 142.5,
                "PeakIn": 540,
                "SafeIn": 2460,
                "FluidDeviation": 6.5,
                "DutyPeak": 193,
                "Age": 7,
            },
        ),
        (
            "Risk",
            {
                "Validity": "degraded",
                "Probability": 53.0,
                "ProbabilityNow": 21.0,
                "Level": "critical",
                "BoilingPoint": 161,
                "BoilingPointLow": 133,
                "Water": 3.4,
            },
        ),
        (
            "FR_Wear",
            {
                "Validity": "valid",
                "PadThickness": 8.76,
                "PadThicknessStd": 0.54,
                "DiscLoss": 0.32,
                "RemainingDistance": 12350,
                "Source": "first_indicator",
                "Level": "check",
            },
        ),
        (
            "Advice",
            {
                "Validity": "valid",
                "Message": "wait_before_departure",
                "Sound": "chime",
                "ShiftAdvice": "shift_down",
                "GearboxRequest": "none",
                "FrontIsolation": "requested",
                "EmergencyAssist": "detected",
                "Intervention": "isolate_front",
                "WaitingTime": 754,
                "PedalFeel": 80.0,
                "DetectorScore": 35.0,
            },
        ),
    ],
)
def test_each_signal_carries_its_own_quantity(
    name: str, sent: dict[str, Any]
) -> None:
    """Risk, forecast, wear and advice as a receiver decodes them."""
    publication = Publication(["FR"], ID_BASE, requests=True)
    frames = {one.name: one for one in publication.encode_all(EVERYTHING)}

    found = _decoded(frames[f"BSTM_{name}"])

    assert found.keys() - sent.keys() == {"CRC", "Counter"}
    for signal, value in sent.items():
        if isinstance(value, str):
            assert found[signal] == value, signal
        else:
            assert float(found[signal]) == pytest.approx(value), signal


def test_safe_beyond_the_forecast_is_the_end_of_the_range() -> None:
    """Infinite is late, not an error; what nobody knows is no time."""
    for safe_in_s, sent in ((inf, 7500), (1e12, 7500), (nan, "not_available")):
        corner = CornerEstimate(risk=CornerRisk(safe_in_s=safe_in_s))
        frames = _second(Estimate(0, {"FL": corner}), "FL")
        found = _decoded(frames["BSTM_FL_Forecast"])
        assert found["SafeIn"] == sent


@pytest.mark.parametrize("count", range(5))
def test_corners_without_a_model_do_not_count(count: int) -> None:
    """Of a car with four brakes."""
    corners = dict.fromkeys(CORNERS[:count], CornerEstimate())

    found = _decoded(_second(Estimate(0, corners))["BSTM_Status"])

    assert found["CornersModelled"] == count


def test_a_frame_taken_back_is_sent_with_the_counter_it_had() -> None:
    """Nothing is missing for a receiver; its data stay as they were."""
    publication = Publication(["FL"], ID_BASE, {"BSTM_Status": 6})
    estimate = Estimate(0, {})
    first, *_ = publication.encode_all(estimate)
    publication.take_back([first.name])

    assert publication.counters["BSTM_Status"] == 6
    assert publication.numbered(first) == first
    assert publication.numbered(first).data[1] & 0x0F == 8
