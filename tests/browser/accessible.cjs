// axe-core finds no serious fault: light and dark, wide and narrow, with the help open.
// Usage: accessible.cjs FLIGHT.html
"use strict";
const fs = require("node:fs");
const { pathToFileURL } = require("node:url");
const { browse, check, goTo, run } = require("./page.cjs");

const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const CASES = [
  { name: "light", options: {} },
  { name: "dark", options: { dark: true } },
  { name: "360 px wide", options: { width: 360, height: 740 } },
  { name: "4K", options: { width: 3840, height: 2160, dark: true } },
  { name: "help", options: {}, key: "?" },
];

run(async () => {
  await browse(async (open) => {
    for (const { name, options, key } of CASES) {
      const page = await open(pathToFileURL(process.argv[2]).href, { ...options, still: true });
      await page.waitForFunction(() => window.__watch?.store.end);
      await goTo(page, 40);
      await page.waitForFunction(() => document.querySelector("#ledger tbody tr"));
      if (key) await page.keyboard.press(key);
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      check(wide <= 0, `${name}: the page is ${wide} px wider than the window`);
      await page.evaluate(axe);
      const { violations, passes } = await page.evaluate(() => window.axe.run());
      const found = violations.map((fault) =>
        `${fault.impact}: ${fault.id}: ${fault.nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
      console.log(`${name}: ${passes.length} rules hold, ${violations.length} do not`);
      found.forEach((line) => console.log(`  ${line}`));
      check(!violations.some((fault) => ["serious", "critical"].includes(fault.impact)), found.join("\n"));
      await page.close();
    }
  });
});
