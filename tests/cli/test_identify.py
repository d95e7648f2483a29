"""``bstm identify`` and ``bstm heat``: what they print, write, end with."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.config.reading import load_config
from bstm_daemon.simulation import load_drive, parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

CITY = """
[drive]
name = "short"
description = "one stop in gear"
[[segment]]
speed_kmh = 60.0
rate_ms2 = 2.0
gear = 3
duration_s = 15.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return logs by drive."""
    folder = tmp_path_factory.mktemp("logs")
    encoder = Encoder(DBC)
    found = {}
    drives = ("coastdown", "idiada-step", "idiada-ramp", "cooldown", "short")
    for name in drives:
        drive = (
            parse_drive(CITY, "short.toml")
            if name == "short"
            else load_drive(name)
        )
        found[name] = folder / f"{name}.log"
        write_candump(found[name], simulate(drive, sensors="n1"), encoder)
    return found


def rendered(page: Path) -> tuple[str, str]:
    """Return the document after its scripts ran, and what was logged."""
    if CHROMIUM is None:
        pytest.skip("no chromium on PATH: the page is not rendered")
    done = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            f"--user-data-dir={page.parent / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=10000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout, "\n".join(console)


@pytest.mark.slow
def test_coast_down(
    logs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    new, result = tmp_path / "new.toml", tmp_path / "result.json"

    code = main(
        [
            *("identify", "coastdown", str(logs["coastdown"])),
            *("-c", str(EXAMPLE), "-o", str(new), "--json", str(result)),
        ]
    )

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "drag_area_m2" in out
    assert "assumed to be one road driven both ways" in out
    assert all(len(line) <= 110 for line in out.splitlines())
    data = json.loads(result.read_text("utf-8"))
    drag = data["values"]["drag_area_m2"]
    assert drag["value"] == pytest.approx(0.70, abs=0.04)
    assert drag["identified"]
    assert len(data["runs"]) == 4
    written = load_config(new).vehicle
    assert written.drag_area_m2 == pytest.approx(drag["value"], rel=1e-4)
    assert written.mass_kg == 2194.0


@pytest.mark.slow
def test_brakes(
    logs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    new, result = tmp_path / "new.toml", tmp_path / "result.json"

    code = main(
        [
            *("identify", "brakes"),
            *(str(logs[name]) for name in ("idiada-step", "idiada-ramp")),
            *("-c", str(EXAMPLE), "-o", str(new), "--json", str(result)),
        ]
    )

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "front share not identified: the rear pressure" in out
    assert all(len(line) <= 110 for line in out.splitlines())
    data = json.loads(result.read_text("utf-8"))
    assert data["friction_scale"]["value"] == pytest.approx(1.0, abs=0.01)
    assert data["front_share"]["identified"] is False
    assert len(data["stops"]) == 7
    for corner in load_config(new).corner:
        assert corner.friction_coefficient == pytest.approx(0.38, abs=0.004)


@pytest.mark.slow
def test_cooling(
    logs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    new, result = tmp_path / "new.toml", tmp_path / "result.json"

    code = main(
        [
            *("identify", "cooling", str(logs["cooldown"])),
            *("-c", str(EXAMPLE), "-o", str(new), "--json", str(result)),
        ]
    )

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "100 km/h  4." in out
    assert "'conductance' by" in out
    assert all(len(line) <= 110 for line in out.splitlines())
    front = json.loads(result.read_text("utf-8"))["axles"]["front"]
    (point,) = front["points"]
    assert point["identified"]
    assert point["ten_pairs_s_per_s"] == pytest.approx(
        point["s_per_s"], rel=0.15
    )
    assert len(point["cool_downs"]) == 4
    written = load_config(new).cooling
    assert written.s_per_s == pytest.approx(front["s_per_s"], rel=1e-4)
    assert written.speed_ms == pytest.approx(front["speed_ms"], rel=1e-4)
    assert written.standstill_convection_fraction == 0.289
    before, after = load_config(EXAMPLE), load_config(new)
    for old, kept in zip(before.corner[2:], after.corner[2:], strict=True):
        assert after.cooling_of(kept) == before.cooling_of(old)


@pytest.mark.slow
def test_heat(
    logs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    result = tmp_path / "heat.json"

    code = main(
        [
            *("heat", str(logs["idiada-step"]), "-c", str(EXAMPLE)),
            *("--json", str(result)),
        ]
    )

    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "Feed-Forward" in out
    assert "energies of the stops in kJ, Eq 4.5" in out
    (data,) = json.loads(result.read_text("utf-8"))["logs"]
    sources, stops = data["sources"], data["stops"]
    assert sources["ff"]["energy_j"] == pytest.approx(3.08e6, rel=0.01)
    assert sources["can"]["energy_j"] < 0.65 * sources["fb"]["energy_j"]
    assert len(stops) == 4
    assert stops[0]["energy_j"]["fb"] == pytest.approx(
        stops[0]["balance_j"], rel=0.01
    )
    series = data["series"]
    count = len(series["time_s"])
    assert len(series["power_w"]["ff"]) == count
    assert len(series["momentary_ratio"]) == count


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "names", "plots", "expected"),
    [
        (["identify", "coastdown"], ["coastdown"], 8, 0),
        (["identify", "brakes"], ["idiada-step", "idiada-ramp"], 5, 0),
        pytest.param(
            *(["identify", "cooling"], ["cooldown"], 1 + 2, 0),
            marks=pytest.mark.full,
        ),
        # Nine windows of one cool-down do not tell heat from cooling: the
        # page shows that too, and the exit code says so.
        (["identify", "cooling", "--while-braking"], ["cooldown"], 1 + 4, 1),
        pytest.param(
            *(["heat"], ["idiada-step"], 2 + 2 + 1 + 12 + 3, 0),
            marks=pytest.mark.full,
        ),
        (["heat"], ["idiada-step", "idiada-ramp"], 1 + 20 + 17, 0),
    ],
)
def test_page_draws_every_figure(
    logs: dict[str, Path],
    tmp_path: Path,
    what: list[str],
    names: list[str],
    plots: int,
    expected: int,
) -> None:
    """Under its own policy: a script refused would be a console error."""
    page = tmp_path / "page.html"
    arguments = [str(logs[name]) for name in names]

    code = main([*what, *arguments, "-c", str(EXAMPLE), "--report", str(page)])

    assert code == expected
    assert "http" not in page.read_text("utf-8")[:2000].replace(
        "http-equiv", ""
    )
    document, console = rendered(page)
    assert console == ""
    assert 'data-drawn="yes"' in document
    body = document[document.index("<main>") : document.index("</main>")]
    assert body.count('id="plot-') == plots
    assert body.count('class="main-svg"') >= plots


def test_nothing_to_identify(
    logs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(logs["short"]), "-c", str(EXAMPLE)]

    assert main(["identify", "coastdown", *arguments]) == 65
    assert "no coast-down found" in capsys.readouterr().err
    assert main(["identify", "brakes", *arguments]) == 65
    assert "samples of 12 needed" in capsys.readouterr().err
    assert main(["identify", "cooling", *arguments]) == 65
    assert "no cool-down found" in capsys.readouterr().err
    words = ["identify", "cooling", "--while-braking", *arguments]
    assert main(words) == 65
    assert "4 stretches of 90 s" in capsys.readouterr().err


def test_wrong_use(
    logs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An existing target, options of the other one, a missing log."""
    log, taken = str(logs["coastdown"]), tmp_path / "taken.toml"
    taken.write_text("", "utf-8")
    common = ["-c", str(EXAMPLE)]

    assert main(["identify", "coastdown", log, *common, "-o", str(taken)]) == 2
    assert "give --force" in capsys.readouterr().err
    for what in ("brakes", "cooling"):
        assert main(["identify", what, log, *common, "--one-way"]) == 2
    for what in ("brakes", "coastdown"):
        words = [*common, "--while-braking"]
        assert main(["identify", what, log, *words]) == 2
        assert "an option of cooling" in capsys.readouterr().err
    assert main(["identify", "cooling-fan", log, *common]) == 2
    capsys.readouterr()
    before = logs["coastdown"].read_bytes()
    for target in ("--json", "--report", "--out"):
        for source in (log, str(EXAMPLE)):
            words = [*common, target, source, "--force"]
            assert main(["identify", "brakes", log, *words]) == 2
            assert "would overwrite" in capsys.readouterr().err
    assert main(["heat", log, *common, "--json", log]) == 2
    same = str(tmp_path / "same")
    words = [*common, "--json", same, "--report", same]
    assert main(["heat", log, *words]) == 2
    assert logs["coastdown"].read_bytes() == before
    missing = str(tmp_path / "missing.log")
    assert main(["identify", "brakes", missing, *common]) == 74
    assert main(["heat", missing, *common]) == 74
