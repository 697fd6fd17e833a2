// A preview in a single file that is opened from disk, and an element that leaves the page and
// returns.
import assert from "node:assert/strict";
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";
import { complete, DIST, launch, open, pixels, text } from "./browser.mjs";
import { twoSquares } from "./fixture.mjs";

let browser;
const folder = mkdtempSync(join(tmpdir(), "lumistack-web-"));
before(async () => (browser = await launch()));
after(async () => {
  await browser?.close();
  rmSync(folder, { recursive: true });
});

test("one file contains page, module and preview", async () => {
  const dist = (name) => readFileSync(join(DIST, name));
  const inline = { wasm: dist("lumistack_web_bg.wasm").toString("base64") };
  for (const [path, bytes] of twoSquares()) inline[path] = bytes.toString("base64");
  const tags = {};
  tags['<script type="module" src="app/viewer.js"></script>'] = `<script>window.LUMISTACK_INLINE=${JSON.stringify(inline)}</script><script type="module">${dist("viewer.js")}</script>`;
  // The plugin omits this part of the page from a single file.
  let html = dist("index.html").toString().replace(/<!--folder-->[^]*<!--\/folder-->/, "");
  for (const [tag, replacement] of Object.entries(tags)) {
    assert.equal(html.split(tag).length, 2, `index.html has ${tag} once`);
    html = html.replace(tag, () => replacement);
  }
  const file = join(folder, "preview.html");
  writeFileSync(file, html);
  const page = await open(browser, pathToFileURL(file).href);
  assert.equal(await complete(page), undefined);
  assert.equal(await text(page, "#title"), "Two squares");
  const { data } = await pixels(page, [0.125, 0]);
  assert.ok(new Set(data.filter((_, i) => i % 4 !== 3)).size > 1);
  await page.waitForTimeout(600);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the script contains no text that would end a script element", () => {
  assert.doesNotMatch(readFileSync(join(DIST, "viewer.js"), "utf8"), /<\/script|<!--/i);
});

test("an element that is removed from the page and inserted again shows its preview", async () => {
  for (const [path, bytes] of twoSquares()) {
    mkdirSync(join(folder, "site", dirname(path)), { recursive: true });
    writeFileSync(join(folder, "site", path), bytes);
  }
  cpSync(DIST, join(folder, "site/app"), { recursive: true });
  const { site } = await import("./browser.mjs");
  const server = await site(join(folder, "site"));
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  await page.evaluate(() => {
    const viewer = document.querySelector("lumistack-viewer");
    const place = viewer.parentNode;
    viewer.remove();
    place.append(viewer);
  });
  assert.equal(await complete(page), undefined);
  const { data } = await pixels(page, [0, 0]);
  assert.ok(new Set(data.filter((_, i) => i % 4 !== 3)).size > 1);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
  await server.close();
});
