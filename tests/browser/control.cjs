// A vehicle is steered from the page: nothing is sent without a confirmation, and the answer is shown.
// Usage: control.cjs ADDRESS, with the token that the program printed behind `#token=`
"use strict";
const { browse, check, run, same } = require("./page.cjs");

const [address] = process.argv.slice(2);

run(async () => {
  await browse(async (open) => {
    const page = await open(address);
    const sent = [];
    page.on("request", (request) => {
      if (request.method() === "POST") sent.push(request.postDataJSON().action);
    });
    await page.locator("#control").waitFor();
    await page.locator('[data-action="hold"]').click();
    await page.getByRole("button", { name: "Cancel" }).click();
    same(sent, [], "sent after a cancel");
    for (const action of ["hold", "give_back"]) {
      await page.locator(`[data-action="${action}"]`).click();
      check(!(await page.locator("#token").isVisible()), "the page asks for a token that it has");
      await page.locator("#confirm button.primary").click();
      await page.waitForFunction(() => /acknowledged|refused/.test(document.querySelector("#answer").textContent));
      console.log(await page.locator("#answer").textContent());
      check(/acknowledged/.test(await page.locator("#answer").textContent()), `${action} is refused`);
      await page.waitForFunction(() => document.querySelector("#answer").textContent === "");
    }
    same(sent, ["hold", "give_back"], "sent");
    await wrongToken(open);
  });
});

async function wrongToken(open) {
  const page = await open(address.split("#")[0]);
  await page.locator("#control").waitFor();
  await page.locator('[data-action="land"]').click();
  await page.locator("#token").fill("0".repeat(32));
  await page.locator("#confirm button.primary").click();
  await page.waitForFunction(() => /refused/.test(document.querySelector("#answer").textContent));
  console.log(await page.locator("#answer").textContent());
}
