"""The page in a real browser; skipped where there is no Chromium."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.replay_page import ReplayFacts, replay_page
from bstm_daemon.report.shell import render

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None
)

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium on PATH: the page is not rendered"
)

HOSTILE = "</script><img src=x onerror=\"document.title='taken'\">"

CORNER_CURVES = 3 + 2 * (4 + 1) + 1
REASONS = 3
"""Powers; four nodes and the fluid again, measured too; boiling point."""

PRESSURES = 3

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

PROBE = """
async function probe() {
  // as a drag over the left column does it
  await Plotly.relayout(plot, { "xaxis2.range":
    ["2000-01-01 00:20:00", "2000-01-01 00:40:00"] });
  const seen = () => Object.keys(plot._fullLayout)
    .filter((key) => /^xaxis\\d*$/.test(key))
    .map((key) => plot._fullLayout[key].range.join(" to "));
  const axle = seen();
  buttons[3].click();
  await new Promise((done) => setTimeout(done, 500));
  const zoomed = seen();
  const lines = plot.querySelectorAll(".scatterlayer .js-line").length;
  plot.querySelector('.modebar-btn[data-val="reset"]').click();
  await new Promise((done) => setTimeout(done, 500));
  const note = document.createElement("p");
  note.id = "probe";
  note.textContent = [...axle, ...zoomed, ...seen(), lines].join("|");
  document.body.append(note);
}
const drawn = setInterval(() => {
  if (document.body.dataset.drawn) { clearInterval(drawn); probe(); }
}, 50);
"""


def _page(results: Results, facts: ReplayFacts) -> str:
    curves, statistics = DriveCurves(), DriveStatistics()
    curves.write(results)
    statistics.write(results)
    return render(replay_page(statistics.summary(), curves, facts))


def _render(path: Path) -> tuple[str, str]:
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
            "--window-size=1400,2000",
            "--virtual-time-budget=10000",
            "--dump-dom",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout, "\n".join(console)


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
    # drawn on two sides and above them, and in the legends
    in_legends = CORNER_CURVES + REASONS + PRESSURES
    assert body.count('class="js-line"') == (
        2 * (CORNER_CURVES + REASONS) + 1 + PRESSURES + in_legends
    )
    assert "<img" not in body
    assert "<title>drive &lt;/script&gt;" in document


@pytest.mark.slow
def test_zoom_moves_every_time_axis_and_outlives_a_change_of_view(
    tmp_path: Path, descent: Results
) -> None:
    page = _page(descent, FACTS)
    # a test's own script is not in the page's policy
    page = re.sub(r'<meta http-equiv="Content-Security[^>]*>', "", page)
    page = page.replace("</body>", f"<script>{PROBE}</script></body>")
    path = tmp_path / "probed.html"
    path.write_text(page, encoding="utf-8")

    document, console = _render(path)

    assert console == ""
    found = re.search(r'<p id="probe">([^<]*)</p>', document)
    assert found is not None
    *ranges, lines = found[1].split("|")
    # three axes of the front axle, then the two of FR alone, then reset
    zoomed, reset = ranges[:5], ranges[5:]
    assert len(reset) == 2
    assert set(zoomed) == {"2000-01-01 00:20:00 to 2000-01-01 00:40:00"}
    assert set(reset) == {"2000-01-01 00:00:00.000 to 2000-01-01 01:25:00.000"}
    assert int(lines) == CORNER_CURVES + REASONS + 1 + PRESSURES


@pytest.mark.slow
def test_a_drive_known_from_thermocouples_only_is_drawn(
    tmp_path: Path, descent: Results
) -> None:
    """Neither speed nor pressure: the first time axis is a corner's."""
    columns = {
        key: column
        for key, column in descent.columns.items()
        if key == "time_s" or key.startswith(("FL.fluid", "FR.fluid"))
    }
    page = _page(Results(columns, ("FL", "FR"), ("FL", "FR")), FACTS)
    click = "<script>buttons[2].click();</script></body>"
    page = re.sub(r'<meta http-equiv="Content-Security[^>]*>', "", page)
    path = tmp_path / "report.html"
    path.write_text(page.replace("</body>", click), encoding="utf-8")

    document, console = _render(path)

    assert console == ""
    # FR: estimate and measured in two panels, and their legends
    assert document.count('class="js-line"') == 2 * 4
