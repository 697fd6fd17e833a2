// Measures the page that computes patterns (`preview --solve`), in headless Chromium:
// `node web_solve.mjs LUMISTACK FOLDER MODEL`.
// LUMISTACK is the command, FOLDER gets the results, and MODEL is a glTF file.
//
// Drops the model as a single .glb on the page, at 160 columns, three layers and six frames. Prints
// the time to the first picture, the zone score over time, the number of animation frames per
// second until the end, and the memory of all WebAssembly modules. Then measures the first picture
// of the scenes that come with the page, and compares a finished solve with the command's.
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { basename, dirname, join } from "node:path";
import { glb } from "../../web/tests/glb.mjs";
import { unpacked } from "../../web/tests/saved.mjs";
import { chromium, serve } from "./site.mjs";

const [command, folder, model] = process.argv.slice(2);
const ROOT = join(import.meta.dirname, "../..");
const SETTINGS = "preset=paper-three-layer&cols=160&layers=3&frames=6";
/** Times at which patterns are saved and scored, seconds after the drop. */
const SCORED = [5, 10, 20, 30];
/**
 * Limits. `dropped` and `builtIn`: first picture of a dropped model and of a scene of the page, ms.
 * `rate`: animation frames per second. `behind`: largest difference of the zone score after 30 s
 * from the final zone score, dB. `command`: largest difference of the PSNR from the command's, dB.
 */
const LIMITS = { dropped: 3000, builtIn: 1000, rate: 30, behind: 1, command: 0.1 };
let missed = 0;
const check = (text, isMet) => {
  if (!isMet) missed += 1;
  return isMet ? text : `${text}: MISSED`;
};

/** Runs in each thread before its script, and keeps the memory of every module. */
const KEEP = `{
  const Plain = WebAssembly.Instance;
  self.memories = [];
  WebAssembly.Instance = class extends Plain {
    constructor(...what) {
      super(...what);
      self.memories.push(this.exports.memory);
    }
  };
}
`;
const INIT = `
  const Plain = Blob;
  Blob = class extends Plain {
    constructor(parts, options) {
      super(options?.type === "text/javascript" ? [${JSON.stringify(KEEP)}, ...parts] : parts, options);
    }
  };
  window.frames60 = [];
  const draw = (now) => {
    window.frames60.push(now);
    requestAnimationFrame(draw);
  };
  requestAnimationFrame(draw);
  window.long = [];
  new PerformanceObserver((list) => window.long.push(...list.getEntries().map(({ startTime, duration }) => [startTime, duration]))).observe({ type: "longtask" });
  for (const kind of ["drop", "click"]) addEventListener(kind, () => (window.since ??= performance.now()), { capture: true });`;

const server = await serve(join(ROOT, "web/dist"));
const browser = await chromium();
rmSync(folder, { recursive: true, force: true });
mkdirSync(folder, { recursive: true });

async function opened(more = "") {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 } });
  context.setDefaultTimeout(600_000);
  const page = await context.newPage();
  await page.addInitScript(INIT);
  await page.goto(`${server.url}solve.html#${SETTINGS}${more}`);
  await page.waitForFunction(() => document.querySelector("#preset").options.length > 0);
  return page;
}

/** Waits for the first picture; returns its time after the drop or the click, milliseconds. */
async function first(page) {
  await page.waitForFunction(() => performance.getEntriesByName("lumistack-first-patterns").length > 0);
  return page.evaluate(() => performance.getEntriesByName("lumistack-first-patterns")[0].startTime - window.since);
}

const isDone = (page) => page.evaluate(() => document.documentElement.dataset.stage === "done");

/** Saves the current patterns as a run folder. */
async function save(page, name) {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save")]);
  const run = join(folder, name);
  for (const [path, bytes] of unpacked(readFileSync(await download.path()))) {
    mkdirSync(dirname(join(run, path)), { recursive: true });
    writeFileSync(join(run, path), bytes);
  }
  return run;
}

/** Returns the zone score of saved patterns, dB. The command starts from these patterns and makes no iteration. */
function score(run) {
  const job = readFileSync(join(run, "job.toml"), "utf8").replace('scene = "', `scene = "${folder}/`);
  writeFileSync(join(run, "score.toml"), `${job}\n[factorize]\niterations = 0\nwarm_start = ${JSON.stringify(join(run, "layers"))}\n`);
  const out = join(folder, "scored");
  execFileSync(command, ["run", join(run, "score.toml"), "-o", out], { stdio: "pipe" });
  return JSON.parse(readFileSync(join(out, "report.json"), "utf8")).psnr_zone;
}

