"use strict";
// Puts the page together: the feed, the clock, the keys, the theme and the control buttons.

const find = (selector) => document.querySelector(selector);
const store = new Store();
const playback = new Playback();
const field = new FieldView(find("#field"), store);
const strips = new Strips(document, store, (tick) => seek(Math.floor(tick)));
const horizon = new Horizon(document, store);
const study = new Study(find("#study"), store);
const panels = new Panels(document, store);
const page = { selected: null, theme: null, drawn: "", panelsAt: 0, stripsAt: 0, touched: false, live: false };

// ---- theme ----

const THEME_COLOURS = [
  "panel", "ink", "muted", "line", "grid", "accent", "belief", "goal", "contour", "halo", "obstacle",
  "obstacle-edge", "snr-low", "snr-high", "low", "high",
];

/** Okabe and Ito's colours, told apart by all kinds of sight; each goes with a mark of its own. */
const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#b39b00"];

const systemDark = matchMedia("(prefers-color-scheme: dark)");

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  const style = getComputedStyle(document.documentElement);
  const camel = (text) => text.replace(/-(.)/g, (_, letter) => letter.toUpperCase());
  const theme = { name, palette: PALETTE };
  for (const key of THEME_COLOURS) theme[camel(key)] = style.getPropertyValue(`--${key}`).trim();
  const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  theme.snrLowRgb = rgb(theme.snrLow);
  theme.snrHighRgb = rgb(theme.snrHigh);
  page.theme = theme;
  rebuild();
}

/** Everything whose size or colour is fixed when it is made. */
function rebuild() {
  if (!page.theme) return;
  field.resize();
  for (const charts of [strips, horizon, study]) charts.build(page.theme);
  strips.moveMark(playback.tick);
  page.drawn = "";
}

// ---- the feed ----

const RETRY_MS = 1500;

/** Opens the feed. After a break it is read again from the beginning: the program may be another one. */
function listen() {
  page.live = true;
  const source = new EventSource("/events");
  let opened = false;
  source.onopen = () => {
    if (!opened && store.version > 0) clearAll();
    opened = true;
    page.broken = false;
    showState();
  };
  source.onmessage = (event) => {
    store.take(event.data);
    if (store.end) source.close();
  };
  source.onerror = () => {
    source.close();
    page.broken = true;
    showState();
    setTimeout(listen, RETRY_MS);
  };
}

function readInside(script) {
  for (const line of script.textContent.split("\n")) store.take(line);
  page.closed = true;
}

function clearAll() {
  store.clear();
  panels.clear();
  study.clear();
  page.broken = false;
  page.ended = false;
  page.drawn = "";
}

// ---- the clock ----

function seek(tick) {
  page.touched = true;
  playback.seek(tick, store.head);
}

function togglePlay() {
  page.touched = true;
  const running = playback.playing || playback.follow;
  playback.follow = false;
  playback.playing = !running;
  if (playback.playing && playback.tick >= store.head) playback.tick = 0;
  showTransport();
}

function setFollow(on) {
  page.touched = true;
  playback.follow = on;
  playback.playing = false;
  showTransport();
}

function setSpeed(speed) {
  playback.speed = speed;
  find("#speed").value = String(speed);
}

/** Who has touched nothing sees the flight from where it is, to its end, at a speed that can be watched. */
function onEnd() {
  page.ended = true;
  if (page.touched) return;
  playback.follow = false;
  playback.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!playback.playing) playback.tick = store.head;
  showTransport();
}

function showTransport() {
  const running = playback.playing || playback.follow;
  const button = find("#play");
  button.textContent = running ? "\u275a\u275a" : "\u25b6\ufe0e";
  button.setAttribute("aria-label", running ? "Pause" : "Play");
  find("#follow").setAttribute("aria-pressed", String(playback.follow));
}

