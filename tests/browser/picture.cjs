// A picture of the page at an interval, as README shows it.
// Usage: picture.cjs ADDRESS OUT.png TICK [VEHICLE [light|dark]]
"use strict";
const fs = require("node:fs");
const { browse, goTo, nextFrames, run } = require("./page.cjs");

const [address, out, tick, vehicle = "1", theme = "light"] = process.argv.slice(2);

run(async () => {
  await browse(async (open) => {
    const page = await open(address, { still: true, dark: theme === "dark", height: 860 });
    await page.waitForFunction(() => window.__watch?.store.end);
    await goTo(page, Number(tick), Number(vehicle));
    await page.waitForFunction((at) => document.querySelector("#ledger tbody td")?.textContent === at, tick);
    await nextFrames(page, 30);
    await page.screenshot({ path: out });
    console.log(`${out}: ${fs.statSync(out).size} bytes`);
  });
});
