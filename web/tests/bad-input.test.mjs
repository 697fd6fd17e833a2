// Bad input and missing graphics: a message states the problem and a remedy, and the viewer never
// shows an empty canvas.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { complete, launch, open, pixels, site, text } from "./browser.mjs";
import { altered, twoSquares } from "./fixture.mjs";

const good = twoSquares();
let browser;
let server;
before(async () => {
  browser = await launch();
  server = await site(good);
});
after(async () => {
  await browser?.close();
  await server?.close();
});

async function shown(files, options, query = "") {
  server.state.files = files;
  const page = await open(browser, `${server.url}/${query}`, options);
  const error = await complete(page);
  await page.waitForTimeout(120);
  return { page, error };
}

async function isPicture(page) {
  const { data } = await pixels(page);
  return new Set(data.filter((_, i) => i % 4 !== 3)).size > 1;
}

/** Checks that files that cannot be shown give a card with a message and advice in place of the picture. */
async function refuses(files, what, advice, options) {
  const { page, error } = await shown(files, options);
  assert.match(error ?? "", what);
  assert.match((await text(page, "#card")) ?? "no card", what);
  assert.match((await text(page, "#card .advice")) ?? "", advice);
  assert.equal(await text(page, "#picture"), undefined, "a canvas is visible beside the message");
  await page.context().close();
}

test("preview.json is missing", () => refuses(altered(good, { "stack/preview.json": undefined }), /stack\/preview\.json is missing.*404/, /lumistack preview/));

test("preview.json is not JSON", () => refuses(altered(good, { "stack/preview.json": Buffer.from("<!doctype html>") }), /preview\.json/, /lumistack preview/));

test("another version", () => refuses(altered(good, {}, (p) => ({ ...p, version: 7 })), /version.*expected 1.*found 7/, /lumistack preview/));

test("another format", () => refuses(altered(good, {}, (p) => ({ ...p, schema: "something" })), /schema.*expected.*lumistack-preview.*found.*something/, /lumistack preview/));

test("every mask is missing", () => {
  const none = Object.fromEntries([...good.keys()].filter((path) => path.includes("layer")).map((path) => [path, undefined]));
  return refuses(altered(good, none), /stack\/layer0_frame0\.png is missing.*and 3 more/, /lumistack preview/);
});

test("no WebAssembly module", async () => {
  server.state.files = good;
  server.state.hook = (path, response) => path.endsWith(".wasm") && Boolean(response.writeHead(404).end());
  await refuses(good, /simulator could not start/, /lumistack_web_bg\.wasm/);
  server.state.hook = undefined;
});

test("a mask is missing: the other frame is shown, with a message", async () => {
  const { page, error } = await shown(altered(good, { "stack/layer1_frame1.png": undefined }));
  assert.equal(error, undefined);
  assert.match(await text(page, "#notice"), /layer1_frame1\.png is missing.*1 of 2 frames/);
  assert.ok(await isPicture(page));
  await page.context().close();
});

test("a mask is cut short: the other frame is shown, with a message", async () => {
  const path = "stack/layer0_frame1.png";
  const { page, error } = await shown(altered(good, { [path]: good.get(path).subarray(0, 60) }));
  assert.equal(error, undefined);
  assert.match(await text(page, "#notice"), /layer0_frame1\.png/);
  assert.match(await text(page, "#notice"), /damaged/);
  assert.ok(await isPicture(page));
  await page.context().close();
});

