"""Style sheet and script of the check's page, beside the replay's style."""

from __future__ import annotations

from typing import Final

QUALITY_STYLE: Final = """
.good { color: #00694d; } .bad { color: #b04700; }
.verdict { font-size: 17px; font-weight: 600; margin: 0 0 16px; }
.faults { border-color: #d55e00; background: #fff4ec; }
.faults ul, .plain ul { margin: 0; padding-left: 20px;
  overflow-wrap: anywhere; }
.plain td, .plain th { padding: 4px 10px; text-align: left;
  border-top: 1px solid var(--line); vertical-align: top; }
.plain thead th { border-top: 0; color: var(--soft); font-weight: 600; }
.plain td.number { text-align: right; white-space: nowrap; }
.plain th.number { text-align: right; }
.plain tbody th { font-weight: 600; white-space: nowrap; }
.pair { border-top: 1px solid var(--line); padding: 10px 0 2px; }
.pair:first-of-type { border-top: 0; padding-top: 0; }
.pair h3 { font-size: 14px; margin: 0; }
.pair p { margin: 1px 0 2px; }
.pair .figures { color: var(--soft); font-size: 12.5px;
  font-variant-numeric: tabular-nums; }
.badge { display: inline-block; min-width: 64px; text-align: center;
  border-radius: 10px; padding: 0 8px; margin-right: 6px; font-size: 12px;
  font-weight: 600; border: 1px solid; }
.badge.none { color: var(--soft); }
.plot { min-height: 250px; }
"""

QUALITY_SCRIPT: Final = r"""
"use strict";
const check = JSON.parse(document.getElementById("check").textContent);
const epoch = Date.parse(check.epoch);
const config = { responsive: true, displayModeBar: false };
async function drawAll() {
  for (const [i, plot] of check.plots.entries()) {
    for (const trace of plot.data) {
      if (trace.xaxis === "x2") continue;
      trace.x = trace.x.map(
        (s) => new Date(epoch + s * 1000).toISOString().slice(0, -1));
    }
    await Plotly.newPlot("plot-" + i, plot.data, plot.layout, config);
  }
  document.body.dataset.drawn = "yes";
}
drawAll();
"""
