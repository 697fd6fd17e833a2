// The page that solves (`solve.html`), with several threads: its patterns are those of one thread,
// also if threads fail or the user interferes.
import assert from "node:assert/strict";
import { mkdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { DIST, launch, open, SHOTS } from "./browser.mjs";
import { unpacked } from "./saved.mjs";
import { serve } from "./server.mjs";

const SETTINGS = "preset=paper-three-layer&cols=96&zone_samples=200&iterations=2";
/** Duration above which a task is long, milliseconds, and number of allowed long tasks. Other programs on the machine also make tasks long. */
const LONG_MS = 50;
const MOST_LONG = 2;
/** Smallest rate of pictures, per second. */
const RATE = 30;

/** A script for the thread that solves: it prints the events of further threads. */
const PRINT = `
  const Plain = Worker;
  Worker = class extends Plain {
    constructor(...what) {
      super(...what);
      console.log("thread starts");
      this.addEventListener("message", ({ data }) => console.log("thread: " + data.kind));
    }
    terminate() {
      console.log("thread ends");
      super.terminate();
    }
  };
`;

let browser;
let server;
/** The patterns that one thread computes, by number of frames. */
const alone = new Map();
before(async () => {
  browser = await launch();
  server = await serve({ "/": DIST });
  mkdirSync(SHOTS, { recursive: true });
  for (const frames of [2, 3]) {
    const at = await page(1, { frames });
    await start(at);
    alone.set(frames, await patterns(at));
    assert.equal(at.count("thread starts"), 0);
    await at.context().close();
  }
});
after(async () => {
  await browser?.close();
  await server?.close();
});

/** Opens the page. `prefix` is a script that runs in every thread before its own script. `count(text)` counts the lines that threads print. */
async function page(threads, { frames = 2, prefix = "", of = browser, more = "" } = {}) {
  const init = `
    const Plain = Blob;
    Blob = class extends Plain {
      constructor(parts, options) {
        super(options?.type === "text/javascript" ? [${JSON.stringify(`{${prefix}\n${PRINT}}\n`)}, ...parts] : parts, options);
      }
    };
    window.long = [];
    new PerformanceObserver((list) => window.long.push(...list.getEntries().map(({ duration }) => duration))).observe({ type: "longtask" });
    const draw = () => {
      window.drawn = (window.drawn ?? 0) + 1;
      requestAnimationFrame(draw);
    };
    draw();`;
  const at = await open(of, `${server.url}/solve.html#${SETTINGS}&frames=${frames}&threads=${threads}${more}`, { init });
  const lines = [];
  at.on("console", (message) => lines.push(message.text()));
  at.count = (text) => lines.filter((line) => line === text).length;
  /** Waits until threads have printed this line. */
  at.printed = (text) => at.count(text) > 0 || at.waitForEvent("console", (message) => message.text() === text);
  await at.waitForFunction(() => document.querySelector("#preset").options.length > 0);
  return at;
}

const start = (at) => at.click("text=Letters");

/** Waits for the end of the work. Returns the files that the page saves, by path. */
async function patterns(at) {
  await at.waitForFunction(() => document.documentElement.dataset.stage === "done");
  assert.ok(await at.isHidden("#problem"), await at.textContent("#problem"));
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#save")]);
  const files = unpacked(readFileSync(await download.path()));
  assert.ok(files.size > 3);
  return files;
}

function same(found, expected) {
  assert.deepEqual([...found.keys()], [...expected.keys()]);
  for (const [name, bytes] of found) assert.ok(bytes.equals(expected.get(name)), `${name} differs`);
}

test("three threads compute the patterns of one thread, and the page stays smooth", async () => {
  const at = await page(3);
  await at.evaluate(() => {
    [window.long, window.drawn, window.since] = [[], 0, performance.now()];
  });
  await start(at);
  await at.waitForFunction(() => /Rendering views on 3 threads, \d+ %/.test(document.querySelector("#status").textContent));
  await at.screenshot({ path: join(SHOTS, "solve-threads.png"), fullPage: true });
  same(await patterns(at), alone.get(2));
  const { long, rate } = await at.evaluate(() => ({ long: window.long, rate: (1000 * window.drawn) / (performance.now() - window.since) }));
  console.log(`  ${at.count("thread: traced")} views of other threads; ${rate.toFixed(0)} pictures per second; long tasks: ${long.map((ms) => ms.toFixed(0)).join(", ") || "none"} ms`);
  assert.ok(at.count("thread: traced") >= 2, `${at.count("thread: traced")} views of other threads`);
  assert.ok(long.every((ms) => ms <= 2 * LONG_MS) && long.length <= MOST_LONG, `long tasks of ${long} ms`);
  assert.ok(rate > RATE, `${rate} pictures per second`);
  // The threads have ended, which frees their memory.
  assert.equal(at.count("thread starts"), 2);
  assert.equal(at.count("thread ends"), 2);
  assert.doesNotMatch(await at.textContent("#status"), /threads/);
  await at.screenshot({ path: join(SHOTS, "solve-threads-done.png"), fullPage: true });
  assert.deepEqual(at.trouble, []);
  await at.context().close();
});

test("the solver does the work of threads that fail", async () => {
  // Each failure, and the range of the number of views that other threads trace before it.
  const failures = [
    ["Object.defineProperty(navigator, 'deviceMemory', { value: 1e-3 });", 0, 0],
    ["WebAssembly.Memory.prototype.grow = () => { throw new RangeError('no memory'); };", 0, 0],
    ["const Some = Worker; Worker = class extends Some { constructor() { super('data:text/javascript,throw 1'); } };", 0, 0],
    ["const Some = Worker; Worker = class extends Some { constructor(...what) { super(...what); super.addEventListener('message', ({ data }) => data.kind === 'traced' && super.terminate()); } };", 1, 4],
    ["const post = postMessage; postMessage = (what, ...more) => { if (what.kind === 'traced') throw new WebAssembly.RuntimeError('unreachable'); post(what, ...more); };", 0, 0],
  ];
  for (const [prefix, least, most] of failures) {
    const at = await page(3, { prefix });
    await start(at);
    same(await patterns(at), alone.get(2));
    const traced = at.count("thread: traced");
    assert.ok(traced >= least && traced <= most, `${traced} views of other threads in spite of ${prefix}`);
    assert.equal(at.count("thread starts") > 0, !prefix.includes("deviceMemory"), prefix);
    await at.context().close();
  }
});

test("stop, other settings and another scene discard the views of earlier requests", async () => {
  const at = await page(3);
  await start(at);
  await at.printed("thread: traced");
  // Stop, and wait until the threads have traced their last views. The script clicks, since a click
  // by the browser's driver first waits for the layout: on a busy machine the work could end
  // before the click.
  await at.evaluate(() => document.querySelector("#pause").click());
  await at.waitForFunction(() => /Stopped/.test(document.querySelector("#status").textContent));
  for (let before = -1; before < at.count("thread: traced"); await at.waitForTimeout(1000)) before = at.count("thread: traced");
  // Read the bar only now: the solver may have reported a step just before it received the stop.
  const share = await at.evaluate(() => document.querySelector("#bar").value);
  await at.waitForTimeout(1000);
  assert.equal(await at.textContent("#status").then((text) => /Stopped/.test(text)), true, "the threads continued although the work was stopped");
  assert.equal(await at.evaluate(() => document.querySelector("#bar").value), share);
  await at.click("#pause");
  // Change the settings while views are rendered.
  await at.evaluate(() => {
    document.documentElement.dataset.stage = "";
    const frames = document.querySelector("#frames");
    frames.value = "3";
    frames.dispatchEvent(new Event("input"));
  });
  await at.printed("thread ends");
  await at.waitForFunction(() => /on 3 threads/.test(document.querySelector("#status").textContent));
  // Solve another scene, and then the first scene again.
  await at.click("text=Still life");
  await at.waitForFunction(() => document.title.startsWith("Still life"));
  await start(at);
  await at.waitForFunction(() => document.title.startsWith("Letters"));
  await at.evaluate(() => (document.documentElement.dataset.stage = ""));
  same(await patterns(at), alone.get(3));
  assert.equal(at.count("thread ends"), at.count("thread starts"));
  assert.deepEqual(at.trouble, []);
  await at.context().close();
});

test("several threads also render for the graphics processor", async () => {
  const device = await launch(["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"]);
  const [one, three] = [await page(1, { of: device, more: "&device=gpu" }), await page(3, { of: device, more: "&device=gpu" })];
  await start(one);
  const expected = await patterns(one);
  await start(three);
  same(await patterns(three), expected);
  assert.match(await three.textContent("#status"), /On the graphics processor/);
  assert.ok(three.count("thread: traced") > 0, "no views of other threads");
  assert.deepEqual(three.trouble, []);
  await device.close();
});
