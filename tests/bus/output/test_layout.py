"""The table of output frames against dbc/bstm.dbc and docs/frames.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from cantools.database.can import Database, Message

from bstm_daemon.bus.output.layout import (
    CORNERS,
    LAYOUT_VERSION,
    Frame,
    published_frames,
)

ROOT = Path(__file__).parents[3]
ID_BASE = 0x5B0
FRAMES = published_frames(CORNERS)

DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")


def _attributes(message: Message) -> dict[str, Any]:
    assert message.dbc is not None
    return message.dbc.attributes


def test_dbc_has_exactly_the_frames_of_the_table() -> None:
    """Names, ids, length, cycle time, data ids, send type."""
    ours = {
        frame.name: (
            ID_BASE + frame.id_offset,
            8,
            frame.cycle_us // 1000,
            ",".join(map(str, frame.data_ids)),
        )
        for frame in FRAMES
    }
    theirs = {
        message.name: (
            message.frame_id,
            message.length,
            message.cycle_time,
            _attributes(message)["E2EDataIDList"].value,
        )
        for message in DATABASE.messages
    }

    assert theirs == ours
    assert not any(m.is_extended_frame for m in DATABASE.messages)
    assert all(m.send_type == "Cyclic" for m in DATABASE.messages)
    assert DATABASE.dbc is not None
    assert DATABASE.dbc.attribute_definitions["E2EProfile"].default_value == 2


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.name)
def test_dbc_agrees_with_the_table_signal_by_signal(frame: Frame) -> None:
    """Start, length, order, sign, scale, offset, unit, choices, comment."""
    message = DATABASE.get_message_by_name(frame.name)

    assert [
        (
            signal.name,
            signal.start,
            signal.length,
            signal.byte_order,
            signal.is_signed,
            float(signal.scale),
            float(signal.offset),
            signal.unit or "",
            {int(k): str(v) for k, v in (signal.choices or {}).items()},
        )
        for signal in message.signals
    ] == [
        (
            signal.name,
            signal.start,
            signal.length,
            "little_endian",
            False,
            signal.scale,
            signal.offset,
            signal.unit,
            dict(signal.choices),
        )
        for signal in frame.signals
    ]
    assert message.comment
    assert all(signal.comment for signal in message.signals)


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.name)
def test_dbc_range_ends_where_saturation_begins(frame: Frame) -> None:
    """A quantity far out of range is sent as the DBC's minimum or maximum."""
    message = DATABASE.get_message_by_name(frame.name)
    for signal in frame.signals:
        if "error" not in signal.choices.values():
            continue
        theirs = message.get_signal_by_name(signal.name)
        for value, end in ((-1e9, theirs.minimum), (1e9, theirs.maximum)):
            sent = signal.raw(value) * signal.scale + signal.offset
            assert sent == pytest.approx(end)


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: frame.name)
def test_signals_do_not_overlap_and_stay_in_the_frame(frame: Frame) -> None:
    """Integer packing ORs the signals: an overlap would corrupt both."""
    used = [
        bit
        for signal in frame.signals
        for bit in range(signal.start, signal.start + signal.length)
    ]

    assert len(used) == len(set(used))
    assert max(used) < 64


def test_document_names_every_frame_with_offset_and_signals() -> None:
    """docs/frames.md is what people implement a receiver from."""
    text = (ROOT / "docs" / "frames.md").read_text(encoding="utf-8")
    rows = {
        tuple(cell.strip(" `") for cell in line.strip("| \n").split("|"))
        for line in text.splitlines()
        if line.startswith("|")
    }

    offsets = text.partition("## Conventions")[0]
    for frame in FRAMES:
        _, corner, *kind = frame.name.split("_")
        name = f"BSTM_<corner>_{kind[0]}" if kind else frame.name
        (row,) = (line for line in offsets.splitlines() if f"`{name}`" in line)
        assert (
            f"`0x{frame.id_offset:02X}`{f' {corner}' if kind else ''}" in row
        )
        for signal in frame.signals:
            place = f"{signal.start}", f"{signal.length}"
            assert any(row[:3] == (signal.name, *place) for row in rows)
    version = f"version of this layout, {LAYOUT_VERSION}"
    assert ("LayoutVersion", "16", "4", version) in rows


def test_document_has_the_rule_of_the_data_ids() -> None:
    text = (ROOT / "docs" / "frames.md").read_text(encoding="utf-8")
    rule = text.partition("Entry c, counter")[2].partition(". ")[0]
    masks = [int(mask, 16) for mask in re.findall(r"0x[0-9A-F]{2}", rule)]

    assert len(masks) == 4
    for frame in FRAMES:
        for counter, data_id in enumerate(frame.data_ids):
            expected = frame.id_offset
            for bit, mask in enumerate(masks):
                expected ^= mask if counter >> bit & 1 else 0
            assert data_id == expected


def _worst_case_bits(data_bytes: int) -> int:
    """Bits of a standard frame with the most stuff bits, pause included.

    Davis et al. 2007: 34 bits of the frame and the data are open to stuffing,
    a stuff bit after the first five and then after every four at worst; 10
    bits of delimiters and end of frame, 3 of intermission.
    """
    stuffed = 34 + 8 * data_bytes
    return stuffed + (stuffed - 1) // 4 + 10 + 3


def test_bus_load_is_within_the_contract() -> None:
    """At most 3 % of 500 kbit/s with four corners."""
    frames_per_s = sum(1_000_000 / f.cycle_us for f in FRAMES)

    load = frames_per_s * _worst_case_bits(8) / 500_000

    assert _worst_case_bits(8) == 135
    assert frames_per_s == pytest.approx(70.4)
    assert load == pytest.approx(0.019008)
    assert load < 0.03


def test_document_states_the_load() -> None:
    """The figure in docs/frames.md is the computed one."""
    text = (ROOT / "docs" / "frames.md").read_text(encoding="utf-8")

    assert "1.90 %" in text
