// A server of files on the loopback address for the tests.
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".png": "image/png", ".wasm": "application/wasm" };

/**
 * Serves files. `roots` maps URL prefixes to folders; the longest prefix of a path is used.
 * `hook(path, response, request)` returns true if it has answered the request itself.
 */
export async function serve(roots, hook = () => false) {
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    if (hook(path, response, request)) return;
    const prefix = Object.keys(roots)
      .filter((root) => path.startsWith(root))
      .sort((a, b) => b.length - a.length)[0];
    const inside = prefix === undefined ? "" : normalize(path.slice(prefix.length));
    const file = prefix === undefined || inside.startsWith("..") ? "" : join(roots[prefix], inside.endsWith("/") || inside === "" || inside === "." ? `${inside}/index.html` : inside);
    if (!file || !existsSync(file) || !statSync(file).isFile()) {
      response.writeHead(404, { "content-type": "text/plain" }).end("not found");
      return;
    }
    response.writeHead(200, { "content-type": TYPES[extname(file)] ?? "application/octet-stream", "cache-control": "no-store" });
    createReadStream(file).pipe(response);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  // Pages of a failed test may still be open, so do not wait for their connections.
  const close = () =>
    new Promise((resolve) => {
      server.close(resolve);
      server.closeAllConnections();
    });
  return { url: `http://127.0.0.1:${server.address().port}`, close };
}
