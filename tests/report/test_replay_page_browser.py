"""The page in a real browser; skipped where there is no Chromium."""

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.residual_heat import Cell
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.gap_page import heat_map
from bstm_daemon.report.plots import (
    BLUE,
    cloud,
    curve,
    plot,
    right_axis,
    time_plot,
)
from bstm_daemon.report.replay_page import ReplayFacts, replay_page
from bstm_daemon.report.shell import Page, Section, render

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None
)

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium on PATH: the page is not rendered"
)

HOSTILE = "</script><img src=x onerror=\"document.title='taken'\">"

PANELS = {"": 2, "All corners": 4, "FL": 5, "RL": 1}
"""Panels of the descent by view: speed and pressure above, then margin, disc,
fluid and power of all corners; reasons beside them of one; power alone."""

FACTS = ReplayFacts(
    title=f"drive {HOSTILE}",
    log="descent.log",
    vehicle_id=HOSTILE,
    configuration="example_vehicle.toml",
    heat_mode="ff",
    lines=10,
    frames=10,
    refused={},
    counts={},
    compiled=True,
    warnings=(HOSTILE,),
)

ZOOM = """
async function probe() {
  // as a drag over the speed does it
  await Plotly.relayout(linked[0], { "xaxis.range":
    ["2000-01-01 00:20:00", "2000-01-01 00:40:00"] });
  const settle = () => new Promise((done) => setTimeout(done, 1500));
  const seen = () => linked.filter((one) => one.checkVisibility())
    .map((one) => one._fullLayout.xaxis.range.join(" to "));
  await settle();
  const overview = seen();
  buttons[1].click();
  await settle();
  const corner = seen();
  await Plotly.relayout(linked[0], { "xaxis.range":
    ["2000-01-01 00:00:00", "2000-01-01 01:25:00"] });
  await settle();
  return [overview, corner, seen()];
}
"""

LOOK = """
async function probe() {
  document.querySelectorAll("details").forEach((one) => { one.open = true; });
  for (const button of buttons) {
    button.click();
    await new Promise((done) => setTimeout(done, 1500));
  }
  const overlaps = [];
  for (const plot of document.querySelectorAll(".js-plotly-plot")) {
    if (!plot.checkVisibility()) continue;
    const box = (part) => plot.querySelector(part)?.getBoundingClientRect();
    const whole = plot.getBoundingClientRect();
    const panel = box(".nsewdrag");
    const legend = box(".legend .bg") || box(".infolayer .colorbar");
    if (!legend) continue;
    const beside = legend.left >= panel.right - 1;
    const below = legend.top >= panel.bottom + 10;
    const above = legend.bottom <= panel.top + 1;
    const inside = legend.bottom <= whole.bottom + 1
      && legend.right <= whole.right + 1;
    overlaps.push([beside, below, above, inside]);
  }
  return { width: innerWidth, page: document.documentElement.scrollWidth,
    back: getComputedStyle(document.body).backgroundColor,
    line: document.querySelector(".js-line")
      && getComputedStyle(document.querySelector(".js-line")).stroke,
    overlaps };
}
"""

RUN = """
const waiting = setInterval(async () => {
  if (!document.body.dataset.drawn) return;
  clearInterval(waiting);
  const note = document.createElement("p");
  note.id = "probe";
  note.textContent = JSON.stringify(await probe());
  top.document.body.append(note);
}, 50);
"""


def _page(results: Results, facts: ReplayFacts) -> str:
    curves, statistics = DriveCurves(), DriveStatistics()
    curves.write(results)
    statistics.write(results)
    return render(replay_page(statistics.summary(), curves, facts))


def _render(path: Path, *flags: str) -> tuple[str, str]:
    """Return the document after its scripts ran, and what was logged."""
    assert CHROMIUM is not None
    done = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-quic",
            f"--user-data-dir={path.parent / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=20000",
            "--dump-dom",
            "--window-size=1400,2000",
            *flags,
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout, "\n".join(console)


def _probed(
    page: str, probe: str, path: Path, *flags: str, width_px: int = 1385
) -> Any:
    """Return what *probe* finds in *page*, whose policy it is not in.

    In a frame: a window of Chromium is 500 px wide at least.
    """
    page = re.sub(r'<meta http-equiv="Content-Security[^>]*>', "", page)
    script = f"<script>{probe}{RUN}</script></body>"
    path.write_text(page.replace("</body>", script), encoding="utf-8")
    frame = path.with_name("frame.html")
    size = f"width:{width_px}px;height:2000px;border:0"
    frame.write_text(f'<iframe style="{size}" src="{path.name}"></iframe>')
    document, console = _render(
        frame, "--allow-file-access-from-files", *flags
    )
    assert console == ""
    found = re.search(r'<p id="probe">([^<]*)</p>', document)
    assert found is not None
    return json.loads(unescape(found[1]))