function showClock() {
  const scrub = find("#scrub");
  const tick = Math.floor(playback.tick);
  scrub.max = store.head;
  scrub.value = tick;
  const text = `${tick} / ${store.head}, ${(tick * store.intervalSeconds).toFixed(1)} s`;
  if (find("#clock").textContent !== text) {
    find("#clock").textContent = text;
    scrub.setAttribute("aria-valuetext", `interval ${text}`);
  }
}

// ---- what is shown ----

function showState() {
  const state = find("#state");
  const [name, text] = (() => {
    if (store.end) return ["ended", String(store.end.reason ?? "")];
    if (page.broken) return ["broken", "connection lost, trying again"];
    if (!page.live) return ["recorded", ""];
    return store.version > 0 ? ["live", ""] : ["waiting", "for the first interval"];
  })();
  state.textContent = name;
  state.className = `state ${name}`;
  find("#state-text").textContent = text;
}

function showHello() {
  const { hello, scenario } = store;
  const seed = hello?.seed === undefined || hello.seed === null ? "" : `, seed ${hello.seed}`;
  find("#title").textContent = hello?.title ?? "CRPL";
  find("#title").title = [scenario.name, hello?.revision].filter(Boolean).join(", ") + seed;
  document.title = hello?.title ?? "CRPL";
  find("#field-title").textContent = store.local ? "Map" : "Field";
  find("#north").hidden = !store.geo?.heading;
  turnPicture();
  find("#control").hidden = !(hello?.control && page.live);
  find("#rate-title").textContent = hello?.rate_unit ? `Rate, ${hello.rate_unit}` : "Rate";
  showScale();
  showVehicles();
}

/** The picture stands as the field does. */
function turnPicture() {
  find("#picture-up").textContent = field.angle === (store.geo?.heading ?? 0) ? "north up" : "up as in the field";
  panels.turnPicture(field.angle);
}

function showScale() {
  const { gamma_min_db: gamma, rate_snr_db: rate } = store.limits;
  const middle = rate ?? 0;
  const [low, high] = [middle - SNR_REACH_DB, middle + SNR_REACH_DB];
  const place = (value) => `${Math.max(0, Math.min(100, (100 * (value - low)) / (high - low)))}%`;
  find('.bar [data-level="gamma"]').style.left = place(gamma);
  find('.bar [data-level="rate"]').style.left = place(middle);
  find('.bar [data-level="rate"]').hidden = rate === undefined;
  const marks = find(".marks").children;
  [`\u2264 ${low.toFixed(1)}`, `${middle.toFixed(1)}`, `\u2265 ${high.toFixed(1)}`].forEach((text, k) => {
    marks[k].textContent = text;
  });
}

function showVehicles() {
  const flights = [...store.flights.values()];
  if (!store.flights.has(page.selected)) page.selected = flights[0]?.id ?? null;
  const group = find("#vehicles");
  group.hidden = flights.length < 2;
  while (group.children.length > flights.length) group.lastChild.remove();
  flights.forEach((flight, k) => {
    const button = group.children[k] ?? group.appendChild(document.createElement("button"));
    button.type = "button";
    button.textContent = flight.name === String(flight.id) ? `Vehicle ${flight.id}` : `${flight.id} ${flight.name}`;
    button.setAttribute("aria-pressed", String(flight.id === page.selected));
    button.onclick = () => select(flight.id);
  });
}

function select(id) {
  if (!store.flights.has(id)) return;
  page.selected = id;
  page.drawn = "";
  page.stripsAt = -1;
  showVehicles();
}

function describeField(flight) {
  const line = flight?.record.at(playback.tick);
  if (!line?.r) return "The field, before the first interval.";
  const place = line.r.map((value) => value.toFixed(2)).join(", ");
  return `The field at interval ${line.tick}: ${flight.name} at ${place}, transmit power ${line.power}, SNR ` +
    `${line.snr_db?.toFixed?.(1) ?? "unknown"} dB${line.outage ? ", outage" : ""}.`;
}

