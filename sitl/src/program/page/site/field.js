"use strict";
// The field: the shadow, what stands in it, where the vehicles flew, and what the model believes.

/** The SNR's colour scale reaches so far to both sides of the rate's threshold, dB. */
const SNR_REACH_DB = 10;

/** Points of the path that is still to come; of more, some are left out. */
const FUTURE_POINTS = 500;

class FieldView {
  constructor(canvas, store) {
    this.canvas = canvas;
    this.store = store;
    this.ground = new Layer();
    this.trails = new Layer();
    this.drawn = new Map();
    this.shadow = new Layer();
    this.show = { shadow: true, fan: true, future: true, names: true, north: true };
    this.size = [0, 0];
  }

  resize() {
    const box = this.canvas.getBoundingClientRect();
    this.ratio = Math.min(window.devicePixelRatio || 1, 3);
    this.size = [Math.round(box.width), Math.round(box.height)];
    this.canvas.width = Math.round(this.size[0] * this.ratio);
    this.canvas.height = Math.round(this.size[1] * this.ratio);
    this.rem = parseFloat(getComputedStyle(document.documentElement).fontSize);
  }

  /** By how much the field is turned so that north is up, in degrees clockwise. */
  get angle() {
    return this.show.north ? (this.store.geo?.heading ?? 0) : 0;
  }

  /** The world's bounds and the unit of length in metres (0 if there is none). */
  project() {
    const bounds = this.store.local ? localBounds(this.store) : [0, 0, 1, 1];
    const [width, height] = this.size;
    const pad = 0.7 * this.rem;
    this.map = new Projection(bounds, [pad, pad, width - 2 * pad, height - 2 * pad], this.angle);
    this.metres = this.store.local ? 1 : (this.store.scenario.scale?.metres_per_unit ?? 0);
  }

