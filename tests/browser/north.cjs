// A field whose up is not north is drawn north up, and by a key as it lies in its own axes.
// Usage: north.cjs FLIGHT.html OUT
"use strict";
const fs = require("node:fs");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { PNG } = require("pngjs");
const pixelmatch = require("pixelmatch");
const { browse, check, goTo, nextFrames, run, same } = require("./page.cjs");

const [flight, out] = process.argv.slice(2);
const TICK = 40;
/** Share of the pixels that may differ: edges of lines, and what stands upright (marks, scale, arrow). */
const TOLERANCE = 0.03;

run(async () => {
  await browse(async (open) => {
    const straight = await shown(open, 0);
    check(!(await straight.locator("#north").isVisible()), "there is something to turn where up is north");
    const axes = await field(straight, "axes");
    const page = await shown(open, 90);
    same(await turn(page), ["90deg", "north up"], "the picture");
    const north = await field(page, "north");
    alike(north, clockwise(axes), "a field whose up is east, turned");
    check(difference(north, axes) > 3 * TOLERANCE, "the comparison does not tell a turned field from another");
    await page.keyboard.press("n");
    await nextFrames(page);
    same(await turn(page), ["0deg", "up as in the field"], "the picture after the key");
    alike(await field(page, "back"), axes, "the field in its own axes");
    // Every width and theme, to be looked at.
    for (const [width, height, dark] of [[360, 740, false], [360, 740, true], [1600, 900, false], [1600, 900, true]]) {
      const one = await shown(open, 30, { width, height, dark });
      const name = `north-${width}-${dark ? "dark" : "light"}.png`;
      await one.screenshot({ path: path.join(out, name), fullPage: width < 720 });
      const wide = await one.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      check(wide <= 0, `${width} px: the page is ${wide} px wider than the window`);
      await one.close();
    }
  });
});

/** The flight's page, with a field whose up is `heading` degrees from north. */
async function shown(open, heading, options = {}) {
  const html = fs.readFileSync(flight, "utf8");
  const geo = JSON.stringify({ kind: "geo", origin: [47.3977, 8.5456], heading });
  const copy = path.join(out, `heading-${heading}.html`);
  fs.writeFileSync(copy, html.replace(/(id="flight">)/, `$1\n${geo}`));
  const page = await open(pathToFileURL(copy).href, { still: true, width: 1000, height: 900, ...options });
  await page.waitForFunction(() => window.__watch?.store.end);
  await goTo(page, TICK);
  await page.waitForFunction((at) => document.querySelector("#picture").alt.includes(`interval ${at},`), TICK);
  return page;
}

/** How the camera's picture is turned, and what is said of it. */
async function turn(page) {
  await page.waitForFunction(() => document.querySelector("#picture").alt
    .includes(document.querySelector("#picture-up").textContent));
  return page.evaluate(() => [
    getComputedStyle(document.querySelector("#picture")).rotate.replace("none", "0deg"),
    document.querySelector("#picture-up").textContent,
  ]);
}

async function field(page, name) {
  await page.locator('[data-show="names"]').uncheck();
  await nextFrames(page);
  await page.evaluate(() => document.activeElement.blur());
  const picture = await page.locator("#field").screenshot();
  fs.writeFileSync(path.join(out, `${name}.png`), picture);
  return PNG.sync.read(picture);
}

/** The picture turned by a quarter. */
function clockwise(picture) {
  const { width, height, data } = picture;
  const made = new PNG({ width: height, height: width });
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) {
      data.copy(made.data, 4 * (x * height + height - 1 - y), 4 * (y * width + x), 4 * (y * width + x) + 4);
    }
  }
  return made;
}

function alike(found, wanted, what) {
  const share = difference(found, wanted);
  console.log(`${what}: ${(100 * share).toFixed(2)} % of the pixels differ`);
  check(share <= TOLERANCE, `${what}: another picture, see ${out}`);
}

/** Share of the pixels that differ, of the square that both pictures have. */
function difference(one, other) {
  const size = Math.min(one.width, one.height, other.width, other.height);
  const [a, b] = [one, other].map((picture) => {
    const cut = new PNG({ width: size, height: size });
    PNG.bitblt(picture, cut, 0, 0, size, size, 0, 0);
    return cut.data;
  });
  return pixelmatch(a, b, null, size, size, { threshold: 0.15 }) / (size * size);
}
