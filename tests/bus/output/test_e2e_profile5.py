"""Profile 5 against the specification and cantools, and the checker."""

import pytest
from cantools.autosar.end_to_end import compute_profile5_crc
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.output.e2e import (
    CheckStatus,
    Profile5Checker,
    profile5_crc,
)

DATA_ID = 0x1234


def protected(
    data: bytes, counter: int, offset_bytes: int = 0, data_id: int = DATA_ID
) -> bytes:
    """Return *data* with counter and CRC filled in, as a sender does."""
    frame = bytearray(data)
    frame[offset_bytes + 2] = counter
    crc = profile5_crc(frame, data_id, offset_bytes)
    frame[offset_bytes : offset_bytes + 2] = crc.to_bytes(2, "little")
    return bytes(frame)


@pytest.mark.parametrize(
    ("length", "offset_bytes", "crc"),
    [(8, 0, 0xCA1C), (16, 8, 0x9128)],
)
def test_crc_is_that_of_the_specification(
    length: int, offset_bytes: int, crc: int
) -> None:
    """AUTOSAR PRS E2E Protocol, examples of Profile 5: id 0x1234, zeros."""
    assert profile5_crc(bytes(length), DATA_ID, offset_bytes) == crc


def test_crc_has_the_check_value_of_the_catalogue() -> None:
    """CRC-16/CCITT-FALSE of "123456789" is 0x29B1; "89" is the id."""
    data_id = int.from_bytes(b"89", "little")

    assert profile5_crc(b"\0\x001234567", data_id) == 0x29B1


@given(st.binary(min_size=4, max_size=64), st.integers(0, 0xFFFF))
def test_crc_equals_cantools(data: bytes, data_id: int) -> None:
    """Any length, any data id, at offset 0."""
    assert profile5_crc(data, data_id) == compute_profile5_crc(data, data_id)


@given(st.binary(min_size=12, max_size=64), st.integers(0, 9))
def test_the_offset_only_moves_the_header(data: bytes, offset: int) -> None:
    """The CRC bytes do not count, wherever they lie."""
    moved = data[offset : offset + 2] + data[:offset] + data[offset + 2 :]

    assert profile5_crc(data, DATA_ID, offset) == profile5_crc(moved, DATA_ID)


@given(
    st.binary(min_size=12, max_size=12),
    st.integers(0, 255),
    st.integers(0, 9),
    st.lists(st.integers(0, 95), min_size=1, max_size=3, unique=True),
)
def test_up_to_three_flipped_bits_are_detected(
    data: bytes, counter: int, offset: int, bits: list[int]
) -> None:
    """Any of the bits, CRC and counter included."""
    frame = protected(data, counter, offset)
    number = int.from_bytes(frame, "little")
    for bit in bits:
        number ^= 1 << bit
    checker = Profile5Checker(DATA_ID, length=12, offset_bytes=offset)

    assert checker.check(number.to_bytes(12, "little")) is (
        CheckStatus.WRONG_CRC
    )
    assert checker.check(frame) is CheckStatus.OK


def test_another_id_and_another_length_are_refused() -> None:
    checker = Profile5Checker(DATA_ID, length=8)

    assert checker.check(protected(bytes(8), 0, data_id=0x3412)) is (
        CheckStatus.WRONG_CRC
    )
    assert checker.check(protected(bytes(12), 0)) is CheckStatus.WRONG_CRC


@given(st.integers(0, 255), st.integers(0, 255), st.integers(1, 14))
def test_counter_delta_decides(last: int, delta: int, max_delta: int) -> None:
    """0 repeated, up to max_delta ok, above wrong sequence; then in step."""
    checker = Profile5Checker(DATA_ID, length=8, max_delta=max_delta)
    checker.check(protected(bytes(8), last))
    counter = (last + delta) % 256

    status = checker.check(protected(bytes(8), counter))

    if delta == 0:
        assert status is CheckStatus.REPEATED
    elif delta <= max_delta:
        assert status is CheckStatus.OK
    else:
        assert status is CheckStatus.WRONG_SEQUENCE
    after = protected(bytes(8), (counter + 1) % 256)
    assert checker.check(after) is CheckStatus.OK


def test_checker_follows_a_sender_over_the_wrap() -> None:
    checker = Profile5Checker(DATA_ID, length=8)

    statuses = {
        checker.check(protected(bytes(8), n % 256)) for n in range(600)
    }

    assert statuses == {CheckStatus.OK}


def test_a_header_that_does_not_fit_is_an_error() -> None:
    with pytest.raises(ValueError, match="needs at least 9 bytes, got 8"):
        Profile5Checker(DATA_ID, length=8, offset_bytes=6)
