"""Our own frames read back, against the sender and against cantools."""

from __future__ import annotations

from math import inf, isfinite, isinf, isnan, nan
from pathlib import Path

import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.output.e2e import COUNTER_COUNT, CheckStatus, protect
from bstm_daemon.bus.output.layout import CORNERS, published_frames
from bstm_daemon.bus.output.publication import OutputFrame, Publication
from bstm_daemon.bus.output.published import PublishedDecoder, PublishedFrame
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimate import (
    CornerEstimate,
    Estimate,
    HeatMode,
    RiskLevel,
    State,
    Status,
    Validity,
)

ID_BASE = 0x5B0
FRAMES = published_frames(CORNERS)
SECOND_US = range(0, 1_000_000, 100_000)

DATABASE = Database()
DATABASE.add_dbc_file(Path(__file__).parents[3] / "dbc" / "bstm.dbc")

any_float = st.floats(allow_nan=True, allow_infinity=True)
corners = st.builds(
    CornerEstimate()._replace,
    disc_k=any_float,
    pad_front_k=any_float,
    pad_back_k=any_float,
    fluid_k=any_float,
    boiling_k=any_float,
    validity=st.sampled_from(Validity),
)


def sent(
    corner: CornerEstimate, status: Status, corner_name: str = "FL"
) -> list[OutputFrame]:
    """Return the frames of a whole second, advice included."""
    publication = Publication([corner_name], ID_BASE, requests=True)
    return [
        frame
        for time_us in SECOND_US
        for frame in publication.encode(
            Estimate(time_us, {corner_name: corner}, status)
        )
    ]


def read(frames: list[OutputFrame]) -> dict[str, PublishedFrame]:
    """Return the last frame of each name, all of them checked as good."""
    decoder = PublishedDecoder(ID_BASE)
    found = {}
    for frame in frames:
        decoded = decoder.decode(frame.can_id, frame.data)
        assert decoded is not None
        assert decoded.layout.name == frame.name
        assert decoded.usable
        found[frame.name] = decoded
    return found


def agrees(value: float, given_value: float, step: float, top: float) -> bool:
    """Whether *value* is what a receiver shall see of *given_value*."""
    if isnan(given_value):
        return isnan(value)
    if isinf(given_value):
        return value == inf
    bottom = -400.0 if step == pytest.approx(0.2) else -60.0
    clipped = min(max(given_value, bottom), top)
    return abs(value - clipped) <= step / 2 + 1e-9


@given(corner=corners, known=st.booleans(), age_s=any_float)
def test_what_was_published_is_read(
    corner: CornerEstimate,
    known: bool,  # noqa: FBT001
    age_s: float,
) -> None:
    status = Status(
        State.RUNNING,
        HeatMode.FB,
        history_known=known,
        oldest_input_age_s=age_s,
        rejected_frames=7,
        torque_stale=True,
    )

    found = read(sent(corner, status))

    values = found["BSTM_FL_Temperatures"].values
    assert values["Validity"] == corner.validity
    solid_c = {
        "Disc": corner.disc_k,
        "PadFront": corner.pad_front_k,
        "PadBack": corner.pad_back_k,
    }
    for name, kelvin in solid_c.items():
        assert agrees(values[name], kelvin - 273.15, 0.5, 1986.5)
    assert agrees(values["Fluid"], corner.fluid_k - 273.15, 0.1, 349.3)
    risk = found["BSTM_FL_Risk"].values
    assert agrees(risk["Margin"], corner.margin_k, 0.2, 418.6)
    assert isnan(risk["Probability"])
    state = found["BSTM_Status"].values
    assert state["HistoryKnown"] == known
    assert state["State"] == State.RUNNING
    assert state["HeatMode"] == HeatMode.FB
    assert (state["SpeedStale"], state["TorqueStale"]) == (0, 1)
    assert state["RejectedFrames"] == 7
    if isfinite(age_s) and 0 <= age_s <= 25.3:
        assert state["OldestInputAge"] == pytest.approx(age_s, abs=0.0501)


@given(
    can_id=st.integers(0, 0x7FF) | st.sampled_from(range(0x5B0, 0x5C4)),
    data=st.binary(max_size=64),
    extended=st.booleans(),
)
def test_no_frame_raises(
    can_id: int,
    data: bytes,
    extended: bool,  # noqa: FBT001
) -> None:
    frame = PublishedDecoder(ID_BASE).decode(can_id, data, extended=extended)

    if frame is not None:
        assert not extended
        assert frame.verdict in (CheckStatus.OK, CheckStatus.WRONG_CRC)
        assert bool(frame.values) == frame.usable


