// `lumistack preview`: its page in a browser, which reloads itself when the patterns change.
// LUMISTACK_BIN names the program.
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
const skip = !BINARY ? "LUMISTACK_BIN is not set (`cargo xtask web test` sets it)" : !existsSync(FIXTURES) ? "no fixtures (`cargo xtask web fixtures`)" : false;
/** Longest time until the page reloads, ms. The server checks the folder once a second, and the page requests the result of this check once a second. */
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

/** Replaces a file as the program does: writes a new file and renames it. */
function exchange(path, bytes) {
  writeFileSync(join(folder, ".new"), bytes);
  renameSync(join(folder, ".new"), join(folder, "site", path));
}

test("the page reloads itself when the patterns change, and keeps mode and viewing position", { skip }, async () => {
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
  // Without a change the page does not reload.
  await page.waitForTimeout(2500);
  assert.equal(await page.evaluate(() => window.still), true, "the page reloaded itself without a change");

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

test("the page stays the same after the server ends, and its console has only the browser's own errors", { skip }, async () => {
  const page = await open(browser, address);
  assert.equal(await complete(page), undefined);
  const before = await pixels(page, [0.03, 0]);
  server.kill();
  await page.waitForTimeout(2500);
  assert.deepEqual((await pixels(page, [0.03, 0])).data, before.data);
  assert.deepEqual(page.trouble.filter((line) => !/net::ERR_/.test(line)), []);
  await page.context().close();
});
