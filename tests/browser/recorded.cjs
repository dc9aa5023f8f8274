// flight.html by file://: played to its end, and its field compared with pictures that were looked at.
// Usage: recorded.cjs FLIGHT.html GOLDEN OUT; with CRPL_BLESS=1 the golden pictures are made anew.
"use strict";
const fs = require("node:fs");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { PNG } = require("pngjs");
const pixelmatch = require("pixelmatch");
const { browse, check, goTo, run, same, standing, watched } = require("./page.cjs");

const [flight, golden, out] = process.argv.slice(2);
/** Share of the pixels that may differ, edges of lines. Names are left out: each machine has its own font. */
const TOLERANCE = 0.003;
const PICTURES = [["light", 12, false], ["light", 40, false], ["dark", 12, true]];

run(async () => {
  await browse(async (open) => {
    const page = await open(pathToFileURL(flight).href);
    await page.keyboard.press("+");
    await page.keyboard.press("+");
    await page.waitForFunction(() => window.__watch.playback.playing);
    await watched(page);
    same((await standing(page)).state, "ended", "state");
    await unknownLines(page);
    const still = await open(pathToFileURL(flight).href, { still: true });
    await watched(still);
    const shots = {};
    for (const [theme, tick, dark] of PICTURES) {
      const name = `${theme}-${tick}.png`;
      shots[name] = await field(open, tick, dark);
      fs.writeFileSync(path.join(out, name), shots[name]);
      if (process.env.CRPL_BLESS) fs.writeFileSync(path.join(golden, name), shots[name]);
    }
    for (const name of Object.keys(shots)) {
      const share = difference(shots[name], fs.readFileSync(path.join(golden, name)));
      console.log(`${name}: ${(100 * share).toFixed(2)} % of the pixels differ`);
      check(share <= TOLERANCE, `${name} is another picture: see ${path.join(out, name)}`);
    }
    // The tolerance is no blindfold: another interval is another picture.
    const moved = difference(shots["light-12.png"], shots["light-40.png"]);
    console.log(`another interval: ${(100 * moved).toFixed(2)} % of the pixels differ`);
    check(moved > TOLERANCE, "the comparison does not tell two intervals apart");
  });
});

/** Lines of a later version, and junk, are counted and change nothing. */
async function unknownLines(page) {
  const [before, unknown, after] = await page.evaluate(() => {
    const { store } = window.__watch;
    const before = store.version;
    for (const line of ["{", "null", "[]", '{"kind":"toString"}', '{"kind":"later","tick":1}', ""]) store.take(line);
    return [before, store.unknown, store.version];
  });
  same([unknown, after], [5, before], "unknown lines");
}

async function field(open, tick, dark) {
  const page = await open(pathToFileURL(flight).href, { dark, still: true, width: 1000, height: 900 });
  await page.waitForFunction(() => window.__watch?.store.end);
  await page.locator('[data-show="names"]').uncheck();
  await goTo(page, tick);
  const picture = await page.locator("#field").screenshot();
  await page.close();
  return picture;
}

/** Share of the pixels that differ; all, where the sizes do. */
function difference(one, other) {
  const [a, b] = [PNG.sync.read(one), PNG.sync.read(other)];
  if (a.width !== b.width || a.height !== b.height) return 1;
  return pixelmatch(a.data, b.data, null, a.width, a.height, { threshold: 0.15 }) / (a.width * a.height);
}
