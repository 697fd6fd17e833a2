// The npm package. It is packed from the files that git tracks, imported with its types, bundled,
// and shown in a browser.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { copyFileSync, cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { complete, launch, open, pixels, SHOTS } from "./browser.mjs";
import { twoSquares } from "./fixture.mjs";
import { serve } from "./server.mjs";

const WEB = dirname(dirname(fileURLToPath(import.meta.url)));
const folder = mkdtempSync(join(tmpdir(), "lumistack-package-"));
const user = join(folder, "user");
const run = (cwd, ...args) => execFileSync(args[0], args.slice(1), { cwd, encoding: "utf8", stdio: ["ignore", "pipe", "inherit"], shell: process.platform === "win32" });
before(() => {
  // Copy only the files that git tracks, as a clone does: neither pkg/ nor node_modules/.
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

test("the examples in plain HTML, React and Vue show a preview and follow their sliders", async () => {
  const [from, at] = [join(WEB, "examples"), join(user, "site")];
  for (const name of ["plain", "react", "vue"]) cpSync(join(from, `${name}.html`), join(at, `${name}.html`));
  cpSync(join(user, "node_modules/lumistack-viewer/dist"), join(at, "app"), { recursive: true });
  cpSync(join(at, "app/lumistack_web_bg.wasm"), join(at, "lumistack_web_bg.wasm"));
  const alias = { "lumistack-viewer": join(user, "node_modules/lumistack-viewer/dist/viewer.js") };
  await build({ entryPoints: { react: join(from, "react.jsx"), "vue-bundle": join(from, "vue.js") }, outdir: at, bundle: true, format: "esm", jsx: "automatic", alias, logLevel: "silent" });
  for (const [path, bytes] of twoSquares()) {
    mkdirSync(dirname(join(at, path)), { recursive: true });
    writeFileSync(join(at, path), bytes);
  }
  const [server, browser] = [await serve({ "/": at }), await launch()];
  try {
    const seen = [];
    for (const name of ["plain", "react", "vue"]) {
      const page = await open(browser, `${server.url}/${name}.html`);
      assert.equal(await page.textContent("h1"), `A layered display in ${{ plain: "plain HTML", react: "React", vue: "Vue" }[name]}`);
      await page.waitForFunction(() => document.querySelector("[role=status]").textContent === "Ready.");
      assert.equal(await complete(page), undefined);
      const middle = await pixels(page);
      await page.fill("input", "0.2");
      assert.deepEqual(await page.evaluate(() => document.querySelector("lumistack-viewer").slope), [0.2, 0], name);
      const aside = await pixels(page);
      assert.ok(!aside.data.equals(middle.data), `${name}: the slider moves nothing`);
      seen.push(aside.data);
      assert.deepEqual(page.trouble, [], name);
      await page.screenshot({ path: join(SHOTS, `example-${name}.png`) });
      await page.context().close();
    }
    for (const data of seen) assert.ok(data.equals(seen[0]), "the pages show different pictures");
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
