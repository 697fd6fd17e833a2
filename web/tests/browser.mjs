// Helpers of the tests: the browser, the server, and the state of a page.
import { existsSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { serve } from "./server.mjs";

const WEB = dirname(dirname(fileURLToPath(import.meta.url)));
export const DIST = join(WEB, "dist");
/** Folder of the screenshots, which no test reads. */
export const SHOTS = process.env.LUMISTACK_WEB_SHOTS ?? join(WEB, "shots");

const ARGUMENTS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

/** Starts Chromium; `more` are further arguments of its command line. */
export async function launch(more = []) {
  const path = process.env.LUMISTACK_CHROMIUM ?? "/usr/bin/chromium";
  if (!existsSync(path)) throw new Error(`no browser at ${path}: install Chromium (Debian: apt-get install chromium) or name one in LUMISTACK_CHROMIUM`);
  return chromium.launch({ executablePath: path, headless: true, args: [...ARGUMENTS, ...more] });
}

/** Serves the built page with a preview. The preview is a folder, or files in memory (path → bytes), which a test may exchange. */
export async function site(preview) {
  const memory = preview instanceof Map ? preview : undefined;
  const state = { files: memory, hook: undefined };
  const roots = { "/app/": DIST, "/": DIST };
  if (!memory) roots["/stack/"] = join(preview, "stack");
  const server = await serve(roots, (path, response) => {
    if (state.hook?.(path, response)) return true;
    const bytes = state.files?.get(path.slice(1));
    if (!bytes) return false;
    response.writeHead(200, { "content-type": path.endsWith(".json") ? "application/json" : "image/png", "cache-control": "no-store" }).end(bytes);
    return true;
  });
  return { ...server, state };
}

/**
 * Opens a page. `page.trouble` collects the errors and warnings of its console. `init` is a script
 * that runs first, and `seen` is called with every request.
 */
export async function open(browser, url, options = {}) {
  const { init, seen, ...rest } = options;
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, reducedMotion: "reduce", ...rest });
  // The time limit is long, since a test machine may compile at the same time, and draws in
  // software.
  context.setDefaultTimeout(120_000);
  if (seen) context.on("request", seen);
  const page = await context.newPage();
  page.trouble = [];
  page.on("console", (message) => {
    // Ignore this warning of the driver: the tests themselves cause it when they read pixels.
    if (/GPU stall due to ReadPixels/.test(message.text())) return;
    // Ignore this message of Chromium about a missing WebGPU adapter, since the page itself reports
    // it.
    if (message.text() === "No available adapters.") return;
    if (message.type() === "error" || message.type() === "warning") page.trouble.push(message.text());
  });
  page.on("pageerror", (error) => page.trouble.push(error.message));
  if (init) await page.addInitScript(init);
  await page.goto(url);
  await page.evaluate(() => customElements.whenDefined("lumistack-viewer"));
  return page;
}

/**
 * Waits until every file has arrived or failed. Returns the message if no frame is complete,
 * otherwise undefined.
 */
export function complete(page) {
  return page.evaluate(() =>
    document.querySelector("lumistack-viewer").complete.then(
      () => undefined,
      (error) => error.message,
    ),
  );
}

/**
 * Returns the current picture as {width, height, data: Buffer of RGBA}, seen from `slope` if it is
 * given.
 */
export async function pixels(page, slope) {
  const { width, height, text } = await page.evaluate(async (at) => {
    const viewer = document.querySelector("lumistack-viewer");
    if (at) viewer.slope = at;
    const { width, height, data } = await viewer.pixels();
    let text = "";
    for (let i = 0; i < data.length; i += 8192) text += String.fromCharCode(...data.subarray(i, i + 8192));
    return { width, height, text: btoa(text) };
  }, slope);
  return { width, height, data: Buffer.from(text, "base64") };
}

/** The linear value of each sRGB code. */
export const LINEAR = Float64Array.from({ length: 256 }, (_, code) => {
  const v = code / 255;
  return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
});

/** Returns the text of a part of the element; undefined if the part is not visible. */
export function text(page, selector) {
  return page.evaluate((within) => {
    const element = document.querySelector("lumistack-viewer").shadowRoot.querySelector(within);
    return element && element.checkVisibility() ? element.textContent.trim() : undefined;
  }, selector);
}
