"""Plots as files, drawn by Chromium."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from choreographer.browsers.chromium import Chromium

from bstm_daemon.errors import MissingExtraError, UsageError
from bstm_daemon.report.figures import require_figure_packages, write_figures
from bstm_daemon.report.plots import BLUE, curve, time_plot
from bstm_daemon.report.shell import Page, Section

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def page() -> Page:
    x = np.arange(0.0, 100.0)
    drawn = time_plot([curve(x, x, "disc", BLUE)], "[°C]", (0.0, 100.0))
    section = Section("Front / axle", plots=[("disc: RMS 3.0 K", drawn)])
    return Page("drive", [Section("words"), section])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH")
def test_each_plot_is_a_png_and_an_svg(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "figures"

    paths = write_figures(folder, page())

    assert [path.name for path in paths] == [
        "01-front-axle-disc-rms-3-0-k.png",
        "01-front-axle-disc-rms-3-0-k.svg",
    ]
    png, svg = paths
    header = png.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(header[16:20], "big") == 2000
    text = svg.read_text(encoding="utf-8")
    assert "disc: RMS 3.0 K" in text
    # seconds are shown as the page shows them
    assert ">1:00<" in text


def test_without_a_browser_the_reader_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Chromium, "find_browser", lambda **_: None)

    with pytest.raises(UsageError, match="chromium"):
        require_figure_packages()


def test_without_the_package_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "kaleido", None)

    with pytest.raises(MissingExtraError, match=r"bstm-daemon\[figures\]"):
        require_figure_packages()
