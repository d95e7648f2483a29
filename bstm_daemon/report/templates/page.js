"use strict";
// Shows what the page's JSON says; it reads data, so no data becomes code.
const page = JSON.parse(document.getElementById("page").textContent);
const epoch = Date.parse(page.epoch);
const plot = document.getElementById("plot");
const buttons = document.querySelectorAll(".views button");

function toDates(trace) {
  trace.x = trace.x.map(
    (s) => new Date(epoch + s * 1000).toISOString().slice(0, -1));
}

function timeAxis(layout) {
  return Object.keys(layout || {}).find((key) => /^xaxis\d*$/.test(key));
}

async function show(index) {
  const view = page.figure.views[index];
  const layout = structuredClone(view.layout);
  layout.uirevision = index;
  // the stretch of time that a reader chose outlives a change of view
  const shown = timeAxis(plot.layout), axis = timeAxis(layout);
  const chosen = shown && plot.layout[shown].range.slice();
  // only what is seen: a hidden curve would still claim its axes
  const traces = view.traces.map((i) => ({ ...page.figure.traces[i],
    uid: "t" + i, showlegend: view.named.includes(i) }));
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

async function drawAll() {
  if (page.figure) {
    page.figure.traces.forEach(toDates);
    buttons.forEach((button, i) => button.addEventListener("click",
      () => show(i)));
    await show(0);
  }
  const config = { responsive: true, displayModeBar: false };
  for (const [i, { data, layout, clock }] of page.plots.entries()) {
    // x2 is a quantity, whatever the first axis is
    if (clock) data.filter((trace) => trace.xaxis !== "x2").forEach(toDates);
    await Plotly.newPlot("plot-" + i, data, layout, config);
  }
  document.body.dataset.drawn = "yes";
}

drawAll();
