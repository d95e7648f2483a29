"use strict";
// Draws what the page's JSON says; it reads data, so no data becomes code.
const DARK = { "#1f2328": "#e6edf3", "#000000": "#e6edf3",
  "#e6e8eb": "#30363d", "#ffffff": "#161b22", "#f7f7f7": "#2d333b", "#0072b2": "#56a8e0",
  "#a32c00": "#e5603a", "#5a3d8a": "#a98be0", "#00573f": "#4fbf9f",
  "rgba(255,255,255,0.6)": "rgba(22,27,34,0.6)" };
const NARROW_PX = 700, LEGEND_LINE_PX = 20, COLOUR_BAR_PX = 64, SHORT = 4;
const scheme = matchMedia("(prefers-color-scheme: dark)");
const page = JSON.parse(document.getElementById("page").textContent,
  (key, value) => (scheme.matches && typeof value === "string"
    && DARK[value]) || value);
const epoch = Date.parse(page.epoch);
const buttons = document.querySelectorAll(".views button");
const drawn = new Set(), linked = [];
let range = null;

function toDates(trace) {
  trace.x = trace.x.map(
    (s) => new Date(epoch + s * 1000).toISOString().slice(0, -1));
}

// on a small screen the legend and the colours' scale are below the panel
function narrowed({ data, layout }) {
  const { margin } = layout, inner = layout.height - margin.t - margin.b;
  const below = { x: 0, y: -(margin.b + 4) / inner, yanchor: "top" };
  const named = data.filter((trace) => trace.name && trace.showlegend);
  const short = named.every((trace) => trace.name.length < SHORT);
  let room = (short ? Math.min(named.length, 1) : named.length)
    * LEGEND_LINE_PX;
  layout.legend = { ...layout.legend, ...below, xanchor: "left",
    orientation: short ? "h" : "v" };
  for (const bar of data.map((trace) =>
    trace.colorbar || (trace.marker && trace.marker.colorbar))) {
    if (!bar) continue;
    Object.assign(bar, below, { orientation: "h", len: 1, xanchor: "left" });
    bar.title = { ...bar.title, side: "top" };
    room += COLOUR_BAR_PX;
  }
  margin.l = Math.min(margin.l, 0.4 * innerWidth);
  margin.r = layout.yaxis2 || layout.yaxis3 ? 46 : 10;
  room += room && LEGEND_LINE_PX;
  margin.autoexpand = false;
  margin.b += room;
  layout.height += room;
  layout.xaxis = { ...layout.xaxis, nticks: 5, tickangle: 0 };
}

function link(plot) {
  linked.push(plot);
  plot.on("plotly_relayout", (change) => {
    if (Object.keys(change).some((key) => key.startsWith("xaxis"))) {
      range = plot.layout.xaxis.range.slice();
      follow();
    }
  });
  const others = () => linked.filter((one) => one !== plot
    && one.checkVisibility());
  plot.on("plotly_hover", ({ xvals }) => others().forEach((one) =>
    Plotly.Fx.hover(one, { xval: xvals[0] }, "xy", true)));
  plot.on("plotly_unhover", () => others().forEach((one) =>
    Plotly.Fx.hover(one, [], "xy", true)));
}

// the stretch of time that a reader chose holds for every view
async function follow() {
  for (const plot of linked.filter((one) => one.checkVisibility())) {
    if (range && String(plot.layout.xaxis.range) !== String(range)) {
      await Plotly.relayout(plot, { "xaxis.range": range.slice() });
    }
  }
}

// what is folded or of another view is drawn when it is shown
async function drawSeen() {
  for (const [i, one] of page.plots.entries()) {
    const place = document.getElementById("plot-" + i);
    if (drawn.has(i) || !place.checkVisibility()) continue;
    drawn.add(i);
    if (one.clock) one.data.forEach(toDates);
    if (innerWidth < NARROW_PX) narrowed(one);
    await Plotly.newPlot(place, one.data, one.layout,
      { responsive: true, displayModeBar: false, doubleClick: "reset" });
    if (one.linked) link(place);
  }
  await follow();
  document.body.dataset.drawn = "yes";
}

function show(name) {
  buttons.forEach((button) => button.setAttribute("aria-pressed",
    String(button.textContent === name)));
  document.querySelectorAll(".plot[data-view]").forEach((plot) => {
    plot.hidden = plot.dataset.view !== name;
  });
  return drawSeen();
}

buttons.forEach((button) => button.addEventListener("click",
  () => show(button.textContent)));
document.querySelectorAll("details").forEach((part) =>
  part.addEventListener("toggle", drawSeen));
scheme.addEventListener("change", () => location.reload());
if (buttons.length) show(buttons[0].textContent); else drawSeen();
