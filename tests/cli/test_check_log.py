"""``bstm check --log``: what it prints, what it writes, how it ends."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from bstm_daemon.bus.output.publication import Publication
from bstm_daemon.cli.main import main
from bstm_daemon.estimate import Estimate
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

DRIVE = """
[drive]
name = "stops"
description = "two stops"
ambient_c = 10.0
[[segment]]
repeat = 2
[[segment.segment]]
speed_kmh = 80.0
rate_ms2 = 2.5
gear = 3
duration_s = 14.0
[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
[[segment.segment]]
parked = true
duration_s = 4.0
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of two stops."""
    path = tmp_path_factory.mktemp("logs") / "stops.log"
    driven = simulate(parse_drive(DRIVE, "stops.toml"))
    write_candump(path, driven, Encoder(DBC))
    return path


@pytest.fixture
def turned(tmp_path: Path) -> Path:
    """Return the example car in Feed-Back with its accelerometer turned."""
    text = EXAMPLE.read_text(encoding="utf-8")
    for old, new in (
        ("../dbc/example_vehicle.dbc", DBC.as_posix()),
        (
            'signal = "AccelLongitudinal"\nunit = "m/s2"',
            'signal = "AccelLongitudinal"\nunit = "m/s2"\nsign = -1',
        ),
        ('mode = "auto"', 'mode = "fb"'),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "turned.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_good_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["check", str(EXAMPLE), "--log", str(log)])

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "FAULTS" not in out
    assert "ok  wheel_speed_fl against vehicle_speed: agrees" in out
    assert "ff: yes" in out
    assert out.rstrip().endswith('usable for heat mode "fused"')
    assert all(len(line) <= 110 for line in out.splitlines())


def test_fault_that_the_mode_needs_is_exit_1(
    log: Path, turned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["check", str(turned), "--log", str(log)])

    out = capsys.readouterr().out
    assert code == 1
    assert "acceleration_longitudinal: wrong sign" in out
    assert 'NOT usable for heat mode "fb", 1 fault named' in out


def test_fault_that_the_mode_does_not_need_is_exit_0(
    log: Path, turned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = turned.read_text(encoding="utf-8")
    turned.write_text(text.replace('mode = "fb"', 'mode = "ff"'), "utf-8")

    assert main(["check", str(turned), "--log", str(log)]) == 0
    assert "wrong sign" in capsys.readouterr().out


def test_json(log: Path, turned: Path, tmp_path: Path) -> None:
    target = tmp_path / "result.json"

    main(["check", str(turned), "--log", str(log), "--json", str(target)])

    data = json.loads(target.read_text(encoding="utf-8"))
    assert data["problems"] == []
    found = data["log"]
    assert not found["usable"]
    assert found["findings"][0]["fault"] == "sign"
    assert found["findings"][0]["roles"] == ["acceleration_longitudinal"]
    roles = {role["role"]: role for role in found["roles"]}
    assert roles["wheel_speed_fl"]["rate_hz"] == pytest.approx(50, rel=0.02)
    fits = {one["title"]: one["fit"] for one in found["comparisons"]}
    assert fits["accelerometer against dv/dt"]["scale"] == pytest.approx(
        -1.0, abs=0.05
    )


def test_two_parts_are_one_recording(log: Path, tmp_path: Path) -> None:
    lines = log.read_text(encoding="ascii").splitlines(keepends=True)
    parts = [tmp_path / "one.log", tmp_path / "two.log"]
    half = len(lines) // 2
    parts[0].write_text("".join(lines[:half]), "ascii")
    parts[1].write_text("".join(lines[half:]), "ascii")
    results = []
    for logs in ([log], [parts[1], parts[0]]):
        target = tmp_path / "result.json"
        words = [word for one in logs for word in ("--log", str(one))]
        code = main(["check", str(EXAMPLE), *words, "--json", str(target)])
        assert code == 0
        result = json.loads(target.read_text(encoding="utf-8"))["log"]
        results.append({**result, "files": []})

    assert results[0] == results[1]


def test_the_same_log_twice_is_refused(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--log", str(log), "--log", str(log)]

    assert main(["check", str(EXAMPLE), *words]) == 65
    assert "one at a time" in capsys.readouterr().err


def test_log_without_wanted_ids(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.log"
    path.write_text("(1.0) can0 7FF#00\n(1.1) can0 7FF#01\n", "ascii")

    assert main(["check", str(EXAMPLE), "--log", str(path)]) == 65
    assert "none of the wanted ids" in capsys.readouterr().err


def test_configuration_problem_goes_first(
    log: Path, turned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = turned.read_text(encoding="utf-8")
    turned.write_text(text.replace("AccelLateral", "AccelLat"), "utf-8")

    assert main(["check", str(turned), "--log", str(log)]) == 78
    assert "AccelLat" in capsys.readouterr().err


def test_report_and_map_need_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = str(tmp_path / "r.html")

    assert main(["check", str(EXAMPLE), "--report", report]) == 2
    assert main(["check", str(EXAMPLE), "--map", "can0=chassis"]) == 2
    assert "--log" in capsys.readouterr().err


def test_interface_is_mapped(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "vcan.log"
    text = log.read_text(encoding="ascii").replace(" can0 ", " vcan7 ")
    other.write_text(text, "ascii")
    words = ["check", str(EXAMPLE), "--log", str(other)]

    assert main(words) == 65
    assert main([*words, "--map", "vcan7=chassis"]) == 0


def test_own_ids_in_the_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "taken.log"
    lines = log.read_text(encoding="ascii")
    stamp = lines.split(maxsplit=1)[0]
    other.write_text(f"{lines}{stamp} can0 5B0#00\n", "ascii")

    assert main(["check", str(EXAMPLE), "--log", str(other)]) == 0
    assert (
        "the log holds 1 frame with id 0x5B0 on chassis, which [publish] "
        "id_base = 0x5B0 would send: choose another id_base"
    ) in " ".join(capsys.readouterr().out.split())


def test_frames_of_the_daemon_in_the_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recorder that hears the daemon is no reason for another id_base."""
    text = log.read_text(encoding="ascii")
    stamp = text.split(maxsplit=1)[0]
    publication = Publication(["FL", "FR", "RL", "RR"], 0x5B0)
    sent = [
        f"{stamp} can0 {frame.can_id:03X}#{frame.data.hex()}\n"
        for tick in range(30)
        for frame in publication.encode(Estimate(tick * 100_000, {}))
    ]
    both = tmp_path / "both.log"
    both.write_text(text + "".join(sent), "ascii")
    capsys.readouterr()
    words = ["check", str(EXAMPLE), "--log", str(both)]

    assert main(words) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "these are frames of this daemon" in out
    assert "choose another id_base" not in out

    # another sender on one of the ids, among ours
    foreign = f"{stamp} can0 5B4#0011223344556677\n"
    both.write_text(text + "".join(sent) + foreign, "ascii")
    assert main(words) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "with id 0x5B4 on chassis, which [publish]" in out
    assert "these are frames of this daemon" in out


@pytest.mark.slow
def test_report(log: Path, turned: Path, tmp_path: Path) -> None:
    """The page is whole, needs no network and escapes every name."""
    text = turned.read_text(encoding="utf-8")
    turned.write_text(
        text.replace('id = "example-vehicle"', "id = '<img src=x>'"), "utf-8"
    )
    report = tmp_path / "check.html"

    main(["check", str(turned), "--log", str(log), "--report", str(report)])

    page = report.read_text(encoding="utf-8")
    head = page[: page.index("<script")]
    assert "<img" not in head
    assert "&lt;img src=x&gt;" in head
    assert "wrong sign" in head
    assert head.count('class="plot"') > 10
    assert '="http' not in head


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH")
def test_report_draws_every_plot(log: Path, tmp_path: Path) -> None:
    report = tmp_path / "check.html"
    main(["check", str(EXAMPLE), "--log", str(log), "--report", str(report)])

    dom = subprocess.run(
        [
            str(CHROMIUM),
            *("--headless", "--no-sandbox", "--disable-gpu"),
            *("--virtual-time-budget=20000", "--dump-dom"),
            f"--user-data-dir={tmp_path / 'profile'}",
            report.as_uri(),
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    ).stdout

    assert 'data-drawn="yes"' in dom
    body = dom[: dom.index('<script type="application/json"')]
    plots = body.count("js-plotly-plot")
    assert plots == body.count('<div class="plot">') > 20
