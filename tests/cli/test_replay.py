"""``bstm replay``: what it writes, what it says, how it ends."""

from __future__ import annotations

import csv
import gzip
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
CAR = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"

DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 10.0
thermocouple_logger = true
[[segment]]
speed_kmh = 60.0
rate_ms2 = 4.0
gear = 3
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
[[segment]]
parked = true
duration_s = 4.0
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the log of the drive, 12 s and 170 kB."""
    path = tmp_path_factory.mktemp("cli") / "stop.log"
    write_candump(path, simulate(parse_drive(DRIVE, "stop")), Encoder(DBC))
    return path.read_bytes()


@pytest.fixture
def log(recorded: bytes, tmp_path: Path) -> Path:
    """Return a copy of it to do harm to."""
    path = tmp_path / "stop.log"
    path.write_bytes(recorded)
    return path


@pytest.fixture
def car_with(tmp_path: Path) -> Callable[..., Path]:
    """Return a maker of files like the example car with changes."""

    def make(*changes: tuple[str, str]) -> Path:
        text = CAR.read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "car.toml"
        path.write_text(text.replace("../dbc/", f"{DBC.parent.as_posix()}/"))
        return path

    return make


def replay(*arguments: object, car: Path = CAR) -> int:
    """Run ``bstm replay`` here."""
    return main(["replay", *map(str, arguments), "-c", str(car)])


def held(folder: Path) -> set[str]:
    """Return the names of all files in *folder*, hidden ones too."""
    return {p.name for p in folder.rglob("*") if p.is_file()}


def test_writes_both_tables(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Named after the log, in a folder that it makes; a summary on screen."""
    out = tmp_path / "new" / "results"

    assert replay(log, "-o", out) == 0

    assert held(out) == {"stop.estimates.csv", "stop.estimates.parquet"}
    printed, err = capsys.readouterr()
    assert err == ""
    assert printed.startswith(f"{log}  (example-vehicle, {CAR})\n")
    assert f"{out / 'stop.estimates.csv'}: " in printed
    for corner in ("FL", "FR", "RL", "RR"):
        assert f"\n{corner} " in printed


@pytest.mark.parametrize(
    ("form", "written"),
    [
        ("csv", {"stop.estimates.csv"}),
        ("parquet", {"stop.estimates.parquet"}),
        ("both", {"stop.estimates.csv", "stop.estimates.parquet"}),
    ],
)
def test_format(
    log: Path, tmp_path: Path, form: str, written: set[str]
) -> None:
    """As asked for."""
    assert replay(log, "-o", tmp_path / "out", "--format", form) == 0

    assert held(tmp_path / "out") == written


def test_without_out_nothing_is_written(log: Path, tmp_path: Path) -> None:
    """Only the summary."""
    assert replay(log) == 0

    assert held(tmp_path) == {"stop.log"}


def test_several_logs(log: Path, tmp_path: Path) -> None:
    """Each gets its table; gzip's ending is no part of the name."""
    packed = tmp_path / "other.log.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))

    assert replay(log, packed, "-o", tmp_path / "out") == 0

    tables = [
        (tmp_path / "out" / f"{stem}.estimates.csv").read_bytes()
        for stem in ("stop", "other")
    ]
    assert tables[0] == tables[1]


