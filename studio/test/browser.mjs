// Drives the page in Chromium against a server that runs: node test/browser.mjs ADDRESS-TO-EDIT [FOLDER FOR PICTURES].
// CHROMIUM names the program, by default /usr/bin/chromium. The server's scenario must have a controller, as snowflake has.

import assert from "node:assert/strict";
import { join } from "node:path";
import { chromium } from "playwright-core";

const [address, folder] = process.argv.slice(2);
assert.ok(address?.includes("#"), "give the address that `luxloop studio` prints, with its token");
const LONG = { timeout: 120_000 };

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
const troubles = [];
page.on("pageerror", (error) => troubles.push(`error: ${error.message}`));
page.on("console", (message) => message.type() === "error" && troubles.push(`console: ${message.text()}`));
page.on("request", (request) => {
  const url = new URL(request.url());
  if (url.host !== new URL(address).host && !["data:", "blob:"].includes(url.protocol)) troubles.push(`request to ${url.host}`);
});

const until = (condition, argument) => page.waitForFunction(condition, argument, LONG);
const picture = (name) => folder && page.screenshot({ path: join(folder, `${name}.png`) });
const done = (what) => console.log(`ok: ${what}`);

await page.goto(address);
await until(() => window.luxloop?.store.state.runs[0]?.shown);
done("the first step is shown");

await page.click("[aria-label='Start anew']");
await until(() => window.luxloop.store.state.runs[0]?.newest === 0);
for (const step of [1, 2, 3]) {
  await page.click("[aria-label='One step']");
  await until((n) => window.luxloop.store.state.runs[0].rows.count > n && window.luxloop.store.state.runs[0].newest === n, step);
}
assert.match(await page.textContent(".counter"), /^step 3 of \d+, \d+\.\d\d s$/);
done("single steps");

await page.locator(".scrub").focus();
await page.keyboard.press("ArrowLeft");
await until(() => window.luxloop.store.state.runs[0].shown.scrub && window.luxloop.store.state.runs[0].shown.step === 2);
await page.click("text=live");
await until(() => !window.luxloop.store.state.runs[0].shown.scrub);
done("an old step, and the newest again");

for (const frame of ["off", "signed", "on"]) await page.selectOption("[aria-label='Frame of the camera']", frame);
const box = await page.locator(".camera canvas").boundingBox();
await page.mouse.move(box.x + box.width / 2, box.y + 0.7 * box.height);
await until(() => /^u \d+, v \d+: \d+ of \d+$/.test(document.querySelector(".camera .readout").textContent));
done("the camera's digital number below the cursor");

await page.click(".compare .chooser-button");
await page.keyboard.press("ArrowDown");
await page.keyboard.press("Enter");
await until(() => window.luxloop.store.state.runs.length === 2 && window.luxloop.store.state.runs.every(({ shown }) => shown));
assert.equal(await page.evaluate(() => window.luxloop.scenes.length), 2);
await picture("compared");
done("a second run beside the first");

await page.click(".compare .chooser-button");
await page.keyboard.press("Enter");
await until(() => window.luxloop.store.state.runs.length === 1);
await page.fill(".keys", "camera.bitz=10");
await page.press(".keys", "Enter");
await page.waitForSelector(".toast >> text=bitz", LONG);
done("a wrong key is a sentence");

assert.deepEqual(troubles, []);
await browser.close();
