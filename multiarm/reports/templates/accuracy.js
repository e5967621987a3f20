// Draws the diagrams of error over work from the numbers in the page, again for another quantity or
// other methods. It uses no library and makes no request.
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const NS = "http://www.w3.org/2000/svg";
const WIDTH = 620, HEIGHT = 440, LEFT = 62, RIGHT = 14, TOP = 10, BOTTOM = 44;
const shown = new Set(data.series.map(series => series.name));
let quantity = data.quantity;

function element(name, attributes, parent) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (parent) parent.append(node);
  return node;
}
function power(exponent) {
  const digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const text = String(Math.abs(exponent)).replace(/\d/g, digit => digits[digit]);
  return "10" + (exponent < 0 ? "⁻" : "") + text;
}
function number(value, unit) {
  if (value === null || value === undefined) return "\u2013";
  let text;
  if (value === 0) text = "0";
  else if (Math.abs(value) >= 1e-2 && Math.abs(value) < 1e5) text = String(+value.toPrecision(3));
  else {
    const [mantissa, exponent] = value.toExponential(1).split("e");
    text = mantissa + "\u00d7" + power(+exponent);
  }
  return unit ? text + " " + unit : text;
}
function mark(kind, x, y, size, attributes, parent) {
  if (kind === "o") return element("circle", {cx: x, cy: y, r: size, ...attributes}, parent);
  const corners = {
    s: [[-1, -1], [1, -1], [1, 1], [-1, 1]], "^": [[0, -1.3], [1.2, 0.9], [-1.2, 0.9]],
    D: [[0, -1.35], [1.35, 0], [0, 1.35], [-1.35, 0]],
  }[kind];
  const points = corners.map(([a, b]) => `${x + a * size},${y + b * size}`).join(" ");
  return element("polygon", {points, ...attributes}, parent);
}
function place(point, work) {
  const error = point.errors[quantity];
  if (error === null || error === undefined || !point[work]) return null;
  return [point[work], Math.max(error, data.digits[quantity] || 1e-300)];
}
function range(values, step) {
  const low = Math.log10(Math.min(...values)), high = Math.log10(Math.max(...values));
  return [Math.floor((low - 0.04) / step) * step, Math.ceil((high + 0.04) / step) * step];
}
function draw(figure, work, label) {
  const old = figure.querySelector("svg");
  const svg = element("svg", {viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img",
    "aria-label": label});
  const places = data.series.flatMap(s => s.points.map(p => place(p, work))).filter(p => p);
  if (!places.length) {
    element("text", {x: WIDTH / 2, y: HEIGHT / 2, "text-anchor": "middle", class: "soft"}, svg)
      .textContent = "no values";
    old ? old.replaceWith(svg) : figure.append(svg);
    return;
  }
  const digits = data.digits[quantity];
  const [x0, x1] = range(places.map(p => p[0]), 0.5);
  const [y0, y1] = range([...places.map(p => p[1]), digits / 3], 1);
  const X = v => LEFT + (Math.log10(v) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
  const Y = v => TOP + (y1 - Math.log10(v)) / (y1 - y0) * (HEIGHT - TOP - BOTTOM);
  const bottom = HEIGHT - BOTTOM, right = WIDTH - RIGHT;
  if (digits > 0) {
    const top = Math.min(bottom, Math.max(TOP, Y(digits)));
    element("rect", {x: LEFT, y: top, width: right - LEFT, height: bottom - top, class: "digits"},
      svg);
    element("text", {x: right - 6, y: bottom - 6, "text-anchor": "end", class: "soft"}, svg)
      .textContent = "below the digits of the reference";
  }
  for (let k = Math.ceil(x0); k <= x1; k++) {
    const x = X(10 ** k);
    element("line", {x1: x, x2: x, y1: TOP, y2: bottom, class: "grid"}, svg);
    element("text", {x, y: bottom + 16, "text-anchor": "middle"}, svg).textContent = power(k);
    for (let m = 2; m < 10; m++) {
      const minor = Math.log10(m) + k;
      if (minor > x1) break;
      const at = X(10 ** minor);
      element("line", {x1: at, x2: at, y1: bottom, y2: bottom + 3, class: "axis"}, svg);
    }
  }
  for (let k = Math.ceil(y0); k <= y1; k++) {
    const y = Y(10 ** k);
    element("line", {x1: LEFT, x2: right, y1: y, y2: y, class: "grid"}, svg);
    if ((y1 - y0) <= 9 || (k - y1) % 2 === 0)
      element("text", {x: LEFT - 7, y: y + 4, "text-anchor": "end"}, svg).textContent = power(k);
  }
  element("line", {x1: LEFT, x2: right, y1: bottom, y2: bottom, class: "axis"}, svg);
  element("line", {x1: LEFT, x2: LEFT, y1: TOP, y2: bottom, class: "axis"}, svg);
  element("text", {x: (LEFT + right) / 2, y: HEIGHT - 8, "text-anchor": "middle"}, svg)
    .textContent = label;
  const [what, unit] = data.quantities[quantity];
  element("text", {x: 0, y: 0, "text-anchor": "middle",
    transform: `translate(14 ${(TOP + bottom) / 2}) rotate(-90)`}, svg)
    .textContent = `${what} [${unit}]`;
  const best = data.best[quantity];
  for (const series of data.series) {
    if (!shown.has(series.name)) continue;
    const group = element("g", {"data-series": series.name}, svg);
    const found = series.points.map(p => [p, place(p, work)]).filter(pair => pair[1]);
    const line = found.map(([, p]) => `${X(p[0]).toFixed(1)},${Y(p[1]).toFixed(1)}`).join(" ");
    element("polyline", {points: line, fill: "none", stroke: series.colour,
      "stroke-width": series.main ? 2.6 : 1.4, "stroke-dasharray": series.dashes,
      "stroke-linejoin": "round"}, group);
    for (const [point, p] of found) {
      const x = X(p[0]), y = Y(p[1]);
      mark(series.marker, x, y, series.main ? 3.8 : 3.1, {fill: series.colour}, group);
      if (point.key in best) element("circle", {cx: x, cy: y, r: 7.5, class: "best"}, group);
      const hit = element("circle", {cx: x, cy: y, r: 9, fill: "transparent", "class": "hit",
        "data-key": point.key, tabindex: -1}, group);
      hit.addEventListener("pointerenter", event => showTip(event, series, point));
      hit.addEventListener("pointerleave", quiet);
    }
  }
  old ? old.replaceWith(svg) : figure.append(svg);
}
const tip = document.getElementById("tip");
function showTip(event, series, point) {
  const [what, unit] = data.quantities[quantity];
  const rows = [["error, " + what, number(point.errors[quantity], unit.split(",")[0])],
    ["wall time", number(1e3 * point.wall_time_s, "ms")],
    ["evaluations", number(point.evaluations)], ["steps", number(point.steps)],
    ["largest gap", number(point.gap_m, "m")]];
  if (point.energy_J !== null) rows.push(["energy error", number(point.energy_J, "J")]);
  const levels = data.best[quantity][point.key];
  if (levels) rows.push(["cheapest for", levels.map(level => power(level)).join(", ")]);
  tip.replaceChildren();
  const head = document.createElement("b");
  head.textContent = `${series.name}, ${point.knob}`;
  const list = document.createElement("dl");
  for (const [name, value] of rows) {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name; dd.textContent = value;
    list.append(dt, dd);
  }
  tip.append(head, list);
  tip.style.display = "block";
  const box = tip.getBoundingClientRect(), wide = document.documentElement.clientWidth;
  const left = Math.min(event.pageX + 14, window.scrollX + wide - box.width - 8);
  tip.style.left = Math.max(window.scrollX + 4, left) + "px";
  tip.style.top = Math.max(window.scrollY + 4, event.pageY - box.height - 12) + "px";
  for (const group of document.querySelectorAll(".panels g[data-series]"))
    group.classList.toggle("dim", group.dataset.series !== series.name);
}
function quiet() {
  tip.style.display = "none";
  for (const group of document.querySelectorAll(".panels g.dim")) group.classList.remove("dim");
}
function redraw() {
  quiet();
  draw(document.getElementById("over-time"), "wall_time_s", "wall time [s]");
  draw(document.getElementById("over-evaluations"), "evaluations", "evaluations");
  for (const part of document.querySelectorAll("[data-quantity]"))
    part.classList.toggle("hidden", part.dataset.quantity !== quantity);
  for (const button of document.querySelectorAll(".legend button"))
    button.setAttribute("aria-pressed", shown.has(button.dataset.name));
}
const legend = document.querySelector(".legend");
for (const series of data.series) {
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.name = series.name;
  const key = element("svg", {viewBox: "0 0 42 14", "aria-hidden": "true"}, button);
  element("line", {x1: 1, x2: 41, y1: 7, y2: 7, stroke: series.colour,
    "stroke-width": series.main ? 3 : 1.8, "stroke-dasharray": series.dashes}, key);
  mark(series.marker, 21, 7, 3.6, {fill: series.colour}, key);
  button.append(series.name);
  button.addEventListener("click", () => {
    if (!shown.delete(series.name)) shown.add(series.name);
    redraw();
  });
  legend.append(button);
}
for (const button of document.querySelectorAll("button[data-show]"))
  button.addEventListener("click", () => {
    shown.clear();
    for (const series of data.series)
      if (button.dataset.show === "all" || (button.dataset.show === "ours") === series.ours)
        shown.add(series.name);
    redraw();
  });
document.getElementById("quantity").addEventListener("change", event => {
  quantity = event.target.value;
  redraw();
});
redraw();
