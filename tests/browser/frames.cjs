// How many frames a second the page draws with 8 vehicles at speed 20. Prints; promises nothing.
// Usage: frames.cjs FLIGHT.html
"use strict";
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { browse, check, run } = require("./page.cjs");

const VEHICLES = 8;
const SECONDS = 1.8;

run(async () => {
  const folder = fs.mkdtempSync(path.join(os.tmpdir(), "crpl-frames-"));
  const many = path.join(folder, "many.html");
  fs.writeFileSync(many, multiplied(fs.readFileSync(process.argv[2], "utf8")));
  try {
    await browse(async (open) => {
      const page = await open(pathToFileURL(many).href);
      await page.waitForFunction((count) => window.__watch?.store.flights.size === count, VEHICLES);
      const measured = await page.evaluate(async (seconds) => {
        const { playback, store } = window.__watch;
        const frame = () => new Promise((done) => requestAnimationFrame(done));
        playback.seek(0, store.head);
        playback.speed = 20;
        for (let k = 0; k < 10; k += 1) await frame();
        playback.tick = 0;
        playback.playing = true;
        const [from, began] = [window.__watch.frames, performance.now()];
        while (performance.now() - began < 1000 * seconds) await frame();
        const elapsed = (performance.now() - began) / 1000;
        return { rate: (window.__watch.frames - from) / elapsed, ticks: playback.tick };
      }, SECONDS);
      check(measured.ticks > 0, "the flight did not play");
      console.log(`${measured.rate.toFixed(1)} frames a second, ${VEHICLES} vehicles, speed 20, ` +
        `${measured.ticks.toFixed(0)} intervals played`);
    });
  } finally {
    fs.rmSync(folder, { recursive: true, force: true });
  }
});

/** The same page with the flight of its first vehicle flown by eight, each a little elsewhere. */
function multiplied(html) {
  const begin = html.indexOf(">", html.indexOf('id="flight"')) + 1;
  const end = html.indexOf("</script>", begin);
  const lines = html.slice(begin, end).trim().split("\n").map((line) => JSON.parse(line));
  const hello = lines.find((line) => line.kind === "hello");
  const ids = Array.from({ length: VEHICLES }, (_, k) => k + 1);
  const first = hello.vehicles[0];
  const all = [{ ...hello, vehicles: ids.map((id) => ({ ...first, id })) }];
  for (const line of lines) {
    if (line.kind === "hello") continue;
    if (line.vehicle === undefined) all.push(line);
    else if (line.vehicle === first.id) ids.forEach((id) => all.push(moved(line, id)));
  }
  const text = all.map((line) => JSON.stringify(line)).join("\n").replaceAll("<", "\\u003c");
  return `${html.slice(0, begin)}\n${text}\n${html.slice(end)}`;
}

function moved(line, id) {
  const by = ([x, y]) => [x, y + 0.012 * (id - 1)];
  const copy = { ...line, vehicle: id };
  for (const key of ["r", "r_next"]) if (copy[key]) copy[key] = by(copy[key]);
  return copy;
}
