// The page that solves (`solve.html`), on a graphics processor by WebGPU: its patterns agree with
// the patterns of the processor, and the processor solves if there is no device.
import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { DIST, launch, open, SHOTS } from "./browser.mjs";
import { npy, unpacked } from "./saved.mjs";
import { serve } from "./server.mjs";
import { stripes } from "./stripes.mjs";

/** Options that give Chromium a graphics adapter in software. Pages use it only with `device=gpu` in their address. */
const WEBGPU = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"];
/** Largest difference of the patterns' values, 0 to 1. */
const SAME = 1e-4;

let browser;
/** A browser without the options `WEBGPU`. It has no adapter for WebGPU. */
let plain;
let server;
let folder;
let field;
before(async () => {
  [browser, plain] = [await launch(WEBGPU), await launch()];
  server = await serve({ "/": DIST });
  folder = mkdtempSync(join(tmpdir(), "lumistack-solve-gpu-"));
  field = join(folder, "stripes.npy");
  stripes(field);
  mkdirSync(SHOTS, { recursive: true });
});
after(async () => {
  await browser?.close();
  await plain?.close();
  await server?.close();
  if (folder) rmSync(folder, { recursive: true });
});

/** Opens the page. `prefix` is a script that runs in the thread that solves, before the thread's own script. */
async function page(hash, { prefix, of = browser } = {}) {
  const at = await open(of, `${server.url}/solve.html#${hash}`, {
    init: prefix && `const get = fetch; fetch = async (...what) => String(what[0]).endsWith("/solve-gpu.js") ? new Response(${JSON.stringify(prefix)} + await (await get(...what)).text()) : get(...what);`,
  });
  return at;
}

/** Starts to solve the light field. */
const start = (at) => at.setInputFiles("#files", field);
const stage = (at, name) => at.waitForFunction((name) => document.documentElement.dataset.stage === name, name);
const status = (at) => at.textContent("#status");

/** Returns the patterns that the page saves, as a map from file name to values. */
async function patterns(at) {
  await stage(at, "done");
  assert.ok(await at.isHidden("#problem"), await at.textContent("#problem"));
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#save")]);
  const arrays = [...unpacked(readFileSync(await download.path()))].filter(([name]) => name.endsWith(".npy"));
  assert.ok(arrays.length > 0);
  return new Map(arrays.map(([name, bytes]) => [name, npy(bytes)]));
}

/** Compares two sets of patterns. Returns the largest difference of their values and of their 8-bit codes, and the root mean square difference of the values. */
function apart(a, b) {
  assert.deepEqual([...a.keys()], [...b.keys()]);
  let [values, codes, squares, count] = [0, 0, 0, 0];
  for (const [name, ours] of a) {
    const theirs = b.get(name);
    assert.equal(ours.length, theirs.length);
    for (let i = 0; i < ours.length; i++) {
      squares += (ours[i] - theirs[i]) ** 2;
      values = Math.max(values, Math.abs(ours[i] - theirs[i]));
      codes = Math.max(codes, Math.abs(Math.round(255 * ours[i]) - Math.round(255 * theirs[i])));
    }
    count += ours.length;
  }
  return { values, codes, squares: Math.sqrt(squares / count) };
}

async function solved(hash, options) {
  const at = await page(hash, options);
  await start(at);
  const found = { patterns: await patterns(at), status: await status(at), warnings: await at.textContent("#warnings") };
  assert.deepEqual(at.trouble, []);
  return { at, ...found };
}

