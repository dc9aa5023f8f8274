// Pictures of a flight, one every few intervals, of which tests/animate makes the animation in README.
// Usage: animation.cjs ADDRESS FOLDER STRIDE LAST [light|dark]
"use strict";
const fs = require("node:fs");
const path = require("node:path");
const { browse, goTo, nextFrames, run } = require("./page.cjs");

const [address, folder, stride, last, theme = "light"] = process.argv.slice(2);
/** What is shown: the field, the strips and what the model believes. */
const SIZE = { width: 1240, height: 640 };

run(async () => {
  fs.mkdirSync(folder, { recursive: true });
  await browse(async (open) => {
    const page = await open(address, { still: true, dark: theme === "dark", ...SIZE });
    await page.waitForFunction(() => window.__watch?.store.end);
    const head = await page.evaluate(() => window.__watch.store.head);
    let count = 0;
    for (let tick = 0; tick <= Math.min(head, Number(last)); tick += Number(stride)) {
      await goTo(page, tick);
      // The panels beside the field follow some times a second.
      await page.waitForFunction((at) => document.querySelector("#clock").textContent.startsWith(`${at} /`), tick);
      await page.waitForTimeout(250);
      await nextFrames(page, 2);
      await page.screenshot({ path: path.join(folder, `${String(count).padStart(4, "0")}.png`) });
      count += 1;
    }
    console.log(`${count} pictures in ${folder}`);
  });
});
