"""Channels with time bases of their own: AiM XRK and signals of MF4."""

import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from bstm_daemon.bus.tables.channels import Mf4Source, XrkSource
from bstm_daemon.errors import LogError, MissingExtraError

Reader = Callable[..., Any]

ROLES = {
    "vehicle_speed": {"column": "Speed", "unit": "km/h"},
    "primary_pressure": {"column": "Brake", "unit": "bar"},
}
KMH, BAR, UNKNOWN = 16, 14, 100
"""Codes of AiM's units; the last is none."""
EXPECTED = [
    (0.0, "vehicle_speed", 10.0),
    (0.0, "primary_pressure", 0.0),
    (pytest.approx(0.02), "primary_pressure", 1e5),
    (pytest.approx(0.04), "primary_pressure", 2e5),
    (pytest.approx(0.05), "vehicle_speed", 20.0),
]


def message(token: bytes, data: bytes) -> bytes:
    token = token.ljust(4, b"\0")
    begin = b"<h" + token + struct.pack("<iB", len(data), 1) + b">"
    return begin + data + b"<" + token + struct.pack("<H", sum(data)) + b">"


def channel(index: int, name: str, unit: int) -> bytes:
    """Describe a channel of single-precision numbers."""
    data = bytearray(112)
    struct.pack_into("<H", data, 0, index)
    data[12], data[20], data[72] = unit, 6, 4
    data[24 : 24 + len(name)] = data[32 : 32 + len(name)] = name.encode()
    struct.pack_into("<I", data, 64, 20_000)
    return message(b"CHS", bytes(data))


def write_xrk(
    path: Path, pressure_unit: int = BAR, *, gps: bool = True
) -> Path:
    """Write a recording of two channels of different rate."""
    content = message(
        b"CNF", channel(0, "Speed", KMH) + channel(1, "Brake", pressure_unit)
    )
    for time_ms, index, value in (
        *((0, 0, 36.0), (0, 1, 0.0), (20, 1, 1.0)),
        *((40, 1, 2.0), (50, 0, 72.0)),
    ):
        content += struct.pack("<2siHf", b"(S", time_ms, index, value) + b")"
    if gps:
        fix = struct.pack(
            "<i12x3i4x3i12x", 0, 4 * 10**8, 10**8, 4867 * 10**5, 9, 9, 9
        )
        content += message(b"GPS", fix) + message(b"TRK", bytes(96))
    packed = path.suffix == ".xrz"
    path.write_bytes(zlib.compress(content) if packed else content)
    return path


@pytest.mark.parametrize("ending", [".xrk", ".XRK", ".xrz"])
@pytest.mark.parametrize("gps", [True, False])
def test_an_aim_recording_gives_its_samples(
    tmp_path: Path, samples_of: Reader, ending: str, *, gps: bool
) -> None:
    pytest.importorskip("libxrk")
    path = write_xrk(tmp_path / f"a{ending}", gps=gps)

    assert samples_of(path, ROLES) == EXPECTED


def test_units_of_an_aim_recording(tmp_path: Path) -> None:
    pytest.importorskip("libxrk")

    with capture_logs() as logs:
        source = XrkSource(write_xrk(tmp_path / "a.xrk", UNKNOWN))

    units = source.units()
    assert source.names()[0] == "time"
    assert {"Speed", "Brake", "GPS Speed"} < set(source.names())
    assert (units["time"], units["Speed"]) == ("s", "km/h")
    assert units["GPS Speed"] == "m/s"
    assert "Brake" not in units
    assert ["Unknown units[100]" in one["message"] for one in logs] == [True]


@pytest.mark.parametrize("content", [b"text", bytes(range(256)), b"<hCNF"])
def test_what_is_no_aim_recording_is_named(
    tmp_path: Path, samples_of: Reader, content: bytes
) -> None:
    pytest.importorskip("libxrk")
    path = tmp_path / "a.xrk"
    path.write_bytes(content)

    with pytest.raises(LogError, match=r"a\.xrk: damaged or no AiM recording"):
        samples_of(path, ROLES)


def test_a_missing_package_is_named_with_the_command(
    tmp_path: Path, samples_of: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "libxrk", None)

    with pytest.raises(
        MissingExtraError, match=r"pip install 'bstm-daemon\[track\]'"
    ):
        samples_of(write_xrk(tmp_path / "a.xrk"), ROLES)


def write_mf4(path: Path) -> Path:
    """Write two groups of signals; one sample is invalid."""
    asammdf = pytest.importorskip("asammdf")
    mdf = asammdf.MDF(version="4.11")
    slow, fast = np.array([0.0, 0.05]), np.array([0.0, 0.02, 0.03, 0.04])
    gear = {"val_0": 0, "text_0": b"N", "val_1": 1, "text_1": b"1st"}
    mdf.append(
        [
            asammdf.Signal(np.array([36.0, 72.0]), slow, "km/h", "Speed"),
            asammdf.Signal(
                np.array([0, 1], np.uint8), slow, name="Gear", conversion=gear
            ),
            asammdf.Signal(np.array([1.0, 2.0]), slow, "bar", "Twice"),
        ],
        common_timebase=True,
    )
    mdf.append(
        [
            asammdf.Signal(
                np.array([0.0, 1.0, 99.0, 2.0]),
                fast,
                "bar",
                "Brake",
                invalidation_bits=np.array([False, False, True, False]),
            ),
            asammdf.Signal(np.zeros(4), fast, "degC", "Twice"),
            asammdf.Signal(
                np.array([b"a", b"b", b"c", b"d"]),
                fast,
                name="Text",
                encoding="utf-8",
            ),
        ],
        common_timebase=True,
    )
    mdf.save(path)
    mdf.close()
    return path


def test_decoded_signals_of_mf4(tmp_path: Path, samples_of: Reader) -> None:
    path = write_mf4(tmp_path / "a.mf4")

    read = samples_of(
        path, ROLES | {"gear": {"column": "Gear", "unit": "count"}}
    )

    begin = read[0][0]
    assert begin > 1e9
    assert [
        (round(time_s - begin, 5), role, value)
        for time_s, role, value in read
        if role != "gear"
    ] == EXPECTED
    assert [value for _, role, value in read if role == "gear"] == [0.0, 1.0]


def test_names_and_units_of_mf4(tmp_path: Path) -> None:
    source = Mf4Source(write_mf4(tmp_path / "a.mf4"))

    assert source.names() == [
        *("time", "Speed", "Gear", "Twice#0", "Brake", "Twice#1")
    ]
    assert source.units() == {
        "time": "s",
        "Speed": "km/h",
        "Twice#0": "bar",
        "Brake": "bar",
        "Twice#1": "degC",
    }


def test_an_array_is_no_role_and_is_named(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "a.mf4"
    mdf = asammdf.MDF(version="4.11")
    pairs = np.rec.fromarrays([np.ones((3, 2))], dtype=[("Pair", "<f8", (2,))])
    mdf.append([asammdf.Signal(pairs, np.arange(3.0), name="Pair")])
    mdf.save(path)
    mdf.close()

    with capture_logs() as logs:
        chunks = list(Mf4Source(path).chunks(["time", "Pair"]))

    assert chunks == []
    assert [(one["event"], one["column"]) for one in logs] == [
        ("no single numbers", "Pair")
    ]
