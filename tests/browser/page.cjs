// What the browser's scripts share: one Chromium, its pages, and what is known of the page under test.
"use strict";
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { chromium } = require("playwright-core");

const PROGRAMS = ["chromium", "chromium-browser", "google-chrome-stable", "google-chrome"];
const FLAGS = [
  "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync", "--force-color-profile=srgb",
];
/** As long as the tests' own patience, nearly: reached only by a failure. */
const PATIENCE_MS = 240_000;

function program() {
  if (process.env.CHROMIUM) return process.env.CHROMIUM;
  const folders = (process.env.PATH ?? "").split(path.delimiter);
  const places = PROGRAMS.flatMap((name) => folders.map((folder) => path.join(folder, name)));
  const found = places.find((place) => fs.existsSync(place));
  if (!found) throw new Error("no Chromium: apt-get install chromium, or name one in CHROMIUM");
  return found;
}

/** Runs `work(open)` in a Chromium with a new and empty profile; `open(address, options)` opens a page in it.
    An error in a page, or a request to another place than the page's own, fails the run. */
async function browse(work) {
  const profile = fs.mkdtempSync(path.join(os.tmpdir(), "crpl-browser-"));
  const faults = [];
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: program(),
    args: FLAGS,
    headless: true,
    viewport: { width: 1400, height: 900 },
  });
  try {
    const open = async (address, { width = 1400, height = 900, dark = false, still = false } = {}) => {
      const page = await context.newPage();
      page.setDefaultTimeout(PATIENCE_MS);
      page.on("pageerror", (error) => faults.push(`${address}: ${error.message}`));
      page.on("request", (request) => {
        const url = request.url();
        const own = url.startsWith("data:") || new URL(url).origin === new URL(address).origin;
        if (!own) faults.push(`${address} asks for ${url}`);
      });
      await page.setViewportSize({ width, height });
      await page.emulateMedia({
        colorScheme: dark ? "dark" : "light",
        reducedMotion: still ? "reduce" : "no-preference",
      });
      await page.goto(address);
      return page;
    };
    await work(open);
  } finally {
    await context.close();
    fs.rmSync(profile, { recursive: true, force: true });
  }
  check(faults.length === 0, faults.join("\n"));
}

function check(holds, what) {
  if (!holds) throw new Error(what);
}

function same(found, wanted, what) {
  const [a, b] = [JSON.stringify(found), JSON.stringify(wanted)];
  check(a === b, `${what}: ${a}, not ${b}`);
}

/** Waits until the page has read the feed's last line, and played it. */
async function watched(page) {
  await page.waitForFunction(() => window.__watch?.store.end && !window.__watch.playback.playing
    && window.__watch.playback.tick >= window.__watch.store.head);
}

/** What the page shows now. */
function standing(page) {
  return page.evaluate(() => ({
    tick: Math.floor(window.__watch.playback.tick),
    head: window.__watch.store.head,
    clock: document.querySelector("#clock").textContent,
    state: document.querySelector("#state").textContent,
    selected: window.__watch.page.selected,
  }));
}

/** Puts the cursor at an interval and waits until it is drawn. */
async function goTo(page, tick, vehicle) {
  await page.evaluate(([to, id]) => {
    window.__watch.playback.playing = false;
    window.__watch.playback.seek(to, window.__watch.store.head);
    if (id) window.__watch.page.selected = id;
    window.__watch.page.drawn = "";
  }, [tick, vehicle]);
  await nextFrames(page);
}

async function nextFrames(page, count = 3) {
  const from = await page.evaluate(() => window.__watch.frames);
  await page.waitForFunction((until) => window.__watch.frames >= until, from + count);
}

function run(work) {
  work().catch((error) => {
    console.error(error.stack ?? error);
    process.exitCode = 1;
  });
}

module.exports = { browse, check, goTo, nextFrames, run, same, standing, watched };
