// The npm package: packed from the committed files alone, imported with its types, bundled, and shown.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { copyFileSync, cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { launch } from "./browser.mjs";
import { twoSquares } from "./fixture.mjs";
import { serve } from "./server.mjs";

const WEB = dirname(dirname(fileURLToPath(import.meta.url)));
const folder = mkdtempSync(join(tmpdir(), "lumistack-package-"));
const user = join(folder, "user");
const run = (cwd, ...args) => execFileSync(args[0], args.slice(1), { cwd, encoding: "utf8", stdio: ["ignore", "pipe", "inherit"], shell: process.platform === "win32" });
before(() => {
  // A clone has only committed files: neither pkg/ nor node_modules/.
  const clone = join(folder, "clone");
  for (const path of run(WEB, "git", "ls-files").trim().split("\n")) {
    mkdirSync(dirname(join(clone, path)), { recursive: true });
    copyFileSync(join(WEB, path), join(clone, path));
  }
  const [{ filename }] = JSON.parse(run(clone, "npm", "pack", "--json", "--silent"));
  mkdirSync(join(user, "node_modules/lumistack-viewer"), { recursive: true });
  run(clone, "tar", "-xzf", filename, "--strip-components=1", "-C", join(user, "node_modules/lumistack-viewer"));
  writeFileSync(join(user, "package.json"), '{"type": "module"}');
});
after(() => rmSync(folder, { recursive: true }));

test("the types accept valid code and reject an invalid mode", () => {
  const check = (name, text) => {
    writeFileSync(join(user, name), text);
    const options = ["--noEmit", "--strict", "--target", "es2022", "--module", "esnext", "--moduleResolution", "bundler", "--lib", "es2023,dom"];
    return () => run(user, process.execPath, join(WEB, "node_modules/typescript/bin/tsc"), ...options, name);
  };
  check("good.ts", `import { LumistackViewer, type Mode, type Slope } from "lumistack-viewer";
    const viewer: LumistackViewer = document.querySelector("lumistack-viewer")!;
    const mode: Mode = "compare";
    viewer.mode = mode;
    const slope: Slope = viewer.slope;
    export const picture: Promise<ImageData> = viewer.ready.then(() => viewer.pixels());
    export { slope };`)();
  assert.throws(check("bad.ts", `import type { LumistackViewer } from "lumistack-viewer"; export const f = (v: LumistackViewer): void => { v.mode = "sideways"; };`), (error) => /not assignable/.test(error.stdout));
});

test("a bundled page shows a preview", async () => {
  writeFileSync(join(user, "main.js"), `import "lumistack-viewer"; document.title = "imported";`);
  await build({ entryPoints: [join(user, "main.js")], outfile: join(user, "site/main.js"), bundle: true, format: "esm", absWorkingDir: user, logLevel: "silent" });
  cpSync(join(user, "node_modules/lumistack-viewer/dist/lumistack_web_bg.wasm"), join(user, "site/lumistack_web_bg.wasm"));
  writeFileSync(join(user, "site/index.html"), `<!doctype html><script type="module" src="main.js"></script><lumistack-viewer src="stack/preview.json" plain style="height: 300px"></lumistack-viewer>`);
  for (const [path, bytes] of twoSquares()) {
    mkdirSync(dirname(join(user, "site", path)), { recursive: true });
    writeFileSync(join(user, "site", path), bytes);
  }
  const [server, browser] = [await serve({ "/": join(user, "site") }), await launch()];
  try {
    const page = await browser.newPage();
    await page.goto(server.url);
    const colours = await page.evaluate(async () => {
      await customElements.whenDefined("lumistack-viewer");
      const viewer = document.querySelector("lumistack-viewer");
      await viewer.complete;
      const { data } = await viewer.pixels();
      return new Set(data).size;
    });
    assert.ok(colours > 1);
    assert.equal(await page.title(), "imported");
  } finally {
    await browser.close();
    await server.close();
  }
});

test("the package contains all exported files and no sources", () => {
  const { exports, types } = JSON.parse(readFileSync(join(user, "node_modules/lumistack-viewer/package.json"), "utf8"));
  for (const path of [types, exports["."].types, exports["."].default, exports["./lumistack_web_bg.wasm"]]) {
    assert.ok(readFileSync(join(user, "node_modules/lumistack-viewer", path)).length > 0, path);
  }
  const all = run(join(user, "node_modules/lumistack-viewer"), "find", ".", "-name", "*.ts", "-not", "-name", "*.d.ts").trim();
  assert.equal(all, "");
});
