// A server of files for the benchmarks of the page, with an emulated connection, and browsers.
import { existsSync, readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join, normalize } from "node:path";

const ROOT = join(import.meta.dirname, "../..");
/** Returns a package of `web/node_modules`. */
export const needed = createRequire(join(ROOT, "web/package.json"));
const KINDS = { ".jpg": "image/jpeg", ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".png": "image/png", ".wasm": "application/wasm" };
const ARGUMENTS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];
/** Bytes that the emulated connection sends at once. */
const PIECE = 4096;
const later = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/**
* Serves a folder. `state.connection` is {bytesPerS, latencyMs}: all responses together have this
* rate, and each begins after the latency. Without a connection the server sends at once.
* `state.bytes` counts the sent bytes of files; the server compresses nothing.
*/
export async function serve(folder) {
  const state = { connection: undefined, bytes: 0 };
  let free = 0;
  const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://localhost").pathname));
    const file = join(folder, path.endsWith("/") ? `${path}index.html` : path);
    if (path.includes("..") || !existsSync(file) || !statSync(file).isFile()) return response.writeHead(404).end();
    const { connection } = state;
    const bytes = readFileSync(file);
    if (connection) await later(connection.latencyMs);
    response.writeHead(200, { "content-type": KINDS[extname(file)] ?? "application/octet-stream", "content-length": bytes.length, "cache-control": "no-store" });
    for (let at = 0; at < bytes.length && !response.destroyed; at += connection ? PIECE : bytes.length) {
      const piece = connection ? bytes.subarray(at, at + PIECE) : bytes;
      if (connection) {
        // The pieces of all responses take turns on the connection.
        free = Math.max(free, performance.now()) + (1000 * piece.length) / connection.bytesPerS;
        if (free > performance.now() + 1) await later(free - performance.now());
      }
      state.bytes += piece.length;
      response.write(piece);
    }
    response.end();
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { state, url: `http://127.0.0.1:${server.address().port}/`, close: () => server.close() };
}

export function chromium() {
  const executablePath = process.env.LUMISTACK_CHROMIUM ?? "/usr/bin/chromium";
  return needed("playwright-core").chromium.launch({ executablePath, headless: true, args: ARGUMENTS });
}

/** Starts Firefox; returns undefined if there is none. */
export async function firefox() {
  const executablePath = [process.env.LUMISTACK_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"].find((path) => path && existsSync(path));
  if (!executablePath) return undefined;
  const { default: puppeteer } = await import(needed.resolve("puppeteer-core"));
  return puppeteer.launch({ browser: "firefox", executablePath, headless: true, args: ["--width=1440", "--height=900"] });
}

/** Returns the middle one of some values. */
export const median = (values) => values.toSorted((a, b) => a - b)[values.length >> 1];
