"use strict";
// The views of a training (curves) and of a sweep (points with intervals). Both grow while they run.

const MARKS = ["circle", "square", "triangle", "diamond", "circle", "square", "triangle", "diamond"];

/** Markers and whiskers of the points of each controller; every second round of marks is hollow. */
function whiskers(u, groups, theme) {
  const ratio = uPlot.pxRatio;
  const size = 4 * ratio;
  [...groups.values()].forEach((points, k) => {
    const colour = theme.palette[k % theme.palette.length];
    u.ctx.save();
    u.ctx.strokeStyle = colour;
    u.ctx.fillStyle = k < 4 ? colour : theme.panel;
    u.ctx.lineWidth = 1.5 * ratio;
    for (const { x, value, low, high } of points) {
      // Side by side, so that no whisker hides another.
      const aside = (k - (groups.size - 1) / 2) * 1.4 * size;
      const [px, py] = [u.valToPos(x, "x", true) + aside, u.valToPos(value, "y", true)];
      u.ctx.beginPath();
      if (Number.isFinite(low) && Number.isFinite(high)) {
        u.ctx.moveTo(px, u.valToPos(low, "y", true));
        u.ctx.lineTo(px, u.valToPos(high, "y", true));
        u.ctx.stroke();
        u.ctx.beginPath();
      }
      marker(u.ctx, MARKS[k % MARKS.length], px, py, size);
      u.ctx.fill();
      u.ctx.stroke();
    }
    u.ctx.restore();
  });
}

function marker(context, kind, x, y, size) {
  if (kind === "circle") context.arc(x, y, size, 0, 2 * Math.PI);
  if (kind === "square") context.rect(x - size, y - size, 2 * size, 2 * size);
  if (kind === "triangle" || kind === "diamond") {
    context.moveTo(x, y - 1.3 * size);
    context.lineTo(x + 1.2 * size, y + (kind === "diamond" ? 0 : size));
    if (kind === "diamond") context.lineTo(x, y + 1.3 * size);
    context.lineTo(x - 1.2 * size, y + (kind === "diamond" ? 0 : size));
    context.closePath();
  }
}

class Study {
  constructor(root, store) {
    this.root = root;
    this.store = store;
    this.charts = new Map();
  }

  clear() {
    this.charts.clear();
    this.root.querySelector(".charts").replaceChildren();
  }

  build(theme) {
    this.theme = theme;
    for (const chart of this.charts.values()) chart.build(theme);
    if (this.charts.size > 0) this.legend();
  }

  update() {
    for (const [name, curve] of this.store.curves) this.curve(name, curve);
    const metrics = new Map();
    for (const point of this.store.points) {
      if (!metrics.has(point.metric)) metrics.set(point.metric, new Map());
      const groups = metrics.get(point.metric);
      if (!groups.has(point.controller)) groups.set(point.controller, []);
      groups.get(point.controller).push(point);
    }
    for (const [metric, groups] of metrics) this.metric(metric, groups);
    this.legend();
  }

  legend() {
    const names = [...new Set(this.store.points.map((point) => point.controller))];
    const items = names.map((name, k) => {
      const item = document.createElement("li");
      const mark = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      mark.setAttribute("viewBox", "-8 -8 16 16");
      mark.setAttribute("aria-hidden", "true");
      const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
      path.setAttribute("d", {
        circle: "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z",
        square: "M-5 -5h10v10h-10z",
        triangle: "M0 -6L6 5L-6 5z",
        diamond: "M0 -6L6 0L0 6L-6 0z",
      }[MARKS[k % MARKS.length]]);
      path.style.stroke = this.theme.palette[k % this.theme.palette.length];
      path.style.fill = k < 4 ? path.style.stroke : this.theme.panel;
      mark.append(path);
      item.append(mark, name);
      return item;
    });
    this.root.querySelector(".study-legend").replaceChildren(...items);
  }

  figure(name, options) {
    if (!this.charts.has(name)) {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      caption.textContent = name;
      const box = document.createElement("div");
      box.className = "chart";
      figure.append(caption, box);
      this.root.querySelector(".charts").append(figure);
      const chart = new Chart(box, { height: 12, ...options });
      this.charts.set(name, chart);
      chart.build(this.theme);
    }
    return this.charts.get(name);
  }

  curve(name, curve) {
    const positive = curve.values.every((value) => value > 0);
    const spread = Math.max(...curve.values.slice(-1000)) / Math.min(...curve.values.slice(-1000));
    const log = positive && spread > 30;
    const chart = this.figure(name, { series: [{ ink: "accent" }], log });
    if (chart.options.log !== log) {
      chart.options.log = log;
      chart.build(this.theme);
    }
    chart.set([curve.ticks, curve.values.map(finite)]);
  }

  metric(metric, groups) {
    const chart = this.figure(metric, {
      series: [{ ink: "ink", width: 0 }, { ink: "ink", width: 0 }],
      xRange: (u, low, high) => [low - (high - low || 1) * 0.08, high + (high - low || 1) * 0.08],
      draw: (u, theme) => whiskers(u, chart.groups ?? new Map(), theme),
    });
    chart.groups = groups;
    const points = [...groups.values()].flat().sort((a, b) => a.x - b.x);
    const bounds = (key) => points.map((point) => finite(point[key]) ?? point.value);
    chart.set([points.map((point) => point.x), bounds("low"), bounds("high")]);
  }
}
