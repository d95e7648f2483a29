"""Profile 2 against cantools' own implementation, and the checker."""

from itertools import combinations

import pytest
from cantools.autosar.end_to_end import (
    apply_profile2_crc,
    check_profile2_crc,
    compute_profile2_crc,
)
from cantools.database.can import Message
from cantools.database.can.formats.arxml import (
    end_to_end_properties,
    message_specifics,
)
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.output.e2e import (
    COUNTER_COUNT,
    CheckStatus,
    Profile2Checker,
    profile2_crc,
    protect,
)
from bstm_daemon.bus.output.layout import CORNERS, Frame, published_frames

payloads = st.binary(min_size=8, max_size=8)
counters = st.integers(0, COUNTER_COUNT - 1)
own_frames = st.sampled_from(published_frames(CORNERS))
any_ids = st.lists(st.integers(0, 255), min_size=16, max_size=16)


def _autosar_message(data_ids: list[int]) -> Message:
    properties = end_to_end_properties.AutosarEnd2EndProperties()
    properties.category = "PROFILE_02"
    properties.data_ids = data_ids
    properties.payload_length = 8
    specifics = message_specifics.AutosarMessageSpecifics()
    specifics._e2e = properties
    return Message(0x5B0, "M", 8, [], autosar_specifics=specifics)


def _flip(data: bytes, bits: tuple[int, ...]) -> bytes:
    number = int.from_bytes(data, "little")
    for bit in bits:
        number ^= 1 << bit
    return number.to_bytes(8, "little")


def test_crc_has_the_check_value_of_the_catalogue() -> None:
    """CRC-8/AUTOSAR of "123456789" is 0xDF."""
    assert profile2_crc(b"\0" + b"12345678", ord("9")) == 0xDF


@given(st.binary(min_size=2, max_size=64), st.integers(0, 255))
def test_crc_equals_cantools(data: bytes, data_id: int) -> None:
    """Any length, any data id."""
    assert profile2_crc(data, data_id) == compute_profile2_crc(data, data_id)


@given(payloads, counters, any_ids)
def test_protect_equals_cantools(
    data: bytes, counter: int, data_ids: list[int]
) -> None:
    """Cantools picks the data id by the counter as we do."""
    message = _autosar_message(data_ids)

    frame = protect(data, counter, data_ids)

    assert frame[1] == (data[1] & 0xF0) | counter
    assert frame[2:] == data[2:]
    assert check_profile2_crc(frame, message)
    assert apply_profile2_crc(frame, message) == bytearray(frame)


@pytest.mark.parametrize("counter", [-1, 16])
def test_protect_refuses_a_counter_out_of_range(counter: int) -> None:
    """A counter above 15 would spill into the validity."""
    with pytest.raises(ValueError, match=r"0\.\.15"):
        protect(bytes(8), counter, range(16))


def test_protect_refuses_a_frame_without_room() -> None:
    """CRC and counter need two bytes."""
    with pytest.raises(ValueError, match="at least 2 bytes"):
        protect(b"\0", 0, range(16))


@given(
    payloads,
    counters,
    own_frames,
    st.lists(st.integers(0, 63), min_size=1, max_size=3, unique=True),
)
def test_up_to_three_flipped_bits_are_detected(
    data: bytes, counter: int, frame: Frame, bits: list[int]
) -> None:
    """Any of the 64 bits, CRC and counter included."""
    protected = protect(data, counter, frame.data_ids)

    damaged = _flip(protected, tuple(bits))

    checker = Profile2Checker(frame.data_ids)
    assert checker.check(protected) is CheckStatus.OK
    assert checker.check(damaged) is CheckStatus.WRONG_CRC


def test_every_error_of_up_to_three_bits_is_detected() -> None:
    """All 43 744 patterns; the code is linear, so one payload stands for all.

    A list of data ids not chosen for it would let some flips of a counter bit
    through, because the wrong counter also picks the wrong data id.
    """
    frame = published_frames(CORNERS)[0]
    protected = protect(bytes(range(8)), 5, frame.data_ids)
    ids = frame.data_ids

    undetected = [
        bits
        for count in (1, 2, 3)
        for bits in combinations(range(64), count)
        if (damaged := _flip(protected, bits))[0]
        == profile2_crc(damaged, ids[damaged[1] & 0x0F])
    ]

    assert undetected == []


@given(payloads, counters, own_frames, own_frames)
def test_a_frame_of_another_message_is_refused(
    data: bytes, counter: int, sent: Frame, expected: Frame
) -> None:
    """At every counter the data ids of two messages differ."""
    status = Profile2Checker(expected.data_ids).check(
        protect(data, counter, sent.data_ids)
    )

    wanted = CheckStatus.OK if sent is expected else CheckStatus.WRONG_CRC
    assert status is wanted


IDS = tuple(range(100, 116))


@given(counters, st.integers(0, 15), st.integers(1, 14))
def test_counter_delta_decides(last: int, delta: int, max_delta: int) -> None:
    """0 repeated, up to max_delta ok, above wrong sequence."""
    checker = Profile2Checker(IDS, max_delta=max_delta)
    checker.check(protect(bytes(8), last, IDS))

    status = checker.check(protect(bytes(8), (last + delta) % 16, IDS))

    if delta == 0:
        assert status is CheckStatus.REPEATED
    elif delta <= max_delta:
        assert status is CheckStatus.OK
    else:
        assert status is CheckStatus.WRONG_SEQUENCE


def test_checker_follows_a_sender_over_the_wrap() -> None:
    """40 frames in sequence are 40 times ok."""
    checker = Profile2Checker(IDS)

    statuses = {
        checker.check(protect(bytes(8), n % 16, IDS)) for n in range(40)
    }

    assert statuses == {CheckStatus.OK}


def test_checker_is_in_step_again_after_a_jump() -> None:
    """A wrong sequence is reported once."""
    checker = Profile2Checker(IDS)

    statuses = [
        checker.check(protect(bytes(8), counter, IDS))
        for counter in (3, 9, 10)
    ]

    assert statuses == [
        CheckStatus.OK,
        CheckStatus.WRONG_SEQUENCE,
        CheckStatus.OK,
    ]


def test_a_damaged_frame_does_not_move_the_counter() -> None:
    """The frame after it is one too far for max_delta 1, fine for 2."""
    first, second, third = (
        protect(bytes(8), counter, IDS) for counter in (1, 2, 3)
    )
    damaged = _flip(second, (40,))

    def statuses(max_delta: int) -> list[CheckStatus]:
        checker = Profile2Checker(IDS, max_delta=max_delta)
        return [checker.check(frame) for frame in (first, damaged, third)]

    wrong = CheckStatus.WRONG_CRC
    assert statuses(1) == [CheckStatus.OK, wrong, CheckStatus.WRONG_SEQUENCE]
    assert statuses(2) == [CheckStatus.OK, wrong, CheckStatus.OK]


@given(st.binary(max_size=12).filter(lambda data: len(data) != 8))
def test_a_frame_of_another_length_is_refused(data: bytes) -> None:
    """Even where its CRC would fit; short frames raise nothing."""
    if len(data) >= 2:
        data = protect(data, 0, IDS)

    assert Profile2Checker(IDS).check(data) is CheckStatus.WRONG_CRC