/** The slower parts of the page, some times a second. */
function showPanels(now) {
  const flight = store.flights.get(page.selected);
  if (page.helloAt !== store.seen.hello || page.geoAt !== store.seen.geo || page.flights !== store.flights.size) {
    page.helloAt = store.seen.hello;
    page.geoAt = store.seen.geo;
    page.flights = store.flights.size;
    showHello();
  }
  panels.update(flight, playback.tick);
  if (flight) horizon.update(flight, flight.beliefs.at(playback.tick));
  const changed = `${page.selected}:${flight?.record.length}:${flight?.head}`;
  if (page.stripsAt !== changed) {
    page.stripsAt = changed;
    strips.update(flight);
    find("#strips").hidden = !strips.any;
  }
  const studied = (store.seen.point ?? 0) + (store.seen.curve ?? 0);
  const isStudy = studied > 0 || Boolean(store.progress) || /sweep|train/.test(store.hello?.program ?? "");
  find("#study").hidden = !isStudy;
  document.body.classList.toggle("study-only", isStudy && store.flights.size === 0);
  if (studied > 0 && page.studied !== studied) {
    page.studied = studied;
    study.update();
  }
  const shadow = flight?.fields.at(playback.tick);
  find("#snr-scale").hidden = !shadow;
  find(".legend").hidden = store.local && !shadow;
  const { gamma_min_db: gamma, rate_snr_db: rate } = store.limits;
  const dashed = rate === undefined ? "" : `, dashed: rate met from ${rate.toFixed(1)}`;
  find("#snr-scale-title").textContent =
    `SNR at power ${shadow?.power ?? store.powers[0]}, dB; solid: \u03b3 min ${gamma.toFixed(1)}${dashed}`;
  find("#field").setAttribute("aria-label", describeField(flight));
  showState();
  page.panelsAt = now;
}

// ---- the loop ----

const PANELS_EVERY_MS = 200;
const frames = [];
window.__watch = { store, playback, page, field, frames: 0 };
window.__fps = 0;

let before = performance.now();
function frame(now) {
  requestAnimationFrame(frame);
  const seconds = Math.max(0, Math.min(0.25, (now - before) / 1000));
  before = now;
  if ((store.end || page.closed) && !page.ended) onEnd();
  const wasRunning = playback.playing;
  playback.advance(seconds, store.head, store.intervalSeconds);
  if (wasRunning !== playback.playing) showTransport();
  const state = `${playback.tick}|${store.version}|${page.selected}`;
  if (state !== page.drawn) {
    page.drawn = state;
    if (!store.flights.has(page.selected)) showVehicles();
    field.draw(playback.tick, page.selected, page.theme);
    strips.moveMark(playback.tick);
    showClock();
    page.stale = true;
  }
  if (page.stale && now - page.panelsAt >= PANELS_EVERY_MS) {
    page.stale = false;
    showPanels(now);
  }
  window.__watch.frames += 1;
  frames.push(now);
  while (frames[0] < now - 1000) frames.shift();
  window.__fps = frames.length;
}

// ---- hands ----

function step(by) {
  playback.playing = false;
  seek(Math.floor(playback.tick) + by);
  showTransport();
}

const KEYS = {
  " ": () => togglePlay(),
  ArrowLeft: (event) => step(event.shiftKey ? -10 : -1),
  ArrowRight: (event) => step(event.shiftKey ? 10 : 1),
  Home: () => step(-Infinity),
  End: () => step(Infinity),
  "+": () => nextSpeed(1),
  "=": () => nextSpeed(1),
  "-": () => nextSpeed(-1),
  f: () => setFollow(!playback.follow),
  n: () => find("#north:not([hidden])")?.click(),
  t: () => find("#theme").click(),
  "?": () => find("#help").click(),
};

