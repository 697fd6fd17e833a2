// `lumistack live`: the page follows commands and files without a reload, and Ctrl-C leaves a run
// folder. LUMISTACK_BIN names the program.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";
import { launch, open, pixels, SHOTS } from "./browser.mjs";

const BINARY = process.env.LUMISTACK_BIN;
const skip = !BINARY && "LUMISTACK_BIN is not set (`cargo xtask web test` sets it)";
/** Longest wait for a picture, milliseconds. It is long, since the machine may compile meanwhile. */
const PATIENCE_MS = 60_000;
/** Options of a small display, so that the tests are quick. */
const SMALL = ["--resolution", "64x40", "--frames", "2", "--views", "3x3", "--zone-samples", "36"];

const folder = mkdtempSync(join(tmpdir(), "lumistack-live-"));
const scene = join(folder, "card.gltf");
const run = join(folder, "run");
const states = [];
let browser;
let live;
let address;

/** Returns a glTF document with a card that emits light of one colour. */
function card(red, green, blue) {
  const corners = new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0]);
  const data = Buffer.from(corners.buffer).toString("base64");
  return JSON.stringify({
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0, 1] }],
    nodes: [{ mesh: 0 }, { camera: 0, translation: [0, 0, 4] }],
    cameras: [{ type: "perspective", perspective: { yfov: 0.8, aspectRatio: 1.6, znear: 0.1 } }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, material: 0 }] }],
    materials: [{ emissiveFactor: [red, green, blue], pbrMetallicRoughness: { baseColorFactor: [0, 0, 0, 1] }, doubleSided: true }],
    accessors: [{ bufferView: 0, componentType: 5126, count: 6, type: "VEC3", min: [-1, -1, 0], max: [1, 1, 0] }],
    bufferViews: [{ buffer: 0, byteLength: 72 }],
    buffers: [{ byteLength: 72, uri: `data:application/octet-stream;base64,${data}` }],
  });
}

before(async () => {
  if (skip) return;
  browser = await launch();
  writeFileSync(scene, card(1, 0, 0));
  live = spawn(BINARY, ["--json", "live", scene, "-o", run, "--no-open", "--lights-visible", "--tone", "linear", "--fit-depth=off", ...SMALL], {
    stdio: ["pipe", "pipe", "inherit"],
  });
  const lines = createInterface({ input: live.stdout });
  await new Promise((resolve, reject) => {
    live.on("exit", (code) => reject(new Error(`ended with ${code} before it served a page`)));
    lines.on("line", (line) => {
      const event = JSON.parse(line);
      if (event.event === "serving") resolve((address = event.address));
      else states.push(event);
    });
  });
});
after(async () => {
  await browser?.close();
  live?.kill("SIGKILL");
  rmSync(folder, { recursive: true });
});

const say = (command) => live.stdin.write(`${JSON.stringify(command)}\n`);
/** Returns red, green and blue of the picture's middle pixel. */
const middle = async (page) => {
  const { width, height, data } = await pixels(page, [0, 0]);
  return [...data.subarray(4 * (Math.floor(height / 2) * width + Math.floor(width / 2)))].slice(0, 3);
};
async function until(what, is) {
  for (const end = Date.now() + PATIENCE_MS; Date.now() < end; await new Promise((resolve) => setTimeout(resolve, 100))) if (await is()) return;
  assert.fail(`the time is over without ${what}`);
}

