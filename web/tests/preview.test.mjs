// `lumistack preview`, whose binary LUMISTACK_BIN names: the page in a browser, and that it loads itself anew when the patterns change.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { cpSync, existsSync, mkdtempSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { complete, launch, open, pixels, text } from "./browser.mjs";

const BINARY = process.env.LUMISTACK_BIN;
const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
const skip = !BINARY ? "LUMISTACK_BIN names no lumistack (`cargo xtask web test` does)" : !existsSync(FIXTURES) ? "no fixtures (`cargo xtask web fixtures`)" : false;
/** The page asks once a second, and the server looks once a second. */
const RELOAD_MS = 5000;

const folder = mkdtempSync(join(tmpdir(), "lumistack-preview-"));
let browser;
let server;
let address;
before(async () => {
  if (skip) return;
  browser = await launch();
  cpSync(join(FIXTURES, "uniform3"), join(folder, "site"), { recursive: true });
  server = spawn(BINARY, ["--json", "preview", "--no-open", "--port", "0", join(folder, "site")], { stdio: ["ignore", "pipe", "inherit"] });
  for await (const line of createInterface({ input: server.stdout })) {
    const event = JSON.parse(line);
    if (event.event === "serving") address = event.address;
    if (address) break;
  }
});
after(async () => {
  await browser?.close();
  server?.kill();
  rmSync(folder, { recursive: true });
});

/** Exchanges a file as the program does: written beside its place and renamed. */
function exchange(path, bytes) {
  writeFileSync(join(folder, ".new"), bytes);
  renameSync(join(folder, ".new"), join(folder, "site", path));
}

test("the page loads itself anew when the patterns change, and stays where one looked from", { skip }, async () => {
  const page = await open(browser, address);
  assert.equal(await complete(page), undefined);
  await page.evaluate(() => {
    const viewer = document.querySelector("lumistack-viewer");
    viewer.mode = "compare";
    viewer.slope = [0.05, 0.02];
    window.still = true;
  });
  await page.waitForTimeout(700);
  const before = await pixels(page);
  // nothing changes: nothing is loaded
  await page.waitForTimeout(2500);
  assert.equal(await page.evaluate(() => window.still), true, "the page loaded itself without need");

  const preview = JSON.parse(readFileSync(join(folder, "site/stack/preview.json"), "utf8"));
  const [first, other] = preview.files.filter((file) => file.kind === "layer" && file.layer === 0);
  const swapped = readFileSync(join(folder, "site", other.path));
  exchange(first.path, swapped);
  exchange("stack/preview.json", JSON.stringify({ ...preview, title: "Changed" }));
  await page.waitForFunction(() => window.still === undefined && document.title.startsWith("Changed"), undefined, { timeout: RELOAD_MS });
  assert.equal(await complete(page), undefined);
  assert.equal(await text(page, "#title"), "Changed");
  const state = await page.evaluate(() => {
    const viewer = document.querySelector("lumistack-viewer");
    return [viewer.mode, ...viewer.slope];
  });
  assert.deepEqual(state, ["compare", 0.05, 0.02]);
  assert.notDeepEqual((await pixels(page)).data, before.data, "the old patterns are still shown");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("a server that ends leaves the page as it is, without a word on the console beyond the browser's own", { skip }, async () => {
  const page = await open(browser, address);
  assert.equal(await complete(page), undefined);
  const before = await pixels(page, [0.03, 0]);
  server.kill();
  await page.waitForTimeout(2500);
  assert.deepEqual((await pixels(page, [0.03, 0])).data, before.data);
  assert.deepEqual(page.trouble.filter((line) => !/net::ERR_/.test(line)), []);
  await page.context().close();
});