  draw(tick, selected, theme) {
    const [width, height] = this.size;
    if (width < 10 || height < 10) return;
    this.theme = theme;
    this.project();
    const flight = this.store.flights.get(selected);
    this.paintGround(flight, tick);
    this.paintTrails(tick, selected);
    const context = this.canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.ground.canvas, 0, 0);
    this.stand(context);
    if (flight) this.obstacles(context, flight, tick);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.trails.canvas, 0, 0);
    this.stand(context);
    if (flight && this.show.future) this.future(context, flight, tick);
    if (flight) this.belief(context, flight, tick);
    for (const other of this.store.flights.values()) this.vehicle(context, other, tick, other.id === selected);
  }

  /** What is drawn next lies in the field. */
  stand(context) {
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.map.turn(context);
  }

  /** Draws something at (x, y) that stands upright, however the field is turned. */
  upright(context, x, y, draw) {
    const { a, b } = context.getTransform();
    context.save();
    context.translate(x, y);
    context.rotate(-Math.atan2(b, a));
    draw();
    context.restore();
  }

  // ---- the ground: shadow, contours, grid, places ----

  paintGround(flight, tick) {
    const index = flight && this.show.shadow ? flight.fields.index(tick + 1e-6) : -1;
    const field = index >= 0 ? flight.fields.values[index] : null;
    const { store, map } = this;
    const key = [
      field ? `${flight.id}:${field.tick}:${field.power}` : "", map.bounds, map.angle, this.theme.name,
      store.seen.hello, store.seen.geo, this.rem, this.show.names,
    ].join("|");
    const context = this.ground.begin(key, ...this.size, this.ratio);
    if (!context) return;
    context.fillStyle = this.theme.panel;
    context.fillRect(0, 0, ...this.size);
    map.turn(context);
    if (!store.local) {
      context.fillStyle = field ? this.theme.panel : this.theme.snrHigh;
      context.fillRect(map.x(0), map.y(1), map.scale, map.scale);
    }
    if (field) this.paintShadow(context, field);
    this.grid(context);
    if (store.buildings.length > 0) this.buildings(context);
    this.places(context);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.scaleBar(context);
  }

  paintShadow(context, field) {
    const { n, snr_db: values } = field;
    const { map } = this;
    if (!(n > 1) || values?.length !== n * n) return;
    const image = new ImageData(n, n);
    values.forEach((value, at) => {
      const row = n - 1 - Math.floor(at / n);
      const colour = this.snrColour(value);
      image.data.set([...colour, 255], 4 * (row * n + (at % n)));
    });
    const cells = this.shadow.begin(`${field.vehicle}:${field.tick}:${this.theme.name}`, n, n, 1);
    cells?.putImageData(image, 0, 0);
    const [west, south, east, north] = map.bounds;
    const [x0, y0] = [map.x(west), map.y(north)];
    const [width, height] = [map.scale * (east - west), map.scale * (north - south)];
    context.save();
    context.beginPath();
    context.rect(x0, y0, width, height);
    context.clip();
    context.drawImage(this.shadow.canvas, x0, y0, width, height);
    const { gamma_min_db: least, rate_snr_db: rate } = this.store.limits;
    const place = (x, y) => [x0 + (width * (x + 0.5)) / n, y0 + height * (1 - (y + 0.5) / n)];
    const lines = [[rate, [6, 4], "rate", 0.7], [least, [], "\u03b3 min", 0.85]];
    context.strokeStyle = this.theme.contour;
    context.lineWidth = 1;
    for (const [level, dash, name, share] of lines) {
      if (level === undefined) continue;
      context.setLineDash(dash);
      context.beginPath();
      const segments = contour(values, n, level);
      for (const [ax, ay, bx, by] of segments) {
        context.moveTo(...place(ax, ay));
        context.lineTo(...place(bx, by));
      }
      context.stroke();
      this.contourName(context, segments, name, share * n, place);
    }
    context.restore();
  }

  /** Writes a contour's name beside its right branch, near `height` in cells. */
  contourName(context, segments, name, height, place) {
    const distance = ([x, y]) => Math.abs(y - height) - x * 1e-3;
    const [nearest] = segments.toSorted((a, b) => distance(a) - distance(b));
    if (!nearest) return;
    const [x, y] = place(nearest[0], nearest[1]);
    this.text(context, name, x, y, { by: [5, 4], colour: this.theme.contour, size: 0.75 });
  }

  /** Red, green, blue of an SNR in dB. */
  snrColour(value) {
    const middle = this.store.limits.rate_snr_db ?? 0;
    const share = Math.max(0, Math.min(1, 0.5 + (value - middle) / (2 * SNR_REACH_DB)));
    const [low, high] = [this.theme.snrLowRgb, this.theme.snrHighRgb];
    return low.map((from, k) => Math.round(from + share * (high[k] - from)));
  }

  grid(context) {
    const { map } = this;
    const [west, south, east, north] = map.bounds;
    // A field that lies on Earth has lines at whole metres, as a map.
    const unit = this.store.geo && this.metres > 0 ? this.metres : 0;
    const step = unit > 0 ? niceBelow(((east - west) * unit) / 4) / unit : 0.1;
    context.setLineDash([]);
    context.lineWidth = 1;
    context.strokeStyle = this.theme.grid;
    context.beginPath();
    const crisp = (value) => Math.round(value) + 0.5;
    for (let x = Math.ceil(west / step) * step; x <= east + 1e-9; x += step) {
      context.moveTo(crisp(map.x(x)), map.y(south));
      context.lineTo(crisp(map.x(x)), map.y(north));
    }
    for (let y = Math.ceil(south / step) * step; y <= north + 1e-9; y += step) {
      context.moveTo(map.x(west), crisp(map.y(y)));
      context.lineTo(map.x(east), crisp(map.y(y)));
    }
    context.stroke();
  }

  buildings(context) {
    const [west, south, east, north] = this.map.bounds;
    const { scale } = this.map;
    context.save();
    context.beginPath();
    context.rect(this.map.x(west), this.map.y(north), scale * (east - west), scale * (north - south));
    context.clip();
    context.fillStyle = this.theme.obstacle;
    context.strokeStyle = this.theme.obstacleEdge;
    for (const rings of this.store.buildings) {
      context.beginPath();
      for (const ring of rings) {
        ring.forEach(([x, y], k) => {
          if (k === 0) context.moveTo(this.map.x(x), this.map.y(y));
          else context.lineTo(this.map.x(x), this.map.y(y));
        });
        context.closePath();
      }
      context.fill("evenodd");
      context.stroke();
    }
    context.restore();
  }

  /** Base station, start and goal. */
  places(context) {
    const { map, theme } = this;
    const { start, goal, goal_radius: radius, channel } = this.store.scenario;
    const size = 0.5 * this.rem;
    if (goal) {
      const [x, y] = [map.x(goal[0]), map.y(goal[1])];
      context.strokeStyle = theme.goal;
      context.lineWidth = 2;
      context.beginPath();
      context.arc(x, y, Math.max(4, map.scale * (radius ?? 0)), 0, 2 * Math.PI);
      context.stroke();
      const below = Math.max(4, map.scale * (radius ?? 0)) + 1.1 * this.rem;
      this.text(context, "goal", x, y, { by: [0, below], align: "center" });
    }
    if (start) {
      const [x, y] = [map.x(start[0]), map.y(start[1])];
      context.strokeStyle = theme.ink;
      context.lineWidth = 1.5;
      this.upright(context, x, y, () => context.strokeRect(-size / 2, -size / 2, size, size));
      this.text(context, "start", x, y, { by: [0, 1.5 * this.rem], align: "center" });
    }
    const station = channel?.base_station;
    if (station) {
      const [x, y] = [map.x(station[0]), map.y(station[1])];
      context.fillStyle = theme.ink;
      this.upright(context, x, y, () => {
        context.beginPath();
        context.moveTo(0, -size);
        context.lineTo(size, 0.8 * size);
        context.lineTo(-size, 0.8 * size);
        context.fill();
      });
      this.text(context, "base station", x, y, { by: [1.6 * size, 0.8 * size] });
    }
  }

  scaleBar(context) {
    if (!(this.metres > 0)) return;
    const { map, theme, rem } = this;
    const length = niceBelow((map.bounds[2] - map.bounds[0]) * this.metres / 4);
    const pixels = (length / this.metres) * map.scale;
    const { centre, reach } = map;
    const right = centre[0] + reach[0] - 0.8 * rem;
    const y = centre[1] + reach[1] - 0.8 * rem;
    context.strokeStyle = theme.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(right - pixels, y - 4);
    context.lineTo(right - pixels, y);
    context.lineTo(right, y);
    context.lineTo(right, y - 4);
    context.stroke();
    this.text(context, length >= 1000 ? `${length / 1000} km` : `${length} m`, right - pixels / 2, y,
      { by: [0, -5], align: "center", size: 0.75 });
    const [x, top] = [centre[0] + reach[0] - 1.3 * rem, centre[1] - reach[1] + 0.9 * rem];
    context.save();
    context.translate(x, top + 0.75 * rem);
    context.rotate(((map.angle - (this.store.geo?.heading ?? 0)) * Math.PI) / 180);
    context.beginPath();
    context.moveTo(0, 0.75 * rem);
    context.lineTo(0, -0.75 * rem);
    context.moveTo(-3.5, 5 - 0.75 * rem);
    context.lineTo(0, -0.75 * rem);
    context.lineTo(3.5, 5 - 0.75 * rem);
    context.stroke();
    context.restore();
    this.text(context, "N", x, top, { by: [0, 2.5 * rem], align: "center", size: 0.75 });
  }

  /** Words at `by` pixels from (x, y), upright. */
  text(context, words, x, y, { by = [0, 0], align = "left", colour = this.theme.ink, size = 0.82, weight = 400 } = {}) {
    if (!this.show.names) return;
    this.upright(context, x, y, () => {
      context.font = `${weight} ${size * this.rem}px system-ui, sans-serif`;
      context.textAlign = align;
      context.setLineDash([]);
      context.lineWidth = 3;
      context.strokeStyle = this.theme.halo;
      context.strokeText(words, ...by);
      context.fillStyle = colour;
      context.fillText(words, ...by);
    });
  }

  // ---- what moves ----

  obstacles(context, flight, tick) {
    const { map, theme } = this;
    const line = flight.record.at(tick);
    const shapes = this.store.scenario.obstacle ?? [];
    (line?.obstacles ?? shapes.map((shape) => shape.position)).forEach(([x, y], k) => {
      const shape = shapes[k] ?? shapes[0] ?? {};
      context.beginPath();
      context.arc(map.x(x), map.y(y), map.scale * (shape.radius ?? 0.1), 0, 2 * Math.PI);
      context.fillStyle = theme.obstacle;
      context.fill();
      context.setLineDash([]);
      context.lineWidth = 1;
      context.strokeStyle = theme.obstacleEdge;
      context.stroke();
      if (shape.margin > 0) {
        context.beginPath();
        context.setLineDash([2, 4]);
        context.arc(map.x(x), map.y(y), map.scale * shape.margin, 0, 2 * Math.PI);
        context.stroke();
      }
    });
  }

  /** Adds what was flown since the last frame; paints anew when the cursor went back. */
  paintTrails(tick, selected) {
    const { flights, seen } = this.store;
    const until = Math.floor(tick) - 1;
    if ([...this.drawn].some(([id, at]) => (flights.get(id)?.record.index(until) ?? -1) < at)) this.trails.key = "";
    const key = [selected, this.map.bounds, this.map.angle, this.theme.name, seen.hello].join("|");
    const fresh = this.trails.begin(key, ...this.size, this.ratio);
    if (fresh) {
      this.map.turn(fresh);
      this.drawn.clear();
    }
    const context = fresh ?? this.trails.canvas.getContext("2d");
    const ordered = [...flights.values()].sort((a, b) => (a.id === selected) - (b.id === selected));
    for (const { id, record } of ordered) {
      const last = record.index(until);
      for (let at = (this.drawn.get(id) ?? -1) + 1; at <= last; at += 1) {
        this.step(context, record.values[at], id === selected);
      }
      this.drawn.set(id, last);
    }
  }

  /** One flown interval: its colour and width tell the power, a cross an outage, a dot each tenth. */
  step(context, line, chosen) {
    const { map, theme } = this;
    if (!line.r || !line.r_next) return;
    const high = line.power > this.store.powers[0];
    context.globalAlpha = chosen ? 1 : 0.45;
    context.strokeStyle = high ? theme.high : theme.low;
    context.lineWidth = (high ? 3.2 : 1.8) * (chosen ? 1 : 0.7);
    context.setLineDash([]);
    const [x, y] = [map.x(line.r[0]), map.y(line.r[1])];
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(map.x(line.r_next[0]), map.y(line.r_next[1]));
    context.stroke();
    if (chosen && line.tick % 10 === 0) {
      context.beginPath();
      context.arc(x, y, 3, 0, 2 * Math.PI);
      context.fillStyle = theme.panel;
      context.fill();
      context.lineWidth = 1.5;
      context.stroke();
    }
    if (line.outage) this.cross(context, x, y, chosen ? 5 : 3.5);
    context.globalAlpha = 1;
  }

  cross(context, x, y, size) {
    this.upright(context, x, y, () => {
      for (const [colour, width] of [[this.theme.halo, 4.5], [this.theme.ink, 1.8]]) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.beginPath();
        context.moveTo(-size, -size);
        context.lineTo(size, size);
        context.moveTo(-size, size);
        context.lineTo(size, -size);
        context.stroke();
      }
    });
  }

  /** What was flown after the cursor, thin and dotted. */
  future(context, flight, tick) {
    const { record } = flight;
    const first = record.index(tick);
    if (first < 0 || first + 1 >= record.length) return;
    context.beginPath();
    const stride = Math.ceil((record.length - first) / FUTURE_POINTS);
    for (let at = first; at < record.length; at += stride) {
      const { r } = record.values[at];
      if (!r) continue;
      if (at === first) context.moveTo(this.map.x(r[0]), this.map.y(r[1]));
      else context.lineTo(this.map.x(r[0]), this.map.y(r[1]));
    }
    context.setLineDash([1, 5]);
    context.lineWidth = 1.5;
    context.strokeStyle = this.theme.ink;
    context.stroke();
    context.setLineDash([]);
  }

  belief(context, flight, tick) {
    const { map, theme } = this;
    const belief = flight.beliefs.at(tick);
    if (!belief) return;
    context.strokeStyle = theme.belief;
    if (this.show.fan) this.fan(context, belief);
    const radii = (this.store.scenario.obstacle ?? []).map((shape) => shape.radius);
    (belief.obstacles ?? []).forEach(([x, y], k) => {
      context.setLineDash([5, 4]);
      context.lineWidth = 1.5;
      context.beginPath();
      context.arc(map.x(x), map.y(y), map.scale * (radii[k] ?? 0.1), 0, 2 * Math.PI);
      context.stroke();
    });
    if (!belief.position) return;
    const [x, y] = [map.x(belief.position[0]), map.y(belief.position[1])];
    const [sx, sy] = belief.sigma ?? [0, 0];
    context.setLineDash(belief.lost ? [3, 3] : []);
    context.lineWidth = 1.5;
    context.beginPath();
    context.ellipse(x, y, Math.max(2, 2 * sx * map.scale), Math.max(2, 2 * sy * map.scale), 0, 0, 2 * Math.PI);
    context.globalAlpha = 0.25;
    context.fillStyle = theme.belief;
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
    context.setLineDash([]);
  }

  /** The rollout: thin members, and the mean with a dot each tenth interval. */
  fan(context, belief) {
    const { map, theme } = this;
    const paths = belief.fan ?? [];
    paths.forEach((path, member) => {
      context.globalAlpha = member === 0 ? 1 : 0.4;
      context.lineWidth = member === 0 ? 1.8 : 1.2;
      context.setLineDash([]);
      context.beginPath();
      path.forEach(([x, y], k) => {
        if (k === 0 && belief.position) context.moveTo(map.x(belief.position[0]), map.y(belief.position[1]));
        context.lineTo(map.x(x), map.y(y));
      });
      context.stroke();
    });
    context.globalAlpha = 1;
    context.fillStyle = theme.belief;
    for (let k = 9; k < (paths[0]?.length ?? 0); k += 10) {
      context.beginPath();
      context.arc(map.x(paths[0][k][0]), map.y(paths[0][k][1]), 2.2, 0, 2 * Math.PI);
      context.fill();
    }
  }

  /** The vehicle itself, between two intervals where the cursor is, with its number. */
  vehicle(context, flight, tick, chosen) {
    const { map, theme } = this;
    const line = flight.record.at(tick);
    if (!line?.r) return;
    const share = Math.max(0, Math.min(1, tick - line.tick));
    const next = line.r_next ?? line.r;
    const [x, y] = [0, 1].map((k) => line.r[k] + share * (next[k] - line.r[k]));
    const [px, py] = [map.x(x), map.y(y)];
    const size = (chosen ? 0.5 : 0.36) * this.rem;
    context.beginPath();
    context.arc(px, py, size, 0, 2 * Math.PI);
    context.fillStyle = line.power > this.store.powers[0] ? theme.high : theme.low;
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = chosen ? theme.ink : theme.halo;
    context.stroke();
    if (line.outage) this.cross(context, px, py, size);
    if (this.store.flights.size > 1) {
      this.text(context, String(flight.id), px, py, { by: [size + 3, -size], weight: chosen ? 700 : 400 });
    }
  }
}
