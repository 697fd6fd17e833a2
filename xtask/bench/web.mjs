// Measures the simulator's page in headless Chromium and Firefox: `node web.mjs SITE SHOTS`. SITE
// is the folder of a preview.
//
// Prints when the poster is painted, when the user can look around ("interactive"), and when the
// first picture of the patterns is shown. These times are measured from the start of the
// navigation. "longest task" is the longest task of the page's main thread, until two seconds after
// all files have arrived. Firefox reports no tasks, so in Firefox it is the longest time between
// two animation frames. A median above its limit is an error. The time of a frame includes
// drawing and reading back the picture in the simulator's thread. On a machine without a graphics
// processor WebGL2 draws in software. SHOTS gets screenshots of the first five seconds.
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { chromium, firefox, median, serve } from "./site.mjs";

const [site, shots] = process.argv.slice(2);
const ROUNDS = 5;
const FRAMES = 40;
const SLOW = { bytesPerS: 10e6 / 8, latencyMs: 60 };
/** Largest medians, milliseconds. A page on a slow processor may take twice the time until the user can look around. */
const LIMITS = { painted: 300, interactive: 1500, long: 50 };
/** The emulated connections and processors. */
const PROFILES = [
  { name: "no limits", connection: undefined, slowdown: 1, limits: LIMITS },
  { name: "10 Mbit/s, 60 ms", connection: SLOW, slowdown: 1, limits: LIMITS },
  { name: "10 Mbit/s, 60 ms, page's thread 4 times slower", connection: SLOW, slowdown: 4, limits: { interactive: 2 * LIMITS.interactive } },
];
/** Times of the screenshots, seconds after the start of the navigation. */
const SECONDS = [0.3, 0.6, 1, 2, 3, 5];

/** Runs in the page before its scripts, and records the page's times. */
function watch() {
  window.long = 0;
  new PerformanceObserver((list) => list.getEntries().forEach((entry) => entry.element?.slot === "poster" && (window.painted ??= entry.startTime))).observe({ type: "largest-contentful-paint", buffered: true });
  if (PerformanceObserver.supportedEntryTypes.includes("longtask")) {
    new PerformanceObserver((list) => list.getEntries().forEach(({ duration }) => (window.long = Math.max(window.long, duration)))).observe({ type: "longtask", buffered: true });
    return;
  }
  let last;
  const next = (now) => {
    if (last !== undefined) window.long = Math.max(window.long, now - last);
    last = now;
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
}

const isInteractive = () => performance.getEntriesByName("lumistack-interactive").length > 0;

/** Runs in the page. Waits until everything has arrived, and returns the recorded times. */
async function measured() {
  const viewer = document.querySelector("lumistack-viewer");
  await viewer.complete;
  await new Promise((resolve) => setTimeout(resolve, 2000));
  const at = (name) => performance.getEntriesByName(`lumistack-${name}`)[0]?.startTime;
  return { painted: window.painted ?? at("poster"), interactive: at("interactive"), whole: at("first-picture"), long: window.long };
}

const server = await serve(site);
const { state, url } = server;
const browser = await chromium();
const other = await firefox();
let missed = 0;

/** Loads the page several times by `load`, and prints the medians. */
async function profile(name, limits, load) {
  const rounds = [];
  for (let round = 0; round < ROUNDS; round++) {
    state.bytes = 0;
    rounds.push(await load());
  }
  const of = (key) => {
    const value = median(rounds.map((round) => round[key]));
    if (!(value <= (limits[key] ?? Infinity))) missed += 1;
    return `${value.toFixed(0)} ms${limits[key] ? ` (limit ${limits[key]})` : ""}`;
  };
  const [early, whole] = ["early", "bytes"].map((key) => `${(median(rounds.map((round) => round[key])) / 1000).toFixed(0)} kB`);
  console.log(`${name}: poster ${of("painted")}, interactive ${of("interactive")} after ${early}, picture ${of("whole")}, longest task ${of("long")}, ${whole} in all (medians of ${ROUNDS})`);
}

for (const { name, connection, slowdown, limits } of PROFILES) {
  state.connection = connection;
  await profile(`Chromium, ${name}`, limits, async () => {
    const context = await browser.newContext({ viewport: { width: 1440, height: 900 } });
    const page = await context.newPage();
    await (await context.newCDPSession(page)).send("Emulation.setCPUThrottlingRate", { rate: slowdown });
    await page.addInitScript(watch);
    await page.goto(url, { waitUntil: "commit" });
    await page.waitForFunction(isInteractive);
    const early = state.bytes;
    const times = await page.evaluate(measured);
    await context.close();
    return { ...times, early, bytes: state.bytes };
  });
}
for (const { name, connection } of other ? PROFILES.slice(0, 2) : []) {
  state.connection = connection;
  // A frame of Firefox may wait for the compositor, which works in software here. So the longest
  // task has no limit.
  await profile(`Firefox, ${name}`, { painted: LIMITS.painted, interactive: LIMITS.interactive }, async () => {
    const page = await other.newPage();
    await page.evaluateOnNewDocument(watch);
    await page.goto(url, { waitUntil: "domcontentloaded" });
    await page.waitForFunction(isInteractive, { polling: 20 });
    const early = state.bytes;
    const times = await page.evaluate(measured);
    await page.close();
    return { ...times, early, bytes: state.bytes };
  });
}
if (!other) console.log("Firefox: not measured, since there is none");

// Take each screenshot in a page of its own, since a screenshot delays the page.
mkdirSync(shots, { recursive: true });
state.connection = SLOW;
for (const [name, options] of [
  ["desktop", { viewport: { width: 1440, height: 900 } }],
  ["phone", { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true }],
]) {
  for (const seconds of SECONDS) {
    const context = await browser.newContext(options);
    const page = await context.newPage();
    await page.goto(url, { waitUntil: "commit" });
    await page.evaluate((ms) => new Promise((resolve) => setTimeout(resolve, ms - performance.now())), 1000 * seconds);
    await page.screenshot({ path: join(shots, `${name}-${seconds}s.png`) });
    await context.close();
  }
}
console.log(`screenshots of the first seconds: ${shots}`);

state.connection = undefined;
for (const renderer of ["webgl2", "cpu"]) {
  const page = await (await browser.newContext({ viewport: { width: 1440, height: 900 }, reducedMotion: "reduce" })).newPage();
  await page.goto(`${url}?renderer=${renderer}`);
  const times = await page.evaluate(async (count) => {
    const viewer = document.querySelector("lumistack-viewer");
    await viewer.complete;
    const times = [];
    for (let i = 0; i < count; i++) {
      viewer.slope = [0.12 * Math.sin(i), 0.12 * Math.cos(i)];
      const start = performance.now();
      await viewer.pixels();
      times.push(performance.now() - start);
    }
    return times;
  }, renderer === "cpu" ? FRAMES : 4);
  console.log(`${renderer === "cpu" ? "CPU path" : "WebGL2"}: frame ${median(times).toFixed(1)} ms (median of ${times.length})`);
  await page.context().close();
}
await browser.close();
await other?.close();
server.close();
if (missed > 0) {
  console.error(`${missed} medians are above their limits`);
  process.exitCode = 1;
}
