"use strict";
// Charts by uPlot: strips of the flight, the predicted horizon, and the views of sweeps and trainings.

/** What a chart of the page has in common: colours, fonts, no legend, the width of its box. */
class Chart {
  /** `series` are uPlot's; `draw(u)` adds lines and marks; `pick(x)` is told where the chart was clicked. */
  constructor(box, { series, range, draw, pick, height = 6.2, log = false, splits, xRange }) {
    this.box = box;
    this.options = { series, range, draw, pick, height, log, splits, xRange };
    this.data = [[], ...series.map(() => [])];
  }

  /** Builds the chart anew, for a new theme or a new size. */
  build(theme) {
    const { series, range, draw, pick, height, log, splits, xRange } = this.options;
    this.plot?.destroy();
    const rem = parseFloat(getComputedStyle(document.documentElement).fontSize);
    const axis = {
      stroke: theme.muted,
      font: `${0.75 * rem}px system-ui, sans-serif`,
      grid: { stroke: theme.grid, width: 1 },
      ticks: { show: false },
      gap: 4,
    };
    const options = {
      width: Math.max(80, this.box.clientWidth),
      // A tall screen gets taller charts.
      height: height * rem * Math.max(1, Math.min(1.5, innerHeight / (60 * rem))),
      legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
      padding: [0.4 * rem, 1.1 * rem, 0, 0],
      scales: { x: { time: false, range: xRange }, y: { range, distr: log ? 3 : 1 } },
      axes: [
        { ...axis, size: 1.5 * rem, space: 3.5 * rem },
        { ...axis, size: 2.9 * rem, space: 1.5 * rem, splits },
      ],
      series: [{}, ...series.map((one) => ({ points: { show: false }, width: 1.5, ...one, stroke: theme[one.ink] }))],
      hooks: { draw: draw ? [(u) => draw(u, theme)] : [] },
    };
    this.plot = new uPlot(options, this.data, this.box);
    if (pick) {
      this.plot.over.addEventListener("click", (event) => {
        pick(this.plot.posToVal(event.offsetX, "x"));
      });
      this.mark = document.createElement("div");
      this.mark.className = "now";
      this.plot.over.append(this.mark);
      this.moveMark(this.at ?? 0);
    }
  }

  set(data) {
    this.data = data;
    this.plot?.setData(data);
  }

  /** The line of the cursor, and the veil over what lies after it. */
  moveMark(x) {
    this.at = x;
    if (!this.mark || !(this.data[0].length > 0)) return;
    const left = this.plot.valToPos(x, "x");
    if (Number.isFinite(left)) this.mark.style.transform = `translateX(${left}px)`;
  }
}

/** A dashed level across a chart, in device pixels as uPlot's hooks draw. */
function levelLine(u, value, colour, dash = [5, 4]) {
  if (!Number.isFinite(value)) return;
  const y = Math.round(u.valToPos(value, "y", true)) + 0.5;
  const { left, top, width, height } = u.bbox;
  if (y < top || y > top + height) return;
  u.ctx.save();
  u.ctx.strokeStyle = colour;
  u.ctx.lineWidth = uPlot.pxRatio;
  u.ctx.setLineDash(dash.map((length) => length * uPlot.pxRatio));
  u.ctx.beginPath();
  u.ctx.moveTo(left, y);
  u.ctx.lineTo(left + width, y);
  u.ctx.stroke();
  u.ctx.restore();
}

/** Crosses at [x, y] pairs of a chart; what lies outside is drawn at its edge. */
function crosses(u, points, colour) {
  const size = 3.5 * uPlot.pxRatio;
  const { top, height } = u.bbox;
  u.ctx.save();
  u.ctx.strokeStyle = colour;
  u.ctx.lineWidth = 1.6 * uPlot.pxRatio;
  u.ctx.beginPath();
  for (const [valueX, valueY] of points) {
    const x = u.valToPos(valueX, "x", true);
    const y = Math.max(top + size, Math.min(top + height - size, u.valToPos(valueY, "y", true)));
    u.ctx.moveTo(x - size, y - size);
    u.ctx.lineTo(x + size, y + size);
    u.ctx.moveTo(x - size, y + size);
    u.ctx.lineTo(x + size, y - size);
  }
  u.ctx.stroke();
  u.ctx.restore();
}

const finite = (value) => (Number.isFinite(value) ? value : null);
const last = (values) => values[values.length - 1];

