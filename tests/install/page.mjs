// Serves FOLDER, which has the npm package and patterns. Opens a page with the viewer in Chromium,
// and checks that the picture is not uniform. Usage: page.mjs FOLDER

import { spawn } from "node:child_process";
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";

const folder = process.argv[2];
const LONGEST_MS = 120_000;
const TYPES = { ".js": "text/javascript", ".json": "application/json", ".wasm": "application/wasm", ".png": "image/png", ".jpg": "image/jpeg" };

const PAGE = `<!doctype html>
<script type="module" src="node_modules/lumistack-viewer/dist/viewer.js"></script>
<lumistack-viewer src="stack/preview.json" style="display: block; height: 240px"></lumistack-viewer>
<script type="module">
  const send = (message) => fetch("/result", { method: "POST", body: JSON.stringify(message) });
  try {
    const viewer = document.querySelector("lumistack-viewer");
    viewer.addEventListener("lumistack-error", ({ detail }) => send({ error: detail.message }));
    await customElements.whenDefined("lumistack-viewer");
    await viewer.complete;
    const picture = await viewer.pixels();
    await send({ width: picture.width, height: picture.height, data: [...picture.data] });
  } catch (error) {
    await send({ error: String(error) });
  }
</script>`;

function ends(code, message) {
    console.log(message);
    browser?.kill("SIGKILL");
    process.exit(code);
}

function judge({ error, width, height, data }) {
    if (error) ends(1, `the page reports: ${error}`);
    const lit = data.filter((_, place) => place % 4 !== 3);
    const mean = lit.reduce((sum, value) => sum + value, 0) / lit.length;
    const deviation = Math.sqrt(lit.reduce((sum, value) => sum + (value - mean) ** 2, 0) / lit.length);
    const said = `the page shows ${width} × ${height} pixels, mean ${mean.toFixed(1)}, deviation ${deviation.toFixed(1)} of 255`;
    ends(data.length === width * height * 4 && deviation > 10 ? 0 : 1, said);
}

const server = createServer(async (request, response) => {
    if (request.method === "POST") {
        const parts = [];
        for await (const part of request) parts.push(part);
        response.end();
        judge(JSON.parse(Buffer.concat(parts).toString()));
        return;
    }
    const path = normalize(new URL(request.url, "http://localhost").pathname);
    try {
        const body = path === "/" ? PAGE : await readFile(join(folder, path));
        response.writeHead(200, { "Content-Type": path === "/" ? "text/html; charset=utf-8" : (TYPES[extname(path)] ?? "application/octet-stream") });
        response.end(body);
    } catch {
        response.writeHead(404).end();
    }
});

let browser;
server.listen(0, "127.0.0.1", () => {
    const address = `http://127.0.0.1:${server.address().port}/`;
    browser = spawn("chromium", ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", address], { stdio: "ignore" });
    browser.on("error", (error) => ends(1, `chromium: ${error.message}`));
});
setTimeout(() => ends(1, `the page reported nothing in ${LONGEST_MS / 1000} s`), LONGEST_MS);