function nextSpeed(by) {
  const at = Playback.speeds.indexOf(playback.speed) + by;
  setSpeed(Playback.speeds[Math.max(0, Math.min(Playback.speeds.length - 1, at))]);
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const target = event.target;
  // Fields keep their own keys; so does what scrolls, and space presses the button that has the focus.
  if (target.matches("select, input:not(#scrub)")) return;
  if (target.matches(".scroll") && /^(Arrow|Home|End| )/.test(event.key)) return;
  if (event.key === " " && target.matches("button, a")) return;
  const vehicle = /^[1-8]$/.test(event.key) ? [...store.flights.keys()][Number(event.key) - 1] : undefined;
  if (vehicle !== undefined) select(vehicle);
  else if (Object.hasOwn(KEYS, event.key)) KEYS[event.key](event);
  else return;
  event.preventDefault();
});

find("#play").onclick = togglePlay;
find("#back").onclick = () => step(-1);
find("#on").onclick = () => step(1);
find("#follow").onclick = () => setFollow(!playback.follow);
find("#scrub").oninput = (event) => {
  seek(Number(event.target.value));
  showTransport();
};
for (const speed of Playback.speeds) find("#speed").append(new Option(`${speed}\u00d7`, String(speed)));
find("#speed").onchange = (event) => setSpeed(Number(event.target.value));
find("#theme").onclick = () => setTheme(page.theme.name === "dark" ? "light" : "dark");
find("#help").onclick = () => find("#help-dialog").showModal();
for (const box of document.querySelectorAll("[data-show]")) {
  box.onchange = () => {
    field.show[box.dataset.show] = box.checked;
    turnPicture();
    page.drawn = "";
  };
}

// ---- control ----

const ACTIONS = {
  hold: ["Hold", "stops and holds its place"],
  return: ["Return", "flies back to where it started"],
  land: ["Land", "lands where it is"],
  give_back: ["Give back", "is given back to the controller"],
};

function tokenOfAddress() {
  return new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
}

function ask(action) {
  const flight = store.flights.get(page.selected);
  const [name, effect] = ACTIONS[action];
  const dialog = find("#confirm");
  find("#confirm-title").textContent = `${name}?`;
  find("#confirm-text").textContent = `Vehicle ${page.selected}, ${flight?.name ?? ""}: ${effect}.`;
  find("#token").value ||= tokenOfAddress();
  find("#token-row").hidden = tokenOfAddress() !== "";
  dialog.returnValue = "cancel";
  dialog.onclose = () => {
    if (dialog.returnValue === "send") send(action, page.selected, find("#token").value);
  };
  dialog.showModal();
}

async function send(action, vehicle, token) {
  const answer = find("#answer");
  answer.className = "";
  answer.textContent = `${ACTIONS[action][0]}: sent, waiting for the vehicle`;
  let told = { ok: false, text: "no answer" };
  try {
    const response = await fetch("/control", {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify({ token, vehicle, action }),
    });
    const text = await response.text();
    try {
      told = JSON.parse(text);
    } catch {
      told = { ok: response.ok, text: text || response.statusText };
    }
  } catch (error) {
    told.text = String(error);
  }
  answer.classList.toggle("refused", !told.ok);
  answer.textContent = `${ACTIONS[action][0]}: ${told.ok ? "acknowledged" : "refused"}${told.text ? `, ${told.text}` : ""}`;
  setTimeout(() => {
    answer.textContent = "";
  }, 8000);
}

for (const button of document.querySelectorAll("[data-action]")) button.onclick = () => ask(button.dataset.action);

// ---- start ----

setSpeed(playback.speed);
systemDark.addEventListener("change", () => setTheme(systemDark.matches ? "dark" : "light"));
setTheme(systemDark.matches ? "dark" : "light");
let resizing = 0;
new ResizeObserver(() => {
  clearTimeout(resizing);
  resizing = setTimeout(rebuild, 60);
}).observe(find("main"));
const inside = document.querySelector("script#flight");
if (inside) readInside(inside);
else listen();
showTransport();
showState();
requestAnimationFrame(frame);