test("the page follows files and commands without a reload", { skip }, async () => {
  const page = await open(browser, address);
  await page.evaluate(() => (window.same = true));
  const number = () => page.evaluate(() => Number(document.querySelector("lumistack-viewer").dataset.state ?? 0));
  await until("a first state", async () => (await number()) > 0);
  await until("a red card", async () => {
    const [red, green] = await middle(page);
    return red > 120 && green < 80;
  });
  mkdirSync(SHOTS, { recursive: true });
  await page.screenshot({ path: join(SHOTS, "live-red.png") });

  const first = await number();
  writeFileSync(scene, card(0, 1, 0));
  await until("a green card", async () => {
    const [red, green] = await middle(page);
    return green > 120 && red < 80;
  });
  assert.ok((await number()) > first);
  await page.screenshot({ path: join(SHOTS, "live-green.png") });

  // A file that cannot be read gives a message, and the patterns stay.
  const words = () => page.locator(".live p").textContent();
  await until("no message", async () => (await words()) === "Live");
  writeFileSync(scene, card(1, 0, 0).slice(0, -40));
  await until("a message about the file", async () => (await words()).includes("card.gltf"));
  const [red, green] = await middle(page);
  assert.ok(green > 120 && red < 80);
  await page.screenshot({ path: join(SHOTS, "live-broken.png") });
  writeFileSync(scene, card(0, 1, 0));
  await until("no message about the file", async () => (await words()) === "Live");

  say({ set: { "light.background": "#0000ff" } });
  await until("a blue background", async () => {
    const { data } = await pixels(page, [0, 0]);
    return data[4 * 64 * 2 + 2] > 100 || data[2] > 100;
  });
  say({ set: { "display.frames": 3 } });
  await until("another display", () => states.some((event) => event.event === "state" && event.start === "fresh" && event.number > first));
  await until("its page", async () => (await page.evaluate(() => document.querySelector("lumistack-viewer").shadowRoot.textContent)).includes("3 frames"));
  say({ set: { "display.frame": 3 } });
  await until("an error about the unknown key", () => states.some(({ event, message }) => event === "refused" && message.includes("did you mean `frames`?")));
  assert.equal(await page.evaluate(() => window.same), true, "the page was reloaded");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the view acts as a tracked head while the switch is on", { skip }, async () => {
  const page = await open(browser, address);
  const zone = () => states.findLast(({ event }) => event === "state").zone;
  await until("a state", async () => (await page.evaluate(() => Number(document.querySelector("lumistack-viewer").dataset.state ?? 0))) > 0);
  assert.equal(zone(), 1);
  const box = await page.locator("lumistack-viewer #stage").boundingBox();
  await page.mouse.move(box.x + 0.7 * box.width, box.y + 0.4 * box.height);
  await new Promise((resolve) => setTimeout(resolve, 1000));
  assert.equal(zone(), 1, "the view moved the viewer before the switch was on");
  await page.getByLabel("The display follows my view").check();
  await until("rays near the view", () => zone() === 0);
  // A view that does not move still counts as a tracked head, even after the time limit for
  // silent trackers.
  await new Promise((resolve) => setTimeout(resolve, 2500));
  assert.equal(zone(), 0);
  await page.screenshot({ path: join(SHOTS, "live-follows.png") });
  // The key F turns the switch off.
  await page.keyboard.press("f");
  assert.equal(await page.getByLabel("The display follows my view").isChecked(), false);
  await until("the whole zone", () => zone() === 1);
  await page.keyboard.press("f");
  await until("rays near the view again", () => zone() === 0);
  // A closed page has no view, so the whole zone has weight 1 again.
  await page.close();
  await until("the whole zone again", () => zone() === 1);
  assert.deepEqual(page.trouble, []);
});

test("states have rising numbers, and Ctrl-C leaves a run folder", { skip }, async () => {
  const page = await open(browser, address);
  const words = () => page.locator(".live p").textContent();
  await until("a live page", async () => (await words()) === "Live");
  const started = Date.now();
  const ended = new Promise((resolve) => live.once("exit", (code) => resolve(code)));
  live.kill("SIGINT");
  assert.equal(await ended, 0);
  console.log(`ended with its report after ${Date.now() - started} ms`);
  await until("a message about the end of the program", async () => (await words()).includes("does not answer"));
  await page.screenshot({ path: join(SHOTS, "live-ended.png") });
  await page.context().close();
  const numbers = states.filter(({ event }) => event === "state").map(({ number }) => number);
  assert.deepEqual(numbers, numbers.map((_, i) => i + 1));
  for (const file of ["job.toml", "display.toml", "layers/stack.json", "target/lightfield.json", "report.html", "report.json"]) assert.ok(existsSync(join(run, file)), file);
  assert.ok(JSON.parse(readFileSync(join(run, "report.json"), "utf8")).psnr_view > 20);
  assert.match(readFileSync(join(run, "job.toml"), "utf8"), /frames = 3/);
});
