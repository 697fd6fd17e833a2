// Times of the simulator's page in headless Chromium: `node web.mjs FOLDER`, a site with references.json beside it.
//
// First picture: from the start of the navigation until the element says that it is ready. Frame time: one picture drawn at the
// page's size and one pixel of it read back, which waits for the graphics processor; here that is a software one.
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join, normalize } from "node:path";

const folder = process.argv[2];
const root = join(import.meta.dirname, "../../web");
const { chromium } = createRequire(join(root, "package.json"))("playwright-core");
const KINDS = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".png": "image/png", ".wasm": "application/wasm" };
const ROUNDS = 7;
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

for (const renderer of ["webgl2", "cpu"]) {
  const first = [];
  let page;
  for (let round = 0; round < ROUNDS; round++) {
    await page?.context().close();
    page = await (await browser.newContext({ viewport: { width: 1440, height: 900 }, reducedMotion: "reduce" })).newPage();
    await page.goto(address + (renderer === "cpu" ? "?renderer=cpu" : ""));
    first.push(await page.evaluate(async () => {
      await customElements.whenDefined("lumistack-viewer");
      await document.querySelector("lumistack-viewer").ready;
      return performance.now();
    }));
  }
  const frames = await page.evaluate(async (count) => {
    const viewer = document.querySelector("lumistack-viewer");
    await viewer.complete;
    const canvas = viewer.shadowRoot.querySelector("#picture canvas:not([hidden])");
    const gl = viewer.path === "webgl2" ? canvas.getContext("webgl2") : undefined;
    const finish = () => (gl ? gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)) : canvas.getContext("2d").getImageData(0, 0, 1, 1));
    const times = [];
    for (let i = 0; i < count; i++) {
      const start = performance.now();
      viewer.slope = [0.12 * Math.sin(i), 0.12 * Math.cos(i)];
      finish();
      times.push(performance.now() - start);
    }
    return { path: viewer.path, times };
  }, FRAMES);
  const name = frames.path === "cpu" ? "CPU path" : "WebGL2";
  console.log(`${name}: first picture ${median(first).toFixed(0)} ms (median of ${ROUNDS}, slowest ${Math.max(...first).toFixed(0)}), frame ${median(frames.times).toFixed(1)} ms (median of ${FRAMES})`);
  await page.context().close();
}
await browser.close();
server.close();