for (const [name, preset] of [
  ["a uniform backlight", "paper-three-layer"],
  ["a directional backlight", "fig7-directional"],
]) {
  test(`patterns with ${name} agree with the processor's`, async () => {
    for (const iterations of [1, 10]) {
      const display = `preset=${preset}&cols=96&frames=3&iterations=${iterations}`;
      const device = await solved(`${display}&device=gpu`);
      const processor = await solved(`${display}&device=cpu`);
      assert.match(device.status, /^Finished\. .* On the graphics processor\.$/);
      assert.match(processor.status, /On the processor: the address of this page chooses the processor\.$/);
      assert.doesNotMatch(device.warnings, /processor/);
      const { values, squares, codes } = apart(device.patterns, processor.patterns);
      console.log(`${name}, ${iterations} iterations: patterns differ by at most ${values.toExponential(1)}, root mean square ${squares.toExponential(1)}, codes by at most ${codes}`);
      assert.ok(values > 0, "device and processor round in the same way, so perhaps one of them computed both");
      // Rounding errors of values that hardly affect the emission grow with every iteration. So
      // after many iterations only the root mean square of the differences is compared.
      assert.ok((iterations === 1 ? values : squares) <= SAME, `${values}, ${squares}`);
      assert.ok(codes <= 1, `${codes}`);
      if (iterations > 1) await device.at.screenshot({ path: join(SHOTS, `solve-gpu-${preset}.png`), fullPage: true });
      await device.at.context().close();
      await processor.at.context().close();
    }
  });
}

test("the processor continues when the device is lost", async () => {
  const prefix = "const ask = GPUAdapter.prototype.requestDevice; GPUAdapter.prototype.requestDevice = async function (...what) { return (self.lent = await ask.apply(this, what)); };\n";
  const display = "preset=paper-three-layer&cols=96&frames=3&iterations=40";
  const at = await page(`${display}&device=gpu`, { prefix });
  await start(at);
  await stage(at, "patterns");
  await at.waitForFunction(() => document.querySelector("#bar").value > 0.2);
  assert.match(await status(at), /^Solving, .* On the graphics processor\.$/);
  const lost = await Promise.all(at.workers().map((worker) => worker.evaluate(() => (self.lent ? (self.lent.destroy(), true) : false))));
  assert.equal(lost.filter(Boolean).length, 1);
  const found = await patterns(at);
  assert.match(await at.textContent("#warnings"), /the device (was lost|does not answer).*the processor solves instead/);
  assert.match(await status(at), /^Finished\. .* On the processor\.$/);
  await at.screenshot({ path: join(SHOTS, "solve-gpu-lost.png"), fullPage: true });
  // The processor starts this solve again, so its patterns equal the patterns of a solve without a
  // device.
  const processor = await solved(`${display}&device=cpu`);
  assert.deepEqual(apart(found, processor.patterns), { values: 0, codes: 0, squares: 0 });
  assert.deepEqual(at.trouble, []);
  await at.context().close();
  await processor.at.context().close();
});

test("the processor solves if a limit of the device is too small", async () => {
  const prefix = "Object.defineProperty(GPUSupportedLimits.prototype, 'maxStorageBuffersPerShaderStage', { get: () => 8 });\n";
  const { at, status, warnings } = await solved("preset=paper-three-layer&cols=96&frames=2&iterations=2&device=gpu", { prefix });
  assert.match(warnings, /need 9 buffers in one program, but the device allows at most 8; the processor solves instead/);
  assert.match(status, /On the processor\.$/);
  await at.context().close();
});

test("the processor solves without an adapter, or if the only adapter is software and the address does not select it", async () => {
  for (const [of, reason] of [
    [browser, /On the processor: this browser offers only a graphics processor in software\.$/],
    [plain, /On the processor: this browser offers no graphics processor\.$/],
  ]) {
    const at = await page("preset=paper-three-layer&cols=96&frames=2&iterations=2", { of });
    await start(at);
    await stage(at, "done");
    assert.match(await status(at), reason);
    assert.doesNotMatch(await at.textContent("#warnings"), /processor/);
    const loaded = await at.evaluate(() => performance.getEntriesByType("resource").map(({ name }) => name));
    assert.ok(loaded.some((url) => url.endsWith("lumistack_web_solver_bg.wasm")));
    assert.ok(!loaded.some((url) => url.includes("gpu")), "the module with WebGPU was loaded");
    assert.deepEqual(at.trouble, []);
    await at.context().close();
  }
});
