// Saves a picture of a page: node shot.mjs CHROMIUM ADDRESS WIDTH HEIGHT FILE. Needs the npm
// packages of web/. Chromium's option --screenshot does not wait for the workers of a page, but
// puppeteer does.

import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [chromium, address, width, height, file] = process.argv.slice(2);
const require = createRequire(new URL("../../web/package.json", import.meta.url));
const { default: puppeteer } = await import(pathToFileURL(require.resolve("puppeteer-core")).href);
const browser = await puppeteer.launch({ executablePath: chromium, args: ["--no-sandbox", "--hide-scrollbars"] });
const page = await browser.newPage();
await page.setViewport({ width: Number(width), height: Number(height) });
await page.goto(address, { waitUntil: "networkidle0" });
// a viewer is complete when it has drawn a picture with every file
await page.evaluate(async () => {
  const viewer = document.querySelector("lumistack-viewer");
  if (viewer) await viewer.complete;
});
await new Promise((resolve) => setTimeout(resolve, 2500));
await page.screenshot({ path: file });
await browser.close();