@given(
    frame=st.sampled_from(FRAMES),
    data=st.binary(min_size=8, max_size=8),
    counter=st.integers(0, COUNTER_COUNT - 1),
)
def test_protected_noise_reads_as_cantools_reads_it(
    frame: object, data: bytes, counter: int
) -> None:
    layout = next(one for one in FRAMES if one is frame)
    noise = protect(data, counter, layout.data_ids)

    read_frame = PublishedDecoder(ID_BASE).decode(
        ID_BASE + layout.id_offset, noise
    )

    assert read_frame is not None
    assert read_frame.usable
    message = DATABASE.get_message_by_name(layout.name)
    expected = message.decode(noise, decode_choices=False)
    assert isinstance(expected, dict)
    for signal in layout.signals[2:]:
        value = read_frame.values[signal.name]
        if isfinite(value):
            assert value == pytest.approx(expected[signal.name])
        else:
            raw = int.from_bytes(noise, "little") >> signal.start
            raw &= signal.not_available
            top = signal.error - 1
            if signal.maximum is not None:
                top = round((signal.maximum - signal.offset) / signal.scale)
            assert raw > top
            assert isnan(value) == (raw == signal.not_available)


def test_no_signal_is_left_out() -> None:
    found = read(sent(CornerEstimate(), Status()))

    for frame in published_frames(["FL"]):
        names = [signal.name for signal in frame.signals[2:]]
        assert list(found[frame.name].values) == names


@pytest.mark.parametrize("bit", range(64))
def test_a_flipped_bit_gives_no_values(bit: int) -> None:
    good = sent(CornerEstimate(disc_k=400.0), Status())[1]
    flipped = int.from_bytes(good.data, "little") ^ 1 << bit

    frame = PublishedDecoder(ID_BASE).decode(
        good.can_id, flipped.to_bytes(8, "little")
    )

    assert frame is not None
    assert frame.verdict is CheckStatus.WRONG_CRC
    assert frame.values == {}


def test_sequence() -> None:
    frames = [
        frame
        for frame in sent(CornerEstimate(), Status())
        if frame.name == "BSTM_Status"
    ]
    decoder = PublishedDecoder(ID_BASE)

    data = [frame.data for frame in frames]
    data.append(_after(frames[-1]))
    verdicts = []
    for place in (0, 0, 1, 4, 9, 10):
        frame = decoder.decode(ID_BASE, data[place])
        assert frame is not None
        verdicts.append(frame.verdict)

    assert verdicts == [
        CheckStatus.OK,
        CheckStatus.REPEATED,
        CheckStatus.OK,
        CheckStatus.OK,
        CheckStatus.WRONG_SEQUENCE,
        CheckStatus.OK,
    ]


def _after(frame: OutputFrame) -> bytes:
    counter = (frame.data[1] + 1) % COUNTER_COUNT
    return protect(frame.data, counter, FRAMES[0].data_ids)


def test_choices_stay_numbers() -> None:
    found = read(sent(CornerEstimate(), Status()))

    assert found["BSTM_FL_Risk"].values["Level"] == RiskLevel.UNKNOWN
    assert found["BSTM_Status"].values["HeatMode"] == HeatMode.NOT_AVAILABLE
    assert isnan(found["BSTM_Status"].values["OldestInputAge"])
    nothing = sent(CornerEstimate(disc_k=nan, fluid_k=inf), Status())
    temperatures = read(nothing)["BSTM_FL_Temperatures"].values
    assert isnan(temperatures["Disc"])
    assert temperatures["Fluid"] == inf


def test_foreign_ids_are_none_of_ours() -> None:
    decoder = PublishedDecoder(0x100, ["RR"])

    assert decoder.ids == (
        *(0x100, 0x101, 0x102, 0x103),
        *(0x107, 0x10B, 0x10F, 0x113),
    )
    assert decoder.decode(0x5B0, bytes(8)) is None
    assert decoder.decode(0x104, bytes(8)) is None
    assert decoder.decode(0x100, bytes(8), extended=True) is None


def test_a_base_that_does_not_fit() -> None:
    with pytest.raises(ConfigError, match="id_base"):
        PublishedDecoder(0x7F0)
