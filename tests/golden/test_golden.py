"""Nothing that a recording gives moves unseen (README.md beside this)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from .goldens import (
    GOLDENS,
    HERE,
    RECORDINGS,
    RESULTS,
    STORED,
    Moved,
    Replayed,
    compare,
    compare_column,
    compare_frames,
    compute,
    files_of,
    layout,
    load,
    main,
    replayed,
    store,
    table,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from bstm_daemon.native.loader import Kernel

LIMIT_BYTES = 3_000_000
STATUS = "5B0"


@pytest.mark.parametrize("name", GOLDENS)
def test_is_as_stored(
    name: str, compiled: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Temperatures to 1e-6 K, each frame to the byte, results to 1e-4."""
    monkeypatch.setenv("BSTM_KERNEL", "compiled")

    moved = compare(name, load(name), compute(name))

    told = "\n".join(map(str, moved))
    assert not moved, f"{told}\n\n{table(moved)}"


LONG = {"circuits", "descent", "inputs", "stops"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    # the longest are left to .ci/full
    [
        pytest.param(one, marks=pytest.mark.full if one in LONG else ())
        for one in RECORDINGS
    ],
)
def test_both_forms_agree_to_the_bit(
    name: str,
    compiled: Kernel,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Of rows at 10 Hz and frames.

    Without the forecast: pure Python has fewer members and takes its time.
    """
    forms = {}
    for form in ("compiled", "reference"):
        monkeypatch.setenv("BSTM_KERNEL", form)
        folder = tmp_path / form
        folder.mkdir()
        forms[form] = replayed(
            RECORDINGS[name], folder, "--no-forecast", every_s=0.1
        )
    one, other = forms["compiled"], forms["reference"]

    assert list(one.columns) == list(other.columns)
    apart = [
        column
        for column, values in one.columns.items()
        if values.tobytes() != other.columns[column].tobytes()
    ]
    assert apart == []
    assert len(one.frames) > 1000
    assert [*but_for_the_form(one.frames)] == [*but_for_the_form(other.frames)]


def but_for_the_form(frames: Sequence[str]) -> Iterator[str]:
    """Yield *frames*, the status without CRC and ``CompiledKernel``."""
    for frame in frames:
        head, _, data = frame.partition("#")
        if head.endswith(STATUS):
            octets = bytearray.fromhex(data)
            octets[0] = 0
            octets[3] &= 0x7F
            yield f"{head}#{octets.hex()}"
        else:
            yield frame


def test_all_of_them_are_small() -> None:
    files = [path for path in HERE.rglob("*") if path.is_file()]
    stored = [path for path in files if "__pycache__" not in path.parts]

    assert sum(path.stat().st_size for path in stored) <= LIMIT_BYTES


def test_nothing_is_stored_that_no_golden_has() -> None:
    expected = {path for name in GOLDENS for path in files_of(name)}

    assert set(STORED.iterdir()) == expected


def test_each_frame_of_the_layout_is_there_and_moves() -> None:
    """A formula behind a frame that never changes could be anything."""
    seen: dict[int, set[str]] = {}
    for name in RECORDINGS:
        for line in recording(name).frames:
            can_id, data = line.split()[2].split("#")
            # without CRC and counter
            seen.setdefault(int(can_id, 16), set()).add(data[3:])
    named = {
        message.name: len(seen.get(message.frame_id, ()))
        for message in layout().messages
    }

    assert min(named.values()) > 3, named


def test_each_column_moves_in_some_recording() -> None:
    """Of some corner: neither empty nor the same everywhere."""
    seen: dict[str, set[float]] = {}
    for name in RECORDINGS:
        for column, values in recording(name).columns.items():
            distinct = np.unique(values[np.isfinite(values)]).tolist()
            seen.setdefault(column.rpartition(".")[2], set()).update(distinct)

    assert [column for column, found in seen.items() if len(found) < 2] == []


def recording(name: str) -> Replayed:
    """Return what is stored of a replay."""
    found = load(name)
    assert isinstance(found, Replayed)
    return found


# -- what is told of something that moved ------------------------------------


def moved_column(column: str, old: list[float], new: list[float]) -> Moved:
    """Return what is found of *new* at rows of 2 s."""
    time_s = 2.0 * np.arange(len(old), dtype=float)
    found = compare_column("own", column, time_s, np.array(old), np.array(new))
    assert found is not None
    return found


def test_a_temperature_that_moved_is_told_in_kelvin() -> None:
    found = moved_column(
        "FL.disc_c", [20.0, 300.0, 310.0], [20.0, 300.25, 309.0]
    )

    assert str(found) == (
        "own: FL.disc_c moved by 1 K, "
        "first at 2.0 s: 300 is stored, 300.25 is now"
    )


def test_a_power_that_moved_is_told_as_the_energy_it_makes() -> None:
    """10 W over 2 s more, then 30 W over 2 s less: +20 J, then -40 J."""
    found = moved_column(
        "FL.brake_power_w", [0.0, 50.0, 90.0], [0.0, 60.0, 60.0]
    )

    assert (found.amount, found.unit) == (40.0, "J")


def test_a_value_that_came_or_went_is_told() -> None:
    nan = math.nan
    found = moved_column("FL.peak_c", [nan, 80.0, nan], [nan, nan, 80.0])

    assert (found.amount, found.unit) == (2.0, "rows")


def test_of_a_kind_every_row_counts() -> None:
    found = moved_column("flags", [0.0, 2.0**45, 1.0], [0.0, 2.0**45 + 1, 0.0])

    assert (found.amount, found.unit) == (2.0, "rows")


def test_what_is_within_the_tolerance_has_not_moved() -> None:
    time_s = np.arange(2.0)
    old = np.array([20.0, 500.0])

    for column, room in (("FL.disc_c", 1e-6), ("distance_m", 500e-6)):
        for times, held in ((0.9, True), (1.1, False)):
            new = old + np.array([0.0, times * room])
            found = compare_column("own", column, time_s, old, new)
            assert (found is None) == held


def test_a_frame_that_moved_is_told_with_its_signals() -> None:
    old = [
        "(10.100000) can0 5B4#EA108CC0088CC02B",
        "(10.200000) can0 5B4#EA118CC0088CC02B",
    ]
    new = [old[0], "(10.200000) can0 5B4#EA118DC0088CC02B"]

    (found,) = compare_frames("own", old, new)

    assert found.what == "frame 5B4 BSTM_FL_Temperatures"
    assert (found.amount, found.unit) == (1, "frames")
    assert found.first == (
        "first at 0.1 s: can0 EA118CC0088CC02B is stored, "
        "can0 EA118DC0088CC02B is now (Disc 10.0 to 10.5)"
    )
    (turned,) = compare_frames("own", old, old[::-1])
    assert (turned.what, turned.amount) == ("order of frames", 2)


def test_a_number_of_a_result_moves_beyond_its_share() -> None:
    old = {"corners": [{"rms_k": {"disc": 2.0}, "energy_j": 1e5}]}
    new = {"corners": [{"rms_k": {"disc": 2.0001}, "energy_j": 1.1e5}]}

    (found,) = compare("gap", old, new)

    assert found.what == "corners[0].energy_j"
    assert (found.amount, found.unit) == (pytest.approx(1e4), "J")
    held = {"corners": [{"rms_k": {"disc": 2.0001}, "energy_j": 1e5}]}
    assert compare("gap", old, held) == []
    (alone,) = compare("heat", old, held)
    assert (alone.what, alone.unit) == ("corners[0].rms_k.disc", "K")


@pytest.mark.slow
def test_refresh_tells_what_moved_and_mends_it(
    compiled: Kernel,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A stored temperature off by 0.5 K, a power by 100 W for a second."""
    monkeypatch.setenv("BSTM_KERNEL", "compiled")
    # the last bit of a computer's arithmetic is its own
    store("subaru", compute("subaru"), tmp_path)
    right = [path.read_bytes() for path in files_of("subaru", tmp_path)]
    wrong = recording("subaru")
    wrong.columns["FL.fluid_c"][20] += 0.5
    wrong.columns["RR.brake_power_w"][7] -= 100.0
    store("subaru", wrong, tmp_path)
    there = ["subaru", "--folder", str(tmp_path)]

    assert main([*there, "--check"]) == 1
    assert main(there) == 0

    told = """\
golden  what              moved by at most
subaru  FL.fluid_c                     0.5 K
subaru  RR.brake_power_w               100 J
"""
    assert capsys.readouterr().out == told * 2
    assert main([*there, "--check"]) == 0
    assert capsys.readouterr().out == "nothing moved\n"
    assert [p.read_bytes() for p in files_of("subaru", tmp_path)] == right


def test_all_kinds_of_results_are_golden() -> None:
    assert set(RESULTS) == {"match", "gap", "heat"}
    assert len(RECORDINGS) == 6