// Drop the model, and save patterns while it is solved.
const name = basename(model).replace(/\.[^.]*$/, "");
const file = join(folder, `${name}.glb`);
writeFileSync(file, model.endsWith(".glb") ? readFileSync(model) : glb(model));
{
  const page = await opened();
  let most = 0;
  let watching = true;
  const memory = (async () => {
    while (watching) {
      const each = await Promise.all(page.workers().map((worker) => worker.evaluate(() => self.memories.reduce((sum, { buffer }) => sum + buffer.byteLength, 0)).catch(() => 0)));
      most = Math.max(most, each.reduce((sum, bytes) => sum + bytes, 0));
      await new Promise((resolve) => setTimeout(resolve, 200));
    }
  })();
  const input = await page.context().newCDPSession(page);
  const data = { items: [], files: [file], dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) await input.send("Input.dispatchDragEvent", { type, x: 900, y: 400, data });
  const shown = await first(page);
  await page.screenshot({ path: join(folder, "first.png") });
  const runs = [["first", await save(page, "at-first")]];
  for (const seconds of SCORED) {
    while (!(await isDone(page)) && (await page.evaluate((s) => performance.now() - window.since < 1000 * s, seconds))) await page.waitForTimeout(50);
    const at = (await page.evaluate(() => performance.now() - window.since)) / 1000;
    if (await isDone(page)) break;
    runs.push([`${at.toFixed(1)} s`, await save(page, `at-${seconds}`)]);
  }
  await page.waitForFunction(() => document.documentElement.dataset.stage === "done");
  const { took, frames, long, status } = await page.evaluate(() => {
    const took = performance.getEntriesByName("lumistack-done")[0].startTime - window.since;
    const during = (at) => at >= window.since && at <= window.since + took;
    return { took, frames: window.frames60.filter(during).map((at) => at - window.since), long: window.long.filter(([at]) => during(at)).map(([, ms]) => ms), status: document.querySelector("#status").textContent };
  });
  watching = false;
  await memory;
  runs.push(["end", await save(page, "at-end")]);
  await page.screenshot({ path: join(folder, "end.png") });
  const seconds = Array.from({ length: Math.floor(took / 1000) }, (_, i) => frames.filter((at) => at >= 1000 * i && at < 1000 * (i + 1)).length);
  const scores = runs.map(([, run]) => score(run));
  const final = scores.at(-1);
  console.log(`${name}.glb, ${(readFileSync(file).length / 1e6).toFixed(1)} MB: ${check(`first picture after ${(shown / 1000).toFixed(2)} s (limit ${LIMITS.dropped / 1000})`, shown <= LIMITS.dropped)}, end after ${(took / 1000).toFixed(1)} s; ${status}`);
  runs.forEach(([when], i) => console.log(`  zone score ${when}: ${scores[i].toFixed(2)} dB, ${(final - scores[i]).toFixed(2)} dB below the end`));
  const early = runs.findLastIndex(([when]) => when === "first" || parseFloat(when) <= SCORED.at(-1) + 0.5);
  const behind = took <= 1000 * SCORED.at(-1) ? 0 : final - scores[early];
  console.log(`  ${check(`after 30 s ${behind.toFixed(2)} dB below the end (limit ${LIMITS.behind})`, behind <= LIMITS.behind)}`);
  console.log(`  ${check(`animation frames per second: mean ${((1000 * frames.length) / took).toFixed(0)}, fewest ${Math.min(...seconds)} (limit ${LIMITS.rate})`, Math.min(...seconds) >= LIMITS.rate)}; long tasks: ${long.map((ms) => ms.toFixed(0)).join(", ") || "none"} ms`);
  console.log(`  memory of all modules: at most ${(most / 2 ** 20).toFixed(0)} MiB`);
  await page.context().close();
}

// The scenes that come with the page.
for (const scene of ["Still life", "Letters", "Dandelion"]) {
  const page = await opened();
  await page.click(`text=${scene}`);
  const shown = await first(page);
  await page.waitForFunction(() => document.documentElement.dataset.stage === "done");
  const took = await page.evaluate(() => performance.getEntriesByName("lumistack-done")[0].startTime - window.since);
  console.log(`${scene}: ${check(`first picture after ${(shown / 1000).toFixed(2)} s (limit ${LIMITS.builtIn / 1000})`, shown <= LIMITS.builtIn)}, end after ${(took / 1000).toFixed(1)} s`);
  if (scene === "Letters") {
    const psnr = Number(await page.evaluate(() => document.documentElement.dataset.psnr));
    const run = await save(page, "letters");
    cpSync(join(ROOT, "scenes/letters"), run, { recursive: true, filter: (path) => !path.endsWith("job.toml") });
    const out = join(folder, "letters-command");
    execFileSync(command, ["run", join(run, "job.toml"), "-o", out], { stdio: "pipe" });
    const { value } = JSON.parse(readFileSync(join(out, "cache/convergence.json"), "utf8"));
    const apart = psnr - value.steps.at(-1).psnr_view;
    console.log(`  ${check(`page ${psnr.toFixed(4)} dB, command ${(psnr - apart).toFixed(4)} dB (limit ${LIMITS.command} apart)`, Math.abs(apart) <= LIMITS.command)}`);
  }
  await page.context().close();
}
await browser.close();
server.close();
if (missed > 0) process.exitCode = 1;