/** The strips of the selected flight: SNR, risk, power and rate over the intervals. */
class Strips {
  constructor(root, store, pick) {
    this.store = store;
    const outages = () => this.outages ?? [];
    const box = (name) => root.querySelector(`[data-chart="${name}"]`);
    const limits = () => store.limits;
    this.charts = {
      snr: new Chart(box("snr"), {
        series: [{ ink: "ink" }],
        range: (u, low, high) => [Math.min(low ?? 0, limits().gamma_min_db) - 1, Math.max(high ?? 0, 3) + 1],
        draw(u, theme) {
          levelLine(u, limits().gamma_min_db, theme.high, []);
          levelLine(u, limits().rate_snr_db, theme.high);
          crosses(u, outages(), theme.ink);
        },
        pick,
      }),
      risk: new Chart(box("risk"), {
        series: [{ ink: "ink" }],
        range: (u, low, high) => [0, Math.max(1.3 * limits().delta, high ?? 0)],
        draw: (u, theme) => levelLine(u, limits().delta, theme.high),
        pick,
      }),
      power: new Chart(box("power"), {
        series: [{ ink: "low", width: 2, paths: uPlot.paths.stepped({ align: 1 }) }],
        range: () => [0, 1.15 * last(store.powers)],
        draw(u, theme) {
          const high = u.data[1].map((value) => (value > store.powers[0] ? value : null));
          steps(u, high, theme.high);
        },
        pick,
        splits: () => store.powers,
        height: 4.6,
      }),
      rate: new Chart(box("rate"), {
        series: [{ ink: "ink" }],
        range: (u, low, high) => [0, 1.1 * Math.max(high ?? 0, 1.2 * (limits().rate_min ?? 0), 1e-9)],
        draw: (u, theme) => levelLine(u, limits().rate_min, theme.high),
        pick,
      }),
    };
  }

  build(theme) {
    for (const chart of Object.values(this.charts)) chart.build(theme);
  }

  update(flight) {
    const lines = flight?.record.values ?? [];
    const ticks = lines.map((line) => line.tick);
    this.outages = lines.filter((line) => line.outage).map((line) => [line.tick, line.snr_db]);
    const keys = { snr: "snr_db", risk: "p_coll", power: "power", rate: "rate" };
    for (const [name, chart] of Object.entries(this.charts)) {
      const values = lines.map((line) => finite(line[keys[name]]));
      chart.box.closest("figure").hidden = lines.length > 0 && values.every((value) => value === null);
      chart.set([ticks, values]);
    }
  }

  /** Whether there is a strip to look at. */
  get any() {
    return Object.values(this.charts).some((chart) => !chart.box.closest("figure").hidden);
  }

  moveMark(tick) {
    for (const chart of Object.values(this.charts)) chart.moveMark(tick);
  }
}

/** Draws steps over a strip, for values that need a second colour and width. */
function steps(u, values, colour) {
  u.ctx.save();
  u.ctx.strokeStyle = colour;
  u.ctx.lineWidth = 3.5 * uPlot.pxRatio;
  u.ctx.beginPath();
  values.forEach((value, k) => {
    if (value === null) return;
    const y = u.valToPos(value, "y", true);
    u.ctx.moveTo(u.valToPos(u.data[0][k], "x", true), y);
    u.ctx.lineTo(u.valToPos(u.data[0][k + 1] ?? u.data[0][k] + 1, "x", true), y);
  });
  u.ctx.stroke();
  u.ctx.restore();
}

/** The horizon: what the model predicts from its latest belief on, beside what then happened. */
class Horizon {
  constructor(root, store) {
    this.store = store;
    const box = (name) => root.querySelector(`[data-chart="${name}"]`);
    const limits = () => store.limits;
    const series = [{ ink: "ink", width: 1.2 }, { ink: "belief", width: 2 }];
    this.charts = {
      snr_db: new Chart(box("horizon-snr"), {
        series,
        range: (u, low, high) => [Math.min(low ?? 0, limits().gamma_min_db) - 1, Math.max(high ?? 0, 3) + 1],
        draw(u, theme) {
          levelLine(u, limits().gamma_min_db, theme.high, []);
          levelLine(u, limits().rate_snr_db, theme.high);
        },
        height: 5.6,
      }),
      outage: new Chart(box("horizon-outage"), {
        series: [{ ink: "ink", width: 0 }, series[1]],
        range: () => [0, 1.08],
        draw: (u, theme) => {
          levelLine(u, limits().eta, theme.high);
          crosses(u, u.data[0].flatMap((tick, k) => (u.data[1][k] === 1 ? [[tick, 1]] : [])), theme.ink);
        },
        height: 5,
      }),
      risk: new Chart(box("horizon-risk"), {
        series,
        range: (u, low, high) => [0, Math.max(1.3 * limits().delta, Math.min(1, high ?? 0))],
        draw: (u, theme) => levelLine(u, limits().delta, theme.high),
        height: 5,
      }),
    };
  }

  build(theme) {
    for (const chart of Object.values(this.charts)) chart.build(theme);
  }

  /** Element i of a prediction is of interval tick + i, as the record's lines are. */
  update(flight, belief) {
    if (!belief) return;
    const length = Math.max(...["snr_db", "outage", "risk"].map((key) => belief[key]?.length ?? 0));
    const ticks = Array.from({ length }, (_, k) => belief.tick + k);
    const record = new Map(flight.record.values.map((line) => [line.tick, line]));
    const happened = {
      snr_db: (line) => finite(line?.snr_db),
      outage: (line) => (line ? Number(Boolean(line.outage)) : null),
      risk: (line) => finite(line?.p_coll),
    };
    for (const [key, chart] of Object.entries(this.charts)) {
      const predicted = ticks.map((_, k) => finite(belief[key]?.[k]));
      chart.set([ticks, ticks.map((tick) => happened[key](record.get(tick))), predicted]);
    }
  }
}
