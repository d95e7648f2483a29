"use strict";
// The page of one car: it shows what it is sent and asks for nothing else.
const CORNERS = ["FL", "FR", "RL", "RR"];
const STALE_MS = 1500;
const MOST_POINTS = 1800;
const SHOWN = ["valid", "degraded"];
const $ = (id) => document.getElementById(id);

const cards = {};
for (const name of CORNERS) {
  const card = $("corner").content.firstElementChild.cloneNode(true);
  card.classList.add(`corner-${name}`);
  card.querySelector(".name").textContent = name;
  $("car").append(card);
  cards[name] = card;
}

const words = (text) => text.replaceAll("_", " ");
const isNumber = (value) => typeof value === "number";
const figure = (value, unit, digits = 0) =>
  isNumber(value) ? `${value.toFixed(digits)} ${unit}` : "–";
const minutes = (seconds) => seconds === "beyond" ? "longer than the forecast"
  : seconds < 90 ? `${seconds} s` : `${Math.round(seconds / 60)} min`;

function put(element, text, ...classes) {
  element.textContent = text;
  element.classList.remove("valid", "degraded", "invalid", "not_available",
    "normal", "elevated", "high", "critical", "unknown");
  element.classList.add(...classes);
}

function showCorner(name, corner, most) {
  const card = cards[name];
  card.hidden = !corner;
  if (!corner) return;
  const usable = SHOWN.includes(corner.validity);
  card.className = `corner corner-${name} ${corner.validity}`;
  put(card.querySelector(".validity"), words(corner.validity), corner.validity);
  for (const key of ["disc_c", "pad_front_c", "fluid_c", "peak_c"])
    card.querySelector(`.${key}`).textContent =
      figure(usable ? corner[key] : null, "°C");
  card.querySelector(".margin_k").textContent =
    figure(usable ? corner.margin_k : null, "K");
  card.querySelector(".pad_mm").textContent =
    SHOWN.includes(corner.wear_validity) ? figure(corner.pad_mm, "mm", 1) : "–";
  const level = usable ? corner.level : "unknown";
  put(card.querySelector(".level"), `risk ${level === "unknown" ? "" : most}${level}`
    + (usable && isNumber(corner.peak_c) && corner.peak_in_s > 0
      ? `, peak in ${minutes(corner.peak_in_s)} if parked` : ""), level);
  card.querySelector(".reasons").textContent = corner.reasons.join(", ");
  $(`wheel-${name}`).setAttribute("class", `wheel ${usable ? level : ""}`);
}

// The worst over the corners that can be used; "?" where one can not.
function worst(corners, key, better) {
  const known = Object.entries(corners).filter(([, one]) =>
    SHOWN.includes(one.validity) && isNumber(one[key]));
  known.sort(([, a], [, b]) => better(a[key], b[key]));
  const hidden = known.length < Object.keys(corners).length;
  return [known[0], hidden];
}

function showFigure(id, corners, key, unit, what, better, most) {
  const [found, hidden] = worst(corners, key, better);
  const level = found ? found[1].level : "unknown";
  put($(id), found ? figure(found[1][key], unit) : "–",
    hidden && level === "normal" ? "unknown" : level);
  $(`${id}-of`).textContent = what + (found ? `, ${found[0]}` : "")
    + (found && found[1].validity !== "valid" ? `, ${found[1].validity}` : "")
    + (hidden ? ", of the corners that are known" : "") + most;
}

function showAdvice(advice) {
  const parts = [advice.message, advice.shift_advice, advice.sound]
    .filter((one) => !["none", "not_available"].includes(one));
  if (isNumber(advice.waiting_s) && advice.waiting_s > 0
      || advice.waiting_s === "beyond")
    parts.push(`wait ${minutes(advice.waiting_s)}`);
  const usable = SHOWN.includes(advice.validity);
  $("advice").textContent = usable ? parts.map(words).join(", ") : "";
}

function show(record) {
  $("vehicle").textContent = record.vehicle;
  document.title = `${record.vehicle}: brakes`;
  const said = new Set([words(record.state), words(record.validity)]);
  put($("state"), [...said].join(", "), record.validity);
  $("time").textContent = new Date(record.time_s * 1000).toLocaleString();
  const most = record.history_known ? "" : "at most ";
  for (const name of CORNERS) showCorner(name, record.corners[name], most);
  const bound = record.history_known ? "" : ", start unknown";
  showFigure("margin", record.corners, "margin_k", "K",
    "least margin to boiling", (a, b) => a - b, bound);
  showFigure("peak", record.corners, "peak_c", "°C",
    "forecast peak of the fluid", (a, b) => b - a, bound);
  showAdvice(record.advice);
}

// Curves: one array a column, as uPlot takes them.
const columns = Array.from({ length: 1 + 2 * CORNERS.length }, () => []);
function addPoints(points, reset) {
  if (reset) for (const column of columns) column.length = 0;
  for (const point of points) {
    const times = columns[0];
    const at = times.length && times.at(-1) === point[0]
      ? times.length - 1 : times.length;
    point.forEach((value, i) => { columns[i][at] = value; });
  }
  const extra = columns[0].length - MOST_POINTS;
  if (extra > 0) for (const column of columns) column.splice(0, extra);
}

const color = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(name).trim();
let plots = [];
function draw() {
  for (const plot of plots) plot.destroy();
  const axis = { stroke: color("--soft"), grid: { stroke: color("--line") },
    ticks: { stroke: color("--line") } };
  plots = ["disc", "fluid"].map((what, number) => {
    const place = $(`plot-${what}`);
    return new uPlot({
      width: Math.max(place.clientWidth, 200), height: 230,
      legend: { live: false },
      axes: [{ ...axis }, { ...axis, size: 44 }],
      series: [{}, ...CORNERS.map((name) => ({ label: name, width: 2,
        stroke: color(`--${name.toLowerCase()}`), spanGaps: false }))],
    }, data(number), place);
  });
}
const data = (number) =>
  [columns[0], ...columns.slice(1 + 4 * number, 5 + 4 * number)];

let freshAt = -Infinity;
function judge() {
  const silent = performance.now() - freshAt;
  const stale = silent > STALE_MS;
  document.body.classList.toggle("stale", stale);
  if (stale) $("notice").textContent = freshAt === -Infinity
    ? "Waiting for data" : `No data for ${Math.round(silent / 1000)} s`;
}

function listen() {
  const events = new EventSource("/events");
  events.onmessage = (event) => {
    const { source, record, age_s, points, reset } = JSON.parse(event.data);
    $("source").textContent = source;
    if (!record) return;
    freshAt = performance.now() - 1000 * age_s;
    show(record);
    addPoints(points, reset);
    plots.forEach((plot, number) => plot.setData(data(number)));
    judge();
  };
  // the browser does not come back by itself from a refusal
  events.onerror = () => {
    if (events.readyState === EventSource.CLOSED) setTimeout(listen, 1000);
  };
}

$("night").addEventListener("click", () => {
  const root = document.documentElement;
  const dark = color("--back") === "#0b0d10";
  root.dataset.theme = dark ? "light" : "dark";
  draw();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
let width = innerWidth;
addEventListener("resize", () => {
  if (innerWidth !== width) { width = innerWidth; draw(); }
});
document.addEventListener("visibilitychange", judge);
draw();
listen();
setInterval(judge, 100);