@pytest.mark.slow
def test_page_draws_without_errors_and_keeps_hostile_names_as_text(
    tmp_path: Path, descent: Results
) -> None:
    """Under its own policy: a script refused would be a console error."""
    path = tmp_path / "report.html"
    path.write_text(_page(descent, FACTS), encoding="utf-8")

    document, console = _render(path)

    assert console == ""
    assert 'data-drawn="yes"' in document
    body = document[document.index("<main>") : document.index("</main>")]
    # the panels of the first view; the others are drawn when they are seen
    drawn = PANELS[""] + PANELS["All corners"]
    assert body.count('class="plot-container') == drawn
    assert "<img" not in body
    assert "<title>drive &lt;/script&gt;" in document


@pytest.mark.slow
def test_zoom_moves_every_time_axis_and_outlives_a_change_of_view(
    tmp_path: Path, descent: Results
) -> None:
    page = _page(descent, FACTS)

    overview, corner, reset = _probed(page, ZOOM, tmp_path / "page.html")

    assert len(overview) == PANELS[""] + PANELS["All corners"]
    assert len(corner) == len(reset) == PANELS[""] + PANELS["FL"]
    assert {*overview, *corner} == {
        "2000-01-01 00:20:00 to 2000-01-01 00:40:00"
    }
    assert set(reset) == {"2000-01-01 00:00:00 to 2000-01-01 01:25:00"}


@pytest.mark.slow
@pytest.mark.parametrize("width", [1385, 400])
def test_nothing_overprints_and_nothing_is_wider_than_the_page(
    tmp_path: Path, descent: Results, width: int
) -> None:
    """The legend is beside its panel, on a small screen below it."""
    page = _page(descent, FACTS)

    found = _probed(page, LOOK, tmp_path / "page.html", width_px=width)

    assert found["width"] == width
    assert found["page"] <= width
    assert len(found["overlaps"]) >= PANELS["RL"]
    for beside, below, above, inside in found["overlaps"]:
        assert below if width == 400 else beside or above
        assert inside


@pytest.mark.slow
def test_every_kind_of_plot_fits_a_small_screen(tmp_path: Path) -> None:
    """Many names, a second axis, shades with a scale, a map, bars."""
    x = np.linspace(0.0, 300.0, 50)
    names = [f"wheel speed of corner number {i} [km/h]" for i in range(6)]
    lines = [curve(x, i * x, name, BLUE) for i, name in enumerate(names)]
    right = curve(x, x, "speed", BLUE, second=True)
    cells = [
        Cell("pad_front", regime, name, 1e5, 1e3, 9)
        for regime in ("braking", "driving", "parked")
        for name in ("< 100 degC", "100 to 200 degC", "> 450 degC")
    ]
    drawn = {
        "names": time_plot(lines, "speed [km/h]", (0.0, 300.0)),
        "axes": time_plot(
            [*lines, right], "km/h", (0.0, 300.0), yaxis2=right_axis("kW")
        ),
        "shades": plot(
            [cloud(x, x, "", shade=x, shade_title="bar")], "x", "y"
        ),
        "map": heat_map(cells),
    }
    page = render(Page("all", [Section("", plots=[*drawn.items()])]))

    found = _probed(page, LOOK, tmp_path / "page.html", width_px=400)

    assert found["page"] <= 400
    assert len(found["overlaps"]) == len(drawn)
    for _, below, _, inside in found["overlaps"]:
        assert below
        assert inside


@pytest.mark.slow
def test_a_dark_screen_has_a_dark_page(
    tmp_path: Path, descent: Results
) -> None:
    page = _page(descent, FACTS)
    path = tmp_path / "page.html"
    dark = "--blink-settings=preferredColorScheme=0"

    found = _probed(page, LOOK, path, dark)

    assert found["back"] == "rgb(13, 17, 23)"
    assert found["line"] == "rgb(230, 237, 243)"


@pytest.mark.slow
def test_a_drive_known_from_thermocouples_only_is_drawn(
    tmp_path: Path, descent: Results
) -> None:
    """Neither speed nor pressure: what is there is drawn."""
    columns = {
        key: column
        for key, column in descent.columns.items()
        if key == "time_s" or key.startswith(("FL.fluid", "FR.fluid"))
    }
    path = tmp_path / "report.html"
    page = _page(Results(columns, ("FL", "FR"), ("FL", "FR")), FACTS)
    path.write_text(page, encoding="utf-8")

    document, console = _render(path)

    assert console == ""
    # the fluid of both corners, and their legend
    assert document.count('class="js-line"') == 2 + 2
