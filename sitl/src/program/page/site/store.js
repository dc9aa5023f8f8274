"use strict";
// What the feed has told so far, by vehicle and interval. Knows no screen and no clock.

/** Values that hold from their interval on until the next: beliefs, fields, pictures. */
class Timeline {
  constructor() {
    this.ticks = [];
    this.values = [];
  }

  put(tick, value) {
    let at = this.ticks.length;
    while (at > 0 && this.ticks[at - 1] >= tick) at -= 1;
    const same = this.ticks[at] === tick;
    this.ticks.splice(at, same ? 1 : 0, tick);
    this.values.splice(at, same ? 1 : 0, value);
  }

  /** The index of the value that holds at `tick`, or -1. */
  index(tick) {
    let low = 0;
    let high = this.ticks.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.ticks[middle] <= tick) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  at(tick) {
    return this.values[this.index(tick)];
  }

  get length() {
    return this.ticks.length;
  }

  get last() {
    return this.values[this.values.length - 1];
  }
}

/** One vehicle's flight: the record's lines, and what the station believed, received and sent. */
class Flight {
  constructor(id) {
    this.id = id;
    this.name = `vehicle ${id}`;
    this.controller = "";
    this.record = new Timeline();
    this.beliefs = new Timeline();
    this.fields = new Timeline();
    this.pictures = new Timeline();
    this.commands = new Timeline();
    this.links = new Timeline();
  }

  /** The last interval that is known, or -1. */
  get head() {
    const { ticks } = this.record;
    return ticks.length > 0 ? ticks[ticks.length - 1] : -1;
  }
}

/** All that the feed has told. `version` grows with each line, `seen` counts lines by kind. */
class Store {
  constructor() {
    this.clear();
  }

  clear() {
    this.version = 0;
    this.seen = {};
    this.unknown = 0;
    this.hello = null;
    this.flights = new Map();
    this.log = [];
    this.progress = null;
    this.curves = new Map();
    this.points = [];
    this.geo = null;
    this.buildings = [];
    this.end = null;
    this.extent = [Infinity, Infinity, -Infinity, -Infinity];
  }

  /** Widens what a local map has to show: west, south, east, north. */
  include(point) {
    if (!Array.isArray(point) || !point.every(Number.isFinite)) return;
    const [west, south, east, north] = this.extent;
    const [x, y] = point;
    this.extent = [Math.min(west, x), Math.min(south, y), Math.max(east, x), Math.max(north, y)];
  }

  /** Takes one line of the feed; a line that is no JSON, or of an unknown kind, is counted. */
  take(line) {
    if (line.trim() === "") return;
    let message = null;
    try {
      message = JSON.parse(line);
    } catch {
      this.unknown += 1;
      return;
    }
    if (!Object.hasOwn(Store.kinds, message?.kind)) {
      this.unknown += 1;
      return;
    }
    Store.kinds[message.kind](this, message);
    this.seen[message.kind] = (this.seen[message.kind] ?? 0) + 1;
    this.version += 1;
  }

  flight(id = 1) {
    let flight = this.flights.get(id);
    if (!flight) {
      flight = new Flight(id);
      this.flights.set(id, flight);
      this.flights = new Map([...this.flights].sort((a, b) => a[0] - b[0]));
    }
    return flight;
  }

  /** The last interval of any vehicle, or 0. */
  get head() {
    return Math.max(0, ...[...this.flights.values()].map((flight) => flight.head));
  }

  /** Intervals to draw: the plan's, or what was flown if that is more. */
  get span() {
    return Math.max(this.hello?.ticks ?? 0, this.head + 1, 1);
  }

  get intervalSeconds() {
    return this.hello?.dt_s > 0 ? this.hello.dt_s : 0.4;
  }

  get local() {
    return this.hello?.frame === "local";
  }

  get scenario() {
    return this.hello?.scenario ?? {};
  }

  get limits() {
    const limits = { delta: 0.05, gamma_min_db: 0, eta: 0.05, ...this.hello?.limits };
    const { b_dt: bits, packet_bits: packet } = this.scenario.radio ?? {};
    if (limits.rate_snr_db === undefined && bits > 0 && packet > 0) {
      limits.rate_snr_db = 10 * Math.log10(2 ** (packet / bits) - 1);
    }
    return limits;
  }

  /** The transmit powers, lowest first. */
  get powers() {
    return this.limits.power_levels ?? [1, 4];
  }
}

Store.kinds = {
  hello(store, hello) {
    store.hello = hello;
    for (const told of hello.vehicles ?? []) {
      const flight = store.flight(told.id);
      flight.name = told.name ?? flight.name;
      flight.controller = told.controller ?? "";
    }
  },
  field: (store, m) => store.flight(m.vehicle).fields.put(m.tick, m),
  tick(store, m) {
    store.flight(m.vehicle).record.put(m.tick, m);
    store.include(m.r);
  },
  belief: (store, m) => store.flight(m.vehicle).beliefs.put(m.tick, m),
  picture: (store, m) => store.flight(m.vehicle).pictures.put(m.tick, m),
  command: (store, m) => store.flight(m.vehicle).commands.put(m.tick, m),
  link: (store, m) => store.flight(m.vehicle).links.put(m.tick, m),
  log(store, m) {
    store.log.push(m);
    if (store.log.length > 2000) store.log.splice(0, 1000);
  },
  progress(store, m) {
    store.progress = m;
  },
  curve(store, m) {
    if (!store.curves.has(m.name)) store.curves.set(m.name, new Timeline());
    store.curves.get(m.name).put(m.x, m.y);
  },
  point: (store, m) => store.points.push(m),
  geo(store, m) {
    store.geo = m;
    const unit = store.local ? 1 : (store.scenario.scale?.metres_per_unit ?? 1);
    const polygons = m.buildings ? polygonsOf(m.buildings, m) : [];
    store.buildings = polygons.map((rings) => rings.map((ring) => ring.map(([x, y]) => [x / unit, y / unit])));
  },
  end(store, m) {
    store.end = m;
  },
};

/** A follower that is more intervals behind than this jumps to the head. */
const FAR_BEHIND = 600;

/** Playback: where in the flight the page stands, in intervals. Knows no screen. */
class Playback {
  constructor() {
    this.tick = 0;
    this.speed = 4;
    this.playing = false;
    this.follow = true;
  }

  /** Moves on by `seconds` of wall time. A follower is the faster the more intervals it is behind the head, up to
      20 times real time: it stands one interval behind a flight at real time, and a flight that was over at once
      can be watched. Far behind, it jumps. */
  advance(seconds, head, intervalSeconds) {
    const intervals = seconds / intervalSeconds;
    if (this.follow) {
      const behind = head - this.tick;
      if (behind < 0 || behind > FAR_BEHIND) this.tick = Math.max(0, head - 1);
      this.tick = Math.min(head, this.tick + intervals * Math.max(0.5, Math.min(20, behind)));
    } else if (this.playing) {
      this.tick = Math.min(head, this.tick + intervals * this.speed);
      if (this.tick >= head) this.playing = false;
    }
  }

  seek(tick, head) {
    this.follow = false;
    this.tick = Math.max(0, Math.min(head, tick));
  }
}
Playback.speeds = [0.25, 0.5, 1, 2, 4, 8, 20];