def test_report_and_publication(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both written, both named on screen; the report needs no network."""
    page, sent = tmp_path / "r.html", tmp_path / "sent.log"

    assert replay(log, "--report", page, "--publish", sent) == 0

    lines = capsys.readouterr().out.splitlines()
    assert str(page) in lines
    count = len(sent.read_text(encoding="ascii").splitlines())
    assert f"{sent}: {count} frames" in lines
    head = page.read_text(encoding="utf-8")
    assert "stop.log" in head
    assert 'src="http' not in head


def test_a_cold_start_is_known_from_the_first_row_on(
    log: Path,
    tmp_path: Path,
    car_with: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As cold as the log's air, not the configured one."""
    car = car_with(("ambient_c = 10.0", "ambient_c = 35.0"))
    out = tmp_path / "results"

    assert (
        replay(log, "-o", out, "--start", "cold", "--no-forecast", car=car)
        == 0
    )

    assert "start cold: as cold as the air" in capsys.readouterr().out
    with (out / "stop.estimates.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["FL.validity"] for row in rows} == {"0"}
    assert float(rows[0]["FL.fluid_c"]) == pytest.approx(10.0, abs=0.6)


def test_a_start_that_stays_unknown_is_said(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the screen and in the head of the report."""
    report = tmp_path / "report.html"

    assert replay(log, "--report", report, "--no-forecast") == 0

    said = "start not known by the end of the log; degraded and the risk an"
    assert said in capsys.readouterr().out
    assert said in report.read_text(encoding="utf-8")


def test_every(log: Path, tmp_path: Path) -> None:
    """A row a second, on whole seconds."""
    out = tmp_path / "out"
    assert replay(log, "-o", out, "--format", "csv", "--every", "1") == 0

    _, *rows = (out / "stop.estimates.csv").read_text().splitlines()
    stamps = [row.split(",")[0] for row in rows]
    assert {stamp.split(".")[1] for stamp in stamps} == {"000000"}
    assert 8 <= len(stamps) <= 15


def test_every_changes_the_table_alone(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The summary is of every publication."""
    said = []
    for every in ("0.1", "1", "5"):
        assert replay(log, "-o", tmp_path, "--every", every) == 0
        lines = capsys.readouterr().out.splitlines()
        said.append([one for one in lines if not one.endswith(" rows")])

    assert said[0] == said[1] == said[2]
    assert len(said[0]) >= 8


def test_few_columns_are_those_of_a_collection(
    log: Path, tmp_path: Path
) -> None:
    arguments = ("-o", tmp_path, "--format", "csv", "--columns", "few")
    assert replay(log, *arguments) == 0

    text = (tmp_path / "stop.estimates.csv").read_text()
    names = text.splitlines()[0].split(",")
    assert names[:2] == ["time_s", "speed_ms"]
    own = {name.removeprefix("FL.") for name in names if name[:3] == "FL."}
    assert {"disc_c", "fluid_c", "margin_k", "risk", "validity"} <= own
    assert not {"pressure_pa", "brake_power_w", "reasons", "flags"} & own


def test_mf4_is_one_of_the_formats(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(log, "-o", tmp_path, "--format", "mf4") == 0

    path = tmp_path / "stop.estimates.mf4"
    assert path.read_bytes()[:3] == b"MDF"
    assert f"{path}: " in capsys.readouterr().out
    assert not list(tmp_path.glob("*.csv"))


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("chromium") is None, reason="no chromium on PATH"
)
def test_figures_are_those_of_the_report(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also without the report itself."""
    folder = tmp_path / "figures"
    assert replay(log, "--figures", folder, "--no-forecast") == 0

    names = sorted(path.name for path in folder.iterdir())
    assert names[:2] == [
        *("01-the-drive-speed-km-h.png", "01-the-drive-speed-km-h.svg")
    ]
    assert f"{folder}: {len(names)} figures" in capsys.readouterr().out


@pytest.mark.skipif(
    shutil.which("chromium") is None, reason="no chromium on PATH"
)
def test_a_folder_of_figures_is_refused_before_the_work(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(log, "--figures", log / "figures") == 74

    said = capsys.readouterr()
    assert "cannot be created" in said.err
    assert said.out == ""


# what is wrong with the call


@pytest.mark.parametrize(
    "value", ["0", "-1", "0.25", "nan", "inf", "often", "1e400"]
)
def test_every_must_be_a_multiple(
    log: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Usage error that says of what."""
    assert replay(log, f"--every={value}") == 2

    assert f"{value!r} is not a positive multiple of 0.1 s" in (
        capsys.readouterr().err
    )


def test_usage(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Targets that would overwrite each other, unknown buses and formats."""
    other = tmp_path / "sub"
    other.mkdir()
    twin = other / "stop.log"
    twin.write_bytes(log.read_bytes())
    table = tmp_path / f"{log.stem}.estimates.csv"
    for arguments, words in (
        ((log, twin, "-o", tmp_path / "out"), "the same files"),
        (
            (log, "--start", "cold", "--state", tmp_path / "a.state"),
            "not allowed with argument --start",
        ),
        ((log, twin, "--publish", tmp_path / "p.log"), "one LOG at a time"),
        ((log, twin, "--state-out", tmp_path / "s"), "one LOG at a time"),
        ((log, "--state-out", log), "would overwrite"),
        ((log, "--format", "xls"), "no 'xls'"),
        ((log, "--map", "can0"), "is not IFACE=BUS"),
        ((log, "--map", "can0=drive"), "there are: chassis"),
        ((log, "--publish", log), "would overwrite"),
        ((log, "--report", log), "would overwrite"),
        ((log, "-o", tmp_path, "--report", table), "would overwrite"),
        ((), "LOG"),
    ):
        before = log.read_bytes()
        assert replay(*arguments) == 2, arguments
        assert words in capsys.readouterr().err
        assert log.read_bytes() == before
    assert held(tmp_path) == {"stop.log"}


def test_configuration_and_state_are_not_overwritten(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    car, state = tmp_path / "car.toml", tmp_path / "car.state"
    for path in (car, state):
        path.write_text("kept", "utf-8")

        code = replay(log, "--state", state, "--report", path, car=car)

        assert code == 2
        assert "would overwrite" in capsys.readouterr().err
        assert path.read_text("utf-8") == "kept"


def test_a_chain_of_states_equals_one_replay_of_all(
    log: Path, tmp_path: Path
) -> None:
    """Cut in mid-drive and in mid-step: the same rows, the same state."""
    lines = log.read_bytes().splitlines(keepends=True)
    cut = len(lines) // 2 + 7
    parts = [tmp_path / "one.log", tmp_path / "two.log"]
    parts[0].write_bytes(b"".join(lines[:cut]))
    parts[1].write_bytes(b"".join(lines[cut:]))
    states = [tmp_path / f"{n}.state" for n in (0, 1, 2)]
    options = ("--no-forecast", "--format", "csv", "-o", tmp_path)

    assert replay(log, *options, "--state-out", states[0]) == 0
    assert replay(parts[0], *options, "--state-out", states[1]) == 0
    chained = ("--state", states[1], "--state-out", states[2])
    assert replay(parts[1], *options, *chained) == 0

    assert states[2].read_bytes() == states[0].read_bytes()
    assert states[1].read_bytes() != states[0].read_bytes()
    whole, first, second = (
        path.with_suffix(".estimates.csv").read_text("utf-8").splitlines()
        for path in (log, *parts)
    )
    # distance counts from the start of each log
    place = whole[0].split(",").index("distance_m")
    rows = [line.split(",") for line in (*first[1:], *second[1:])]
    found = [",".join(row[:place] + row[place + 1 :]) for row in rows]
    expected = [line.split(",") for line in whole[1:]]
    kept = [",".join(row[:place] + row[place + 1 :]) for row in expected]
    # the first publication of a log has no interval before it
    assert len(found) == len(kept) - 1
    assert set(found) < set(kept)


def test_a_report_that_can_not_be_written_is_told_before_the_replay(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay(log, "--report", tmp_path / "no" / "drive.html") == 74

    told = capsys.readouterr()
    assert told.out == ""
    assert "No such file or directory" in told.err


# what is wrong with the log


def test_log_that_can_not_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Missing, or a folder: 74, one line, nothing written."""
    for path in (tmp_path / "none.log", tmp_path):
        assert replay(path, "--publish", tmp_path / "p.log") == 74
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(f"bstm: {path}: cannot be read: ")
        assert err.count("\n") == 1
    assert held(tmp_path) == set()


@pytest.mark.skipif(
    hasattr(os, "geteuid") and os.geteuid() == 0,
    reason="the superuser may read everything",
)
def test_log_without_permission(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """74 as well."""
    log.chmod(0)

    assert replay(log) == 74
    assert "Permission denied" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (b"", ["the log is empty"]),
        (b"dear diary\n# x\n", ["no data frame in 2 lines", "1 malformed"]),
        (
            b"(1.0) can0 7AA#00\n(1.1) can0 00000123#0011\n",
            [
                "none of the wanted ids",
                "chassis 1A4 (BrakePressure)",
                "can0 00000123, can0 7AA seen",
            ],
        ),
        (b"(1.0) can0 1A4#00\n", ["no sample in 1 wanted frames"]),
        (b"(1.0) can7 1A4#00\n", ["can7", "--map can7=BUS", "chassis"]),
        (b"\x00\x01\x02 binary", ["not a text log"]),
        (
            b"(1.01) can0 1A4#0000000000000000\n",
            ["too short for a row every 0.1 s"],
        ),
    ],
    ids=[
        *("empty", "junk", "other ids", "wrong length", "interface"),
        *("binary", "too short"),
    ],
)
def test_log_without_use(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    content: bytes,
    parts: list[str],
) -> None:
    """65, one line that says what was found and what was expected."""
    log = tmp_path / "odd.log"
    log.write_bytes(content)
    out = tmp_path / "out"

    code = replay(log, "-o", out, "--publish", tmp_path / "p.log")

    printed, err = capsys.readouterr()
    assert (code, printed) == (65, "")
    assert err.startswith(f"bstm: {log}: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err
    assert held(tmp_path) == {"odd.log"}


def test_every_longer_than_the_log(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No row is no result."""
    assert replay(log, "--every", "100000") == 65

    assert "too short for a row every 100000 s" in capsys.readouterr().err


def test_damage_is_said_and_the_rest_used(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Junk, half a line, half a gzip file: 0, with a remark each."""
    text = log.read_bytes()
    cases = {
        "junk.log": (b"junk\n" * 3 + text, "refused: 3 malformed"),
        "half.log": (text[:-4], "refused: 1 "),
        "cut.log.gz": (
            gzip.compress(text)[:-2000],
            "the log is cut short: its end is missing",
        ),
        "late.log": (
            b"".join(text.splitlines(keepends=True)[i] for i in _shuffled()),
            "samples out of order",
        ),
    }
    for name, (content, remark) in cases.items():
        path = tmp_path / name
        path.write_bytes(content)
        assert replay(path) == 0, name
        assert remark in capsys.readouterr().out, name


def _shuffled() -> list[int]:
    """Line numbers: 500 in order, then one of 0.2 s before, then on."""
    return [*range(500), 430, *range(500, 1000)]


def test_doubtful_inputs_are_said(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A dead wheel: on screen and in the page; a sound log has none."""
    assert replay(log) == 0
    assert "suspect" not in capsys.readouterr().out
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(
        b"".join(
            line[:-17] + b"0000" + line[-13:] if b" 1A0#" in line else line
            for line in lines
        )
    )

    page = tmp_path / "r.html"
    assert replay(log, "--report", page) == 0

    (said,) = [
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("wheel speed suspect (FL) for ")
    ]
    assert said.split(": ")[0] in page.read_text(encoding="utf-8")


def test_clock_jump_is_said(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An hour back in the middle."""
    lines = log.read_text(encoding="ascii").splitlines(keepends=True)
    middle = len(lines) // 2
    back = [line.replace("(17000000", "(16999900") for line in lines[middle:]]
    log.write_text("".join(lines[:middle] + back), encoding="ascii")

    assert replay(log) == 0

    assert "jumps of the clock: 1" in capsys.readouterr().out


# what is wrong with the configuration


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (
            ("example_vehicle.dbc", "none.dbc"),
            ["[[bus]]", "none.dbc", "cannot be read"],
        ),
        (
            ('signal = "PressurePrimary"', 'signal = "PressurePrimry"'),
            [
                "[signals.primary_pressure]",
                "did you mean 'PressurePrimary'",
            ],
        ),
        (
            ('signal = "PressurePrimary"\nunit = "bar"', 'unit = "barn"'),
            ["[signals.primary_pressure]", "barn", "did you mean 'bar'"],
        ),
        (
            ("[fluid]", '[[effect]]\nname = "wet_disk"\n[fluid]'),
            ["[[effect]]", "did you mean 'wet_disc'"],
        ),
        (
            ('model = "lumped"', 'model = "own:disc"'),
            ["FL disc.model", "own:disc", "lumped"],
        ),
    ],
    ids=["DBC", "role", "unit", "effect", "part"],
)
def test_configuration_problem(
    log: Path,
    tmp_path: Path,
    car_with: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    change: tuple[str, str],
    parts: list[str],
) -> None:
    """78; names section, value and the nearest name; nothing written."""
    car = car_with(change)

    code = replay(log, "--publish", tmp_path / "p.log", car=car)

    printed, err = capsys.readouterr()
    assert (code, printed) == (78, "")
    for part in parts:
        assert part in err
    assert "Traceback" not in err
    assert held(tmp_path) == {"stop.log", "car.toml"}


def test_configuration_that_is_missing(log: Path, tmp_path: Path) -> None:
    """74: it is a file that can not be read."""
    assert replay(log, car=tmp_path / "none.toml") == 74


# what is wrong with the place to write to


@pytest.mark.parametrize("option", ["--out", "--publish", "--report"])
def test_target_that_can_not_be_written(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
) -> None:
    """74 and the path; a file stands where a folder should be."""
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "below"

    assert replay(log, option, target) == 74

    err = capsys.readouterr().err
    assert err.startswith(f"bstm: {target}: cannot be ")
    assert err.count("\n") == 1
    assert held(tmp_path) == {"stop.log", "file"}


# another process


INTERRUPTIBLE = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from bstm_daemon.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("asked", "code"), [((), 0), (("--format", "parquet"), 2)]
)
def test_without_pyarrow(
    log: Path,
    tmp_path: Path,
    asked: tuple[str, ...],
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """CSV with one line that names the extra; an error if asked for."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    out = tmp_path / "out"

    found = main(["replay", str(log), "-c", str(CAR), "-o", str(out), *asked])

    assert found == code
    said = "".join(capsys.readouterr()).splitlines()
    assert len([line for line in said if "bstm-daemon[parquet]" in line]) == 1
    assert held(out) == ({"stop.estimates.csv"} if code == 0 else set())


def _fill(pipe: int, data: bytes) -> None:
    """Write all of *data*; returns only when it has been read."""
    view = memoryview(data)
    while view:
        view = view[os.write(pipe, view) :]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe")
def test_interrupted_while_it_writes(recorded: bytes, tmp_path: Path) -> None:
    """Ctrl-C in the middle of a file: 130, the old file stands, no other.

    The log is a named pipe, read twice. The second time it is fed up to the
    middle and stays open: the program then waits for more with its file
    begun, and what a pipe holds (64 KiB) cannot hold all that was written.
    """
    pipe, out = tmp_path / "pipe.log", tmp_path / "sent.log"
    os.mkfifo(pipe)
    out.write_text("old")
    # the first lines are read once more to tell the format, and are gone then
    data = b"# a comment to be lost with the first look\n" * 500 + recorded
    assert len(data) > 2 * 65_536
    with subprocess.Popen(
        [
            *(sys.executable, "-u", "-c", INTERRUPTIBLE, "replay", str(pipe)),
            *("-c", str(CAR), "--publish", str(out)),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        watchdog = threading.Timer(60, process.kill)
        watchdog.start()
        try:
            # open both ways: it stays while the program opens it anew
            end = os.open(pipe, os.O_RDWR)
            _fill(end, data)
            os.close(end)
            assert process.stdout is not None
            assert process.stdout.readline().startswith(str(pipe))
            end = os.open(pipe, os.O_RDWR)
            _fill(end, data)
            assert len(list(tmp_path.iterdir())) == 3
            process.send_signal(signal.SIGINT)
            _, err = process.communicate()
            os.close(end)
        finally:
            watchdog.cancel()
            process.kill()

    assert (process.returncode, err) == (130, "interrupted\n")
    assert out.read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"pipe.log", "sent.log"}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe")
def test_interrupted_while_tables_grow(
    recorded: bytes, tmp_path: Path
) -> None:
    """Ctrl-C in the middle of a log: 130, the old tables stand, no others.

    The log is a named pipe that stays open, so the program waits for more.
    """
    pipe, out = tmp_path / "pipe.log", tmp_path / "out"
    os.mkfifo(pipe)
    out.mkdir()
    names = {"pipe.estimates.csv", "pipe.estimates.parquet"}
    for name in names:
        (out / name).write_text("old")
    data = b"# a comment to be lost with the first look\n" * 500 + recorded
    with subprocess.Popen(
        [
            *(sys.executable, "-u", "-c", INTERRUPTIBLE, "replay", str(pipe)),
            *("-c", str(CAR), "-o", str(out)),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        watchdog = threading.Timer(60, process.kill)
        watchdog.start()
        try:
            end = os.open(pipe, os.O_RDWR)
            _fill(end, data)
            # what has been read is more than a pipe holds: tables are open
            assert len(held(out)) == 4
            process.send_signal(signal.SIGINT)
            printed, err = process.communicate()
            os.close(end)
        finally:
            watchdog.cancel()
            process.kill()

    assert (process.returncode, printed, err) == (130, "", "interrupted\n")
    assert held(out) == names
    assert {(out / name).read_text() for name in names} == {"old"}
