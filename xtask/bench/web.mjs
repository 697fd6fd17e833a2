// Measures the simulator's page in headless Chromium: `node web.mjs FOLDER`. The folder contains the site and references.json.
//
// Prints when the poster is painted, when the user can look around ("interactive"), and when the
// first picture of the patterns is shown. These times are measured from the start of the
// navigation. "longest task" is the longest task of the page's main thread, until two seconds after
// all files have arrived. The time of a frame includes drawing and reading back the picture in the
// simulator's thread. In this browser WebGL2 draws in software.
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join, normalize } from "node:path";

const folder = process.argv[2];
const root = join(import.meta.dirname, "../../web");
const { chromium } = createRequire(join(root, "package.json"))("playwright-core");
const KINDS = { ".jpg": "image/jpeg", ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".png": "image/png", ".wasm": "application/wasm" };
const ROUNDS = 5;
const FRAMES = 40;

const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(new URL(request.url, "http://localhost").pathname));
  const file = join(folder, path.endsWith("/") ? `${path}index.html` : path);
  if (path.includes("..") || !existsSync(file) || !statSync(file).isFile()) return response.writeHead(404).end();
  response.writeHead(200, { "content-type": KINDS[extname(file)] ?? "application/octet-stream", "cache-control": "no-store" });
  createReadStream(file).pipe(response);
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const address = `http://127.0.0.1:${server.address().port}/`;
const browser = await chromium.launch({
  executablePath: process.env.LUMISTACK_CHROMIUM ?? "/usr/bin/chromium",
  headless: true,
  args: ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"],
});
const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];

/** The emulated networks: one without limits, and a mobile connection. */
const PROFILES = [["no limits", undefined], ["10 Mbit/s, 60 ms", { offline: false, latency: 60, downloadThroughput: 10e6 / 8, uploadThroughput: 5e6 / 8 }]];

for (const [profile, limits] of PROFILES) {
  const rounds = [];
  for (let round = 0; round < ROUNDS; round++) {
    const context = await browser.newContext({ viewport: { width: 1440, height: 900 } });
    const page = await context.newPage();
    let bytes = 0;
    const network = await context.newCDPSession(page);
    await network.send("Network.enable");
    network.on("Network.loadingFinished", ({ encodedDataLength }) => (bytes += encodedDataLength));
    if (limits) await network.send("Network.emulateNetworkConditions", limits);
    await page.addInitScript(() => {
      window.long = 0;
      new PerformanceObserver((list) => list.getEntries().forEach(({ duration }) => (window.long = Math.max(window.long, duration)))).observe({ type: "longtask", buffered: true });
      new PerformanceObserver((list) => list.getEntries().forEach((entry) => entry.element?.slot === "poster" && (window.painted ??= entry.startTime))).observe({ type: "largest-contentful-paint", buffered: true });
    });
    await page.goto(address, { waitUntil: "commit" });
    await page.waitForFunction(() => performance.getEntriesByName("lumistack-interactive").length > 0);
    const early = bytes;
    rounds.push({
      early,
      ...(await page.evaluate(async () => {
        const viewer = document.querySelector("lumistack-viewer");
        await viewer.complete;
        await new Promise((resolve) => setTimeout(resolve, 2000));
        const at = (name) => performance.getEntriesByName(`lumistack-${name}`)[0]?.startTime;
        return { painted: window.painted ?? at("poster"), interactive: at("interactive"), whole: at("first-picture"), long: window.long };
      })),
      bytes,
    });
    await context.close();
  }
  const of = (key) => median(rounds.map((round) => round[key]));
  console.log(
    `${profile}: poster ${of("painted").toFixed(0)} ms, interactive ${of("interactive").toFixed(0)} ms after ${(of("early") / 1000).toFixed(0)} kB, picture ${of("whole").toFixed(0)} ms, longest task ${of("long").toFixed(0)} ms (medians of ${ROUNDS})`,
  );
}

for (const renderer of ["webgl2", "cpu"]) {
  const page = await (await browser.newContext({ viewport: { width: 1440, height: 900 }, reducedMotion: "reduce" })).newPage();
  await page.goto(`${address}?renderer=${renderer}`);
  const times = await page.evaluate(async (count) => {
    const viewer = document.querySelector("lumistack-viewer");
    await viewer.complete;
    const times = [];
    for (let i = 0; i < count; i++) {
      viewer.slope = [0.12 * Math.sin(i), 0.12 * Math.cos(i)];
      const start = performance.now();
      await viewer.pixels();
      times.push(performance.now() - start);
    }
    return times;
  }, renderer === "cpu" ? FRAMES : 4);
  console.log(`${renderer === "cpu" ? "CPU path" : "WebGL2"}: frame ${median(times).toFixed(1)} ms (median of ${times.length})`);
  await page.context().close();
}
await browser.close();
server.close();