/** Returns a script for the page that puts the text `before` in front of the script of the simulator's thread. */
const inThread = (before) => `window.Blob = class extends Blob {
  constructor(parts, options) {
    super(options?.type === "text/javascript" ? [${JSON.stringify(before)}, ...parts] : parts, options);
  }
};`;
const NO_WEBGL = `{
  const real = OffscreenCanvas.prototype.getContext;
  OffscreenCanvas.prototype.getContext = function (kind, ...rest) { return /webgl/.test(kind) ? null : real.call(this, kind, ...rest); };
}`;
/** A script that makes WebGL2 slow, and hides that it runs in software. */
const SLOW_WEBGL = `{
  const real = OffscreenCanvas.prototype.getContext;
  OffscreenCanvas.prototype.getContext = function (kind, options) { return real.call(this, kind, { ...options, failIfMajorPerformanceCaveat: false }); };
  const get = WebGL2RenderingContext.prototype.getParameter;
  WebGL2RenderingContext.prototype.getParameter = function (name) { return name === this.RENDERER ? "A fine driver" : get.call(this, name); };
  const read = WebGL2RenderingContext.prototype.readPixels;
  WebGL2RenderingContext.prototype.readPixels = function (...all) {
    for (const start = performance.now(); performance.now() - start < 400; );
    return read.apply(this, all);
  };
}`;
const path = (page) => page.evaluate(() => document.querySelector("lumistack-viewer").path);

for (const [name, init] of [
  ["no WebGL", inThread(NO_WEBGL)],
  ["WebGL in software, which the browser reports", undefined],
  ["WebGL that is slower than the processor", inThread(SLOW_WEBGL)],
]) {
  test(`${name}: the processor draws the same picture, and the footer states it`, async () => {
    const reference = await shown(good, {}, "?renderer=webgl2");
    const wanted = await pixels(reference.page, [0.125, 0]);
    assert.equal(await path(reference.page), "webgl2");
    await reference.page.context().close();
    const { page, error } = await shown(good, { init });
    assert.equal(error, undefined);
    for (const x of [0.1, 0.11, 0.12]) await pixels(page, [x, 0]);
    await page.waitForFunction(() => document.querySelector("lumistack-viewer").path === "cpu");
    assert.match(await text(page, "#footer"), /processor/);
    assert.equal(await text(page, "#notice"), undefined, "a message lies over the picture");
    assert.deepEqual((await pixels(page, [0.125, 0])).data, wanted.data);
    assert.deepEqual(page.trouble, []);
    await page.context().close();
  });
}

test("a lost context: the processor draws until the browser restores the context", async () => {
  const { page, error } = await shown(good, {}, "?renderer=webgl2");
  assert.equal(error, undefined);
  const before = await pixels(page, [0.125, 0]);
  const [thread] = page.workers();
  await thread.evaluate(() => {
    self.lost = self.context.getExtension("WEBGL_lose_context");
    self.lost.loseContext();
  });
  await page.waitForFunction(() => document.querySelector("lumistack-viewer").path === "cpu");
  assert.match(await text(page, "#notice"), /graphics context/);
  assert.deepEqual((await pixels(page)).data, before.data);
  await thread.evaluate(() => self.lost.restoreContext());
  await page.waitForFunction(() => document.querySelector("lumistack-viewer").path === "webgl2");
  assert.equal(await text(page, "#notice"), undefined);
  assert.deepEqual((await pixels(page)).data, before.data);
  await page.context().close();
});

test("a context that is never restored: a new canvas replaces it", async () => {
  const { page } = await shown(good, {}, "?renderer=webgl2");
  const before = await pixels(page, [0.125, 0]);
  await page.workers()[0].evaluate(() => {
    self.before = self.context;
    self.context.getExtension("WEBGL_lose_context").loseContext();
  });
  await page.waitForFunction(() => document.querySelector("lumistack-viewer").path === "cpu");
  await page.waitForFunction(() => document.querySelector("lumistack-viewer").path === "webgl2");
  assert.notEqual(await page.workers()[0].evaluate(() => self.before === self.context), true);
  assert.deepEqual((await pixels(page)).data, before.data);
  await page.context().close();
});

test("invalid values in the address: the default mode is used, without an error", async () => {
  const { page, error } = await shown(good, {}, "#mode=sideways&x=NaN&gap=1e99&split=-3&frame=77&layer=9&gain=-1&rate=0");
  assert.equal(error, undefined);
  assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").mode), "perceived");
  for (const part of ["#notice", "#card"]) assert.equal(await text(page, part), undefined, part);
  assert.ok(await isPicture(page));
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});
