"""The fixed parts of the page: style sheet and script, as text.

The script only shows what :mod:`bstm_daemon.report.figure` decided. It reads
the JSON of the page, so no data ever becomes code.
"""

from __future__ import annotations

from typing import Final

STYLE: Final = """
:root { color-scheme: light; --line: #d8dee4; --soft: #59636e;
  --ink: #1f2328; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0; background: #f6f8fa; color: var(--ink);
  font: 14px/1.45 system-ui, "Segoe UI", Roboto, Arial, sans-serif; }
main { max-width: 1500px; margin: 0 auto; padding: 20px 24px 32px; }
h1 { font-size: 22px; margin: 0 0 2px; overflow-wrap: anywhere; }
h2 { font-size: 15px; margin: 0 0 10px; }
.under { color: var(--soft); margin: 0 0 16px; overflow-wrap: anywhere; }
section { background: #fff; border: 1px solid var(--line);
  border-radius: 8px; padding: 14px 16px; margin: 0 0 14px; }
.tiles { display: grid; gap: 12px; margin: 0 0 14px;
  grid-template-columns: repeat(auto-fit, minmax(210px, 1fr)); }
.tile { background: #fff; border: 1px solid var(--line);
  border-radius: 8px; padding: 10px 16px 12px; }
.tile b { display: block; font-size: 26px; line-height: 1.25;
  font-weight: 600; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); }
.warnings { border-color: #d4a72c; background: #fff8e5; }
.warnings ul { margin: 0; padding-left: 20px; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%;
  font-variant-numeric: tabular-nums; }
.corners th, .corners td { padding: 5px 10px; text-align: right;
  border-top: 1px solid var(--line); white-space: nowrap; }
.corners thead th { border-top: 0; color: var(--soft); font-weight: 600; }
.corners thead tr + tr th { padding-top: 0; }
.corners thead tr:first-child th { padding-bottom: 0; font-weight: 400; }
.corners thead th[colspan] { text-align: center; }
.corners th:first-child { text-align: left; }
.corners td small { color: var(--soft); font-size: 12px; }
.corners tbody th { font-size: 15px; }
.facts { columns: 2; column-gap: 32px; margin: 0; }
.facts div { display: flex; gap: 12px; padding: 3px 0;
  break-inside: avoid; }
.facts dt { color: var(--soft); flex: 0 0 150px; }
.facts dd { margin: 0; overflow-wrap: anywhere; }
.note { color: var(--soft); font-size: 12.5px; margin: 8px 0 0; }
.views { display: flex; flex-wrap: wrap; gap: 6px; margin: 0 0 6px;
  align-items: center; }
.views button { font: inherit; padding: 4px 14px; border-radius: 6px;
  border: 1px solid var(--line); background: #fff; color: inherit;
  cursor: pointer; }
.views button:hover { border-color: var(--accent); }
.views button[aria-pressed="true"] { background: var(--accent);
  border-color: var(--accent); color: #fff; }
.key { margin-left: auto; color: var(--soft); font-size: 12.5px; }
.key i { display: inline-block; width: 22px; height: 11px;
  vertical-align: -1px; margin: 0 4px 0 12px; border-radius: 2px;
  border: 1px solid var(--line); }
.degraded { background: rgba(240,200,40,0.28); }
.suspect { background: rgba(213,94,0,0.22); }
.invalid { background: rgba(90,90,90,0.30); }
footer { color: var(--soft); font-size: 12.5px; }
@media (max-width: 800px) { .facts { columns: 1; } }
@media print { body { background: #fff; } .views button { display: none; } }
"""

SCRIPT: Final = r"""
"use strict";
const drive = JSON.parse(document.getElementById("drive").textContent);
const plot = document.getElementById("plot");
const buttons = document.querySelectorAll(".views button");
const epoch = Date.parse(drive.epoch);
for (const trace of drive.traces) {
  trace.x = trace.x.map(
    (s) => new Date(epoch + s * 1000).toISOString().slice(0, -1));
}
function timeAxis(layout) {
  return Object.keys(layout || {}).find((key) => /^xaxis\d*$/.test(key));
}
async function show(index) {
  const view = drive.views[index];
  const layout = structuredClone(view.layout);
  layout.uirevision = index;
  // the stretch of time that a reader chose outlives a change of view
  const shown = timeAxis(plot.layout), axis = timeAxis(layout);
  const chosen = shown && plot.layout[shown].range.slice();
  // only what is seen: a hidden curve would still claim its axes
  const traces = view.traces.map((i) => ({
    ...drive.traces[i], uid: "t" + i, showlegend: view.named.includes(i) }));
  buttons.forEach((button, i) =>
    button.setAttribute("aria-pressed", String(i === index)));
  await Plotly.react(plot, traces, layout, {
    responsive: true, displaylogo: false, doubleClick: "reset",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
    toImageButtonOptions: { filename: "brake-temperatures", scale: 2 } });
  // set afterwards, so that a double-click knows the whole drive
  if (chosen && axis && String(chosen) !== String(view.layout[axis].range)) {
    await Plotly.relayout(plot, { [axis + ".range"]: chosen });
  }
}
buttons.forEach((button, i) => button.addEventListener("click",
  () => show(i)));
show(0).then(() => { plot.dataset.drawn = "yes"; });
"""
