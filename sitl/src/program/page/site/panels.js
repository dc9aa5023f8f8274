"use strict";
// Tables, numbers, the received picture and the log of the selected vehicle.

const FATES = {
  delivered: ["\u25cf", "delivered"],
  delayed: ["\u25d0", "delayed"],
  superseded: ["\u25cb", "superseded"],
  lost: ["\u2715", "lost"],
};
const LEDGER_ROWS = 50;
const LONG_TEXT = 20;

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** A number of so many significant places that it fits its box; a dash for what is not known. */
function shown(value, digits = 3) {
  if (value === null || value === undefined) return "\u2013";
  if (typeof value !== "number") return String(value);
  if (!Number.isFinite(value)) return "\u2013";
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size !== 0 && (size < 0.001 || size >= 1e6) ? value.toExponential(1) : value.toFixed(digits);
}

/** Fills a <dl> with pairs; reuses its nodes, so that nothing flickers and a reader keeps its place. */
function fillList(list, pairs) {
  while (list.children.length > pairs.length) list.lastChild.remove();
  while (list.children.length < pairs.length) {
    const row = element("div");
    row.append(element("dt"), element("dd"));
    list.append(row);
  }
  pairs.forEach(([name, value], k) => {
    const [term, data] = list.children[k].children;
    if (term.textContent !== name) term.textContent = name;
    if (data.textContent !== value) data.textContent = value;
  });
}

/** Pairs of a name, which may be broken behind an underscore, and a shown value; what lies one level deeper carries both
    names. Long texts are left out. */
function flat(name, value, depth = 0) {
  if (typeof value === "string" && value.length > LONG_TEXT) return [];
  if (value === null || typeof value !== "object") return [[name.replaceAll("_", "_\u200b"), shown(value, 4)]];
  if (Array.isArray(value) || depth > 0) return [];
  return Object.entries(value).flatMap(([key, inner]) => flat(`${name} ${key}`, inner, depth + 1));
}

function commandRow(command) {
  const row = element("tr", undefined, `fate-${command.fate}`);
  const [sign, word] = FATES[command.fate] ?? ["?", String(command.fate ?? "on its way")];
  const wish = (command.wish ?? []).map((value) => (value >= 0 ? "+" : "\u2212") + Math.abs(value).toFixed(1));
  row.append(
    element("td", String(command.tick)),
    element("td", wish.join(" ")),
    element("td", shown(command.power)),
    element("td", `${sign} ${word}`),
    element("td", command.arrived === undefined || command.arrived === null ? "\u2013" : String(command.arrived)),
  );
  return row;
}

class Panels {
  constructor(root, store) {
    this.root = root;
    this.store = store;
    this.find = (selector) => root.querySelector(selector);
    this.logged = 0;
  }

  clear() {
    this.logged = 0;
    this.pictureKey = "";
    this.ledgerKey = "";
    this.ledgerLast = undefined;
    this.find("#log-lines").replaceChildren();
  }

  update(flight, tick) {
    this.readout(flight, tick);
    this.belief(flight, tick);
    this.ledger(flight, tick);
    this.link(flight, tick);
    this.log();
    this.summary(flight);
  }

  readout(flight, tick) {
    const line = flight?.record.at(tick);
    const at = flight ? flight.record.index(tick) : -1;
    const flown = flight ? flight.record.values.slice(0, at + 1) : [];
    const metres = this.store.local ? 1 : this.store.scenario.scale?.metres_per_unit;
    const unit = (value) => (this.store.local ? `${shown(value, 1)} m` : shown(value));
    const speed = line?.v ? Math.hypot(...line.v) : null;
    const perSecond = this.store.local ? 1 : metres / this.store.intervalSeconds;
    // What a vehicle never tells has no row.
    const tells = (key) => flown.some((one) => one[key] !== undefined && one[key] !== null);
    const known = ([, value, key]) => !line || ((key === undefined || tells(key)) && !value.startsWith("\u2013"));
    fillList(this.find("#readout"), [
      ["interval", line ? String(line.tick) : "\u2013"],
      ["time", line ? `${(line.tick * this.store.intervalSeconds).toFixed(1)} s` : "\u2013"],
      ["position", line?.r ? `${unit(line.r[0])}, ${unit(line.r[1])}` : "\u2013"],
      ["speed", speed === null || !metres ? shown(speed) : `${(speed * perSecond).toFixed(1)} m/s`],
      ["SNR", line ? `${shown(line.snr_db, 1)} dB` : "\u2013"],
      ["risk", line ? shown(line.p_coll, 4) : "\u2013"],
      ["power", line ? shown(line.power) : "\u2013"],
      ["altitude", `${shown(line?.altitude_m, 1)} m`],
      ["energy sent", shown(flown.reduce((sum, one) => sum + (one.power ?? 0), 0)), "power"],
      ["outages", `${flown.filter((one) => one.outage).length} of ${flown.length}`, "outage"],
      ["collisions", String(flown.filter((one) => one.collided).length), "collided"],
    ].filter(known));
    for (const [name, text] of Object.entries({
      snr: line ? `${shown(line.snr_db, 1)} dB` : "",
      risk: line ? shown(line.p_coll, 4) : "",
      power: line ? shown(line.power) : "",
      rate: line ? shown(line.rate, 2) : "",
    })) {
      this.find(`[data-value="${name}"]`).textContent = text;
    }
  }

