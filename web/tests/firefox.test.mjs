// The viewer and the page that solves (`solve.html`) in Firefox, driven by WebDriver BiDi: they
// compute and show the same as in Chromium.
import assert from "node:assert/strict";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import puppeteer from "puppeteer-core";
import { complete, DIST, launch, open, pixels, SHOTS, site } from "./browser.mjs";
import { altered, png, SCENE, twoSquares } from "./fixture.mjs";
import { serve } from "./server.mjs";
import { stripes } from "./stripes.mjs";

const FIREFOX = [process.env.LUMISTACK_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"].find((path) => path && existsSync(path));
const skip = !FIREFOX && "there is no Firefox: install it (Debian: apt-get install firefox-esr) or name one in LUMISTACK_FIREFOX";
const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const MODES = [["perceived"], ["slow"], ["exploded"], ["compare", "slider"], ["compare", "side"], ["compare", "error"], ["layers"]];
const HASH = "#scene=letters&preset=paper-three-layer&cols=96&frames=2&zone_samples=600&iterations=2";

let server;
let firefox;
let chromium;
before(async () => {
  if (skip) return;
  server = await serve({ "/": DIST });
  firefox = await puppeteer.launch({ browser: "firefox", executablePath: FIREFOX, headless: true, args: ["--width=1440", "--height=900"] });
  chromium = await launch();
  mkdirSync(SHOTS, { recursive: true });
});
after(async () => {
  await firefox?.close();
  await chromium?.close();
  await server?.close();
});

/** Sets the size of the window's page. Firefox before 144 refuses the orientation that puppeteer sends beside the size. */
async function resize(page, width, height) {
  await page.setViewport({ width, height }).catch((error) => {
    if (!error.message.includes("setScreenOrientationOverride")) throw error;
  });
  await page.waitForFunction((wanted) => innerWidth === wanted, {}, width);
}

/** Waits until the work is done. Returns the PSNR that the page computes, and a seen picture. */
async function solved(page, wait) {
  await wait(() => document.documentElement.dataset.stage === "done");
  // The viewer may draw the last patterns shortly after the page reports the end of the work.
  await page.evaluate(() => new Promise((resolve) => setTimeout(resolve, 1000)));
  return { psnr: await page.evaluate(() => document.documentElement.dataset.psnr), seen: await pixels(page, [0.05, -0.03]) };
}

test("the page that solves computes the same patterns on three threads in Firefox and on one in Chromium", { skip }, async () => {
  const page = await firefox.newPage();
  page.setDefaultTimeout(120_000);
  const trouble = [];
  page.on("pageerror", (error) => trouble.push(error.message));
  page.on("console", (message) => ["error", "warn"].includes(message.type()) && trouble.push(message.text()));
  await resize(page, 1440, 900);
  await page.evaluateOnNewDocument(() => {
    window.mostThreads = 1;
    new MutationObserver(() => {
      const [, count] = /on (\d+) threads/.exec(document.querySelector("#status")?.textContent ?? "") ?? [];
      window.mostThreads = Math.max(window.mostThreads, Number(count ?? 1));
    }).observe(document, { childList: true, subtree: true });
  });
  await page.goto(`${server.url}/solve.html${HASH}&threads=3`);
  let theirs = await solved(page, (done) => page.waitForFunction(done));
  const threads = () => page.evaluate(() => window.mostThreads);
  // On a busy machine the views may be rendered before the third thread has started.
  for (let turn = 0; turn < 3 && (await threads()) < 3; turn++) {
    await page.reload();
    theirs = await solved(page, (done) => page.waitForFunction(done));
  }
  assert.equal(await threads(), 3);
  await page.screenshot({ path: join(SHOTS, "firefox-done.png") });
  await page.click("#closer");
  await resize(page, 390, 844);
  await page.screenshot({ path: join(SHOTS, "firefox-phone.png") });
  assert.deepEqual(trouble, []);
  // Compare with Chromium: a WebAssembly module gives the same results in every browser.
  const other = await open(chromium, `${server.url}/solve.html${HASH}&threads=1`);
  const ours = await solved(other, (done) => other.waitForFunction(done));
  assert.equal(theirs.psnr, ours.psnr);
  assert.ok(Number(theirs.psnr) > 20, theirs.psnr);
  assert.deepEqual([theirs.seen.width, theirs.seen.height], [ours.seen.width, ours.seen.height]);
  const far = theirs.seen.data.filter((code, i) => Math.abs(code - ours.seen.data[i]) > 1).length;
  assert.equal(far, 0, `${far} values of the seen picture differ`);
});

test("the viewer in Firefox shows its poster, then the pictures of Chromium in every mode, and axe finds nothing", { skip }, async (t) => {
  const { cols, rows } = SCENE;
  const preview = await site(altered(twoSquares(), { "stack/poster.jpg": png(cols, rows, () => [220, 30, 30]) }, (preview) => ({ ...preview, poster: "stack/poster.jpg" })));
  t.after(() => preview.close());
  // The patterns wait until the poster is checked.
  let go;
  const gate = new Promise((resolve) => (go = resolve));
  preview.state.hook = (path, response) => {
    if (!path.includes("layer")) return false;
    void gate.then(() => response.writeHead(200, { "content-type": "image/png" }).end(preview.state.files.get(path.slice(1))));
    return true;
  };
  const page = await firefox.newPage();
  page.setDefaultTimeout(60_000);
  const trouble = [];
  page.on("pageerror", (error) => trouble.push(error.message));
  page.on("console", (message) => ["error", "warn"].includes(message.type()) && trouble.push(message.text()));
  await resize(page, 1440, 900);
  await page.goto(preview.url, { waitUntil: "domcontentloaded" });
  await page.waitForFunction(() => performance.getEntriesByName("lumistack-poster").length > 0);
  const covers = () => page.evaluate(() => {
    const root = document.querySelector("lumistack-viewer").shadowRoot;
    const { width, height } = root.querySelector("#poster").getBoundingClientRect();
    return { poster: width > 300 && height > 200 && getComputedStyle(root.querySelector("#poster")).opacity === "1", canvas: !root.querySelector("canvas.main").hidden };
  });
  assert.deepEqual(await covers(), { poster: true, canvas: false });
  await page.screenshot({ path: join(SHOTS, "firefox-poster.png") });
  go();
  assert.equal(await complete(page), undefined);
  await page.waitForFunction(() => performance.getEntriesByName("lumistack-first-picture").length > 0);
  assert.equal((await covers()).canvas, true);
  const other = await open(chromium, preview.url);
  assert.equal(await complete(other), undefined);
  await page.evaluate(AXE);
  const show = ([mode, comparison]) => {
    const viewer = document.querySelector("lumistack-viewer");
    viewer.mode = mode;
    if (comparison) viewer.comparison = comparison;
    viewer.slope = [0.1, -0.05];
  };
  for (const mode of MODES) {
    for (const each of [page, other]) await each.evaluate(show, mode);
    const [theirs, ours] = [await pixels(page), await pixels(other)];
    if (mode[0] !== "exploded") {
      assert.deepEqual([theirs.width, theirs.height], [ours.width, ours.height]);
      const far = theirs.data.filter((code, i) => Math.abs(code - ours.data[i]) > 1).length;
      assert.equal(far, 0, `${far} values differ in ${mode}`);
    }
    assert.ok(new Set(theirs.data.filter((_, i) => i % 4 !== 3)).size > 1, `${mode} is one colour`);
    const found = await page.evaluate(async () => (await window.axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target }) => target).join("; ")}`));
    assert.deepEqual(found, [], `${mode}`);
    await page.screenshot({ path: join(SHOTS, `firefox-${mode.join("-")}.png`) });
  }
  assert.deepEqual(trouble, []);
  await page.close();
});

test("Firefox solves a light field that is chosen or dropped, and reports a broken one", { skip }, async () => {
  const folder = mkdtempSync(join(tmpdir(), "lumistack-firefox-"));
  try {
    const page = await firefox.newPage();
    page.setDefaultTimeout(120_000);
    await page.goto(`${server.url}/solve.html#preset=paper-three-layer&cols=96&frames=2&iterations=2`);
    await page.waitForFunction(() => document.querySelector("#preset").options.length > 0);
    // Set the files without the dialog, since only newer Firefox lets tests answer the dialog. The
    // tests in Chromium use the dialog.
    const choose = async (name) => (await page.$("#files")).uploadFile(join(folder, name));
    stripes(join(folder, "stripes.npy"));
    const bytes = readFileSync(join(folder, "stripes.npy"));
    await choose("stripes.npy");
    const { psnr, seen } = await solved(page, (done) => page.waitForFunction(done));
    assert.ok(Number(psnr) > 15, psnr);
    assert.deepEqual([seen.width, seen.height], [64, 40]);
    writeFileSync(join(folder, "cut.npy"), bytes.subarray(0, 5000));
    await choose("cut.npy");
    await page.waitForFunction(() => document.querySelector("#problem").textContent.includes("cut.npy: values of shape"));
    // Drop the whole light field under another name.
    await page.evaluate((content) => {
      document.documentElement.dataset.stage = "";
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))], "dropped.npy"));
      document.querySelector("#drop").dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
    }, bytes.toString("base64"));
    const dropped = await solved(page, (done) => page.waitForFunction(done));
    assert.equal(dropped.psnr, psnr);
    assert.ok(await page.evaluate(() => document.querySelector("#problem").hidden && document.title.startsWith("dropped")));
  } finally {
    rmSync(folder, { recursive: true });
  }
});
