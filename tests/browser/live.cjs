// A running program is watched by two pages at once to its end, played again, and scrubbed.
// Usage: live.cjs ADDRESS VEHICLES
"use strict";
const zlib = require("node:zlib");
const { browse, check, nextFrames, run, same, standing, watched } = require("./page.cjs");

const [address, vehicles] = process.argv.slice(2);

run(async () => {
  const text = await (await fetch(address)).text();
  console.log(`page: ${text.length} bytes, ${zlib.gzipSync(text, { level: 9 }).length} compressed`);
  await browse(async (open) => {
    const [page, other] = await Promise.all([open(address), open(address, { dark: true, width: 800 })]);
    await Promise.all([watched(page), watched(other)]);
    for (const one of [page, other]) {
      const seen = await one.evaluate(() => [...window.__watch.store.flights.values()].map((flight) => [
        flight.record.length, flight.commands.length, flight.pictures.length > 0, flight.fields.length > 0,
      ]));
      same(seen.length, Number(vehicles), "vehicles");
      for (const [record, commands, pictures, fields] of seen) {
        same([record, commands, pictures, fields], [100, 100, true, true], "a flight's lines");
      }
      same(await one.evaluate(() => window.__watch.store.unknown), 0, "lines that the page does not know");
      same((await standing(one)).state, "ended", "state");
    }
    await keys(page);
    await scrubber(page);
    same((await standing(other)).tick, 99, "the other page's cursor");
    check(await page.locator("#ledger tbody tr").count() > 0, "the ledger is empty");
  });
  console.log("two pages watched the flight to its end");
});

async function keys(page) {
  await page.keyboard.press("Home");
  same((await standing(page)).tick, 0, "Home");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Shift+ArrowRight");
  same((await standing(page)).tick, 11, "right, and right with Shift");
  await page.keyboard.press("ArrowLeft");
  same((await standing(page)).tick, 10, "left");
  await page.keyboard.press("End");
  same((await standing(page)).tick, 99, "End");
  await page.keyboard.press("2");
  same((await standing(page)).selected, 2, "vehicle");
  await page.keyboard.press("Home");
  await page.keyboard.press("Space");
  await page.waitForFunction(() => window.__watch.playback.tick > 3);
  await page.keyboard.press("Space");
  const before = await standing(page);
  await nextFrames(page, 10);
  same(await standing(page), before, "paused");
  await page.keyboard.press("?");
  check(await page.locator("#help-dialog").isVisible(), "no help");
  await page.getByRole("button", { name: "Close" }).click();
  check(!(await page.locator("#help-dialog").isVisible()), "help stays");
}

async function scrubber(page) {
  await page.locator("#scrub").fill("42");
  await nextFrames(page);
  const now = await standing(page);
  same([now.tick, now.clock], [42, "42 / 99, 16.8 s"], "scrubbed");
  await page.locator("#theme").click();
  same(await page.evaluate(() => document.documentElement.dataset.theme), "dark", "theme");
}