  belief(flight, tick) {
    const belief = flight?.beliefs.at(tick);
    this.find("#belief").classList.toggle("absent", !flight || flight.beliefs.length === 0);
    // A vehicle that no station of ours flies has no model to show.
    this.find("#belief").hidden = this.store.local && (!flight || flight.beliefs.length + flight.pictures.length === 0);
    this.find(".seen").hidden = !flight || flight.pictures.length === 0;
    this.find("#belief").classList.toggle("no-outlook", !(belief?.snr_db?.length > 0));
    const line = belief && flight.record.at(belief.tick);
    const off = belief?.position && line?.tick === belief.tick && line.r
      ? Math.hypot(belief.position[0] - line.r[0], belief.position[1] - line.r[1])
      : null;
    const pair = (values, digits) => (values ? values.map((value) => shown(value, digits)).join(", ") : "\u2013");
    fillList(this.find("#belief-values"), [
      ["position", pair(belief?.position, 3)],
      ["\u03c3", pair(belief?.sigma, 4)],
      ["off the truth", off === null ? "\u2013" : shown(off, 4)],
      ["UAV in picture", belief ? (belief.lost ? "lost" : "found") : "\u2013"],
    ]);
    this.picture(flight, tick);
    return belief;
  }

  /** Turns the picture by `angle`, degrees clockwise, inside the box that it has. */
  turnPicture(angle) {
    const [cos, sin] = [Math.cos, Math.sin].map((of) => Math.abs(of((angle * Math.PI) / 180)));
    this.find("#picture").style.rotate = `${angle}deg`;
    this.find("#picture").style.scale = String(1 / (cos + sin));
    this.pictureKey = undefined;
  }

  /** The received picture; its first row is the south, so it is turned over. */
  picture(flight, tick) {
    const picture = flight?.pictures.at(tick);
    const key = picture ? `${flight.id}:${picture.tick}` : "";
    if (key === this.pictureKey) return;
    this.pictureKey = key;
    const image = this.find("#picture");
    image.classList.toggle("none", !picture);
    if (!picture) {
      image.removeAttribute("src");
      image.alt = "No picture has been received yet.";
      return;
    }
    image.src = `data:image/png;base64,${picture.png}`;
    image.alt = `Camera picture of interval ${picture.tick}, as received, ${this.find("#picture-up").textContent}.`;
    this.find("#picture-tick").textContent = `interval ${picture.tick}`;
  }

  ledger(flight, tick) {
    this.find("#ledger").hidden = !flight || (flight.commands.length === 0 && flight.record.length > 0);
    const until = flight ? flight.commands.index(tick) : -1;
    const last = flight?.commands.values[until];
    const key = `${flight?.id}:${flight?.commands.length}`;
    if (key === this.ledgerKey && last === this.ledgerLast) return;
    const sent = flight ? flight.commands.values.slice(0, until + 1) : [];
    const counts = Object.keys(FATES).map((fate) => [fate, sent.filter((one) => one.fate === fate).length]);
    this.find("#fates").textContent = counts
      .map(([fate, count]) => `${FATES[fate][0]} ${count} ${FATES[fate][1]}`)
      .join("  ");
    // While the cursor goes on, only what is new is added.
    const body = this.find("#ledger tbody");
    const from = key === this.ledgerKey ? sent.lastIndexOf(this.ledgerLast) : -1;
    const rows = sent.slice(from + 1).slice(-LEDGER_ROWS).reverse().map(commandRow);
    if (from >= 0) body.prepend(...rows);
    else body.replaceChildren(...rows);
    while (body.children.length > LEDGER_ROWS) body.lastChild.remove();
    this.ledgerKey = key;
    this.ledgerLast = last;
  }

  /** Counters of the link, as they stood last, which at the end is after the last interval; of a link that was counted
      once, as it was counted. */
  link(flight, tick) {
    const counted = flight?.links.at(tick >= flight.head ? Infinity : tick) ?? flight?.links.values[0];
    this.find("#link").hidden = !counted;
    if (!counted) return;
    this.find("#link-title").textContent = `Link, interval ${counted.tick}`;
    fillList(this.find("#counters"), Object.entries(counted.counters ?? {}).flatMap(([name, value]) => flat(name, value)));
  }

  log() {
    const { log } = this.store;
    this.find("#log").hidden = log.length === 0;
    if (this.store.seen.log === this.logged) return;
    const fresh = Math.min(log.length, (this.store.seen.log ?? 0) - this.logged);
    this.logged = this.store.seen.log ?? 0;
    const list = this.find("#log-lines");
    const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 8;
    for (const { level = "info", time_s: time, text } of log.slice(log.length - fresh)) {
      const row = element("li", undefined, `level-${String(level).toLowerCase()}`);
      row.append(element("span", Number.isFinite(time) ? `${time.toFixed(1)} s` : "", "time"),
        element("span", String(level).toLowerCase(), "level"), element("span", text));
      list.append(row);
    }
    while (list.children.length > 500) list.firstChild.remove();
    if (atEnd) list.scrollTop = list.scrollHeight;
  }

  /** The selected vehicle's metrics, where the feed tells each one's, and how far a computation is. */
  summary(flight) {
    const { end, progress } = this.store;
    const { flights, ...whole } = end?.summary ?? {};
    const values = Object.entries(flights?.[flight?.id] ?? whole).flatMap(([name, value]) => flat(name, value));
    this.find("#summary").hidden = values.length === 0;
    fillList(this.find("#summary-values"), values);
    this.find("#progress").hidden = !progress;
    if (progress) {
      const bar = this.find("#progress progress");
      bar.max = progress.total || 1;
      bar.value = progress.done;
      const share = progress.total > 0 ? `${progress.done} of ${progress.total}` : String(progress.done);
      this.find("#progress-text").textContent = `${share}  ${progress.text ?? ""}`;
    }
  }
}
