// The page that solves (`solve.html`): its patterns, its saved files, and its errors agree with the
// patterns, files and errors of the command.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { appendFileSync, cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { DIST, launch, open, pixels, SHOTS } from "./browser.mjs";
import { serve } from "./server.mjs";
import { apart, BIN, plain, problem, refusal, save, stage } from "./solving.mjs";
import { stripes } from "./stripes.mjs";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const SCENES = join(dirname(fileURLToPath(import.meta.url)), "../../scenes");
/**
 * Largest root mean square difference between the patterns of the page and of the command. It is
 * above 0, since page and command use different instructions of the processor, and the command
 * rounds views when it caches them.
 */
const SAME = 2e-3;
/** Largest difference between the PSNR that the page reports and the PSNR that the command reports, dB. */
const SAME_DB = 0.01;
/** Largest difference of a seen picture in codes, since the page shows patterns of 8 bits and the command simulates unrounded patterns. */
const ROUNDING = 3;

let browser;
let server;
let folder;
before(async () => {
  browser = await launch();
  server = await serve({ "/": DIST });
  folder = mkdtempSync(join(tmpdir(), "lumistack-solve-"));
  mkdirSync(SHOTS, { recursive: true });
});
after(async () => {
  await browser?.close();
  await server?.close();
  if (folder) rmSync(folder, { recursive: true });
});

const page = (hash, options) => open(browser, hash.startsWith("http") ? hash : `${server.url}/solve.html${hash}`, options);
const shot = (at, name) => at.screenshot({ path: join(SHOTS, `solve-${name}.png`), fullPage: true });

/** Saves a quilt, and compares its first and last tiles with the viewer's pictures from the same slopes. */
async function savedQuilt(at) {
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#quilt")]);
  assert.equal(download.suggestedFilename(), "letters_qs8x6a1.6.png");
  const views = await at.evaluate(async (bytes) => {
    const picture = await createImageBitmap(await (await fetch(`data:image/png;base64,${bytes}`)).blob());
    const context = new OffscreenCanvas(picture.width, picture.height).getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    const [width, height] = [picture.width / 8, picture.height / 6];
    // View 0 is at the bottom left, view 47 at the top right.
    return { width, height, tiles: [[0, 5], [7, 0]].map(([col, row]) => [...context.getImageData(col * width, row * height, width, height).data]) };
  }, readFileSync(await download.path(), "base64"));
  assert.deepEqual([views.width, views.height], [96, 60]);
  // The viewing zone is divided into 48 parts, one for each view. The outermost views are half a
  // part inside the zone's edge.
  const { slope_x, slope_y } = await at.evaluate(() => JSON.parse(document.querySelector("lumistack-viewer").content.json).target);
  const step = slope_x[1] - slope_x[0];
  const edge = slope_x.at(-1) + step / 2 - (step * slope_x.length) / 96;
  for (const [tile, side] of views.tiles.map((tile, i) => [tile, [-1, 1][i]])) {
    const shown = await pixels(at, [side * edge, slope_y[Math.floor((slope_y.length - 1) / 2)]]);
    assert.equal(tile.length, shown.data.length);
    assert.ok(tile.every((code, i) => Math.abs(code - shown.data[i]) <= 1), `the view of side ${side}`);
  }
}

/** Saves a video of a turn, and checks that the video plays. */
async function savedTurn(at) {
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#turn")]);
  assert.match(download.suggestedFilename(), /^letters_turn\.(webm|mp4)$/);
  const [width, height] = await at.evaluate(
    async ([type, bytes]) => {
      const video = document.createElement("video");
      video.muted = true;
      video.src = URL.createObjectURL(await (await fetch(`data:${type};base64,${bytes}`)).blob());
      await video.play();
      return [video.videoWidth, video.videoHeight];
    },
    [`video/${download.suggestedFilename().split(".").at(-1)}`, readFileSync(await download.path(), "base64")],
  );
  assert.ok(width >= 960 && Math.abs(width / height - 1.6) < 0.02, `${width} × ${height}`);
}

test("a built-in scene becomes the patterns that the command makes", { skip: !BIN && "LUMISTACK_BIN is not set" }, async () => {
  const at = await page("#scene=letters&preset=paper-three-layer&cols=96&frames=3&zone_samples=100&iterations=6&device=cpu&threads=2");
  await stage(at, "done");
  const psnr = Number(await at.evaluate(() => document.documentElement.dataset.psnr));
  const run = await save(at, join(folder, "letters"));
  assert.match(execFileSync(BIN, ["info", run], { encoding: "utf8" }), /96/);

  // The picture that the viewer shows agrees with the command's simulation of the saved patterns.
  await at.waitForFunction(() => !document.querySelector("main").classList.contains("idle"));
  const slope = [3, -2].map((degrees) => Math.tan((degrees * Math.PI) / 180));
  const shown = await pixels(at, slope);
  const png = join(folder, "view.png");
  execFileSync(BIN, ["simulate", run, "--view", "3,-2", "-o", png]);
  const simulated = await at.evaluate(async (bytes) => {
    const picture = await createImageBitmap(await (await fetch(`data:image/png;base64,${bytes}`)).blob());
    const context = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
    context.drawImage(picture, 0, 0);
    return [...context.getImageData(0, 0, picture.width, picture.height).data];
  }, readFileSync(png, "base64"));
  assert.equal(shown.data.length, simulated.length);
  const far = simulated.filter((code, i) => Math.abs(code - shown.data[i]) > ROUNDING).length;
  assert.ok(far < 0.01 * simulated.length, `${far} of ${simulated.length} values differ`);

  // The command computes the same patterns from the saved job.
  for (const name of ["letters.gltf", "letters.bin", "charts.png", "graph-paper.png", "sky.hdr"]) cpSync(join(SCENES, "letters", name), join(run, name));
  const out = join(folder, "command");
  // The command's own score of the display would take longer than the patterns.
  appendFileSync(join(run, "job.toml"), "\n[report]\nzone_directions = 0\n");
  execFileSync(BIN, ["run", join(run, "job.toml"), "-o", out], { stdio: "pipe" });
  const difference = apart(run, out);
  const { value: curve } = JSON.parse(readFileSync(join(out, "cache/convergence.json"), "utf8"));
  const command = curve.steps.at(-1).psnr_view;
  console.log(`page ${psnr.toFixed(4)} dB, command ${command.toFixed(4)} dB, patterns differ by ${difference.toExponential(1)}`);
  assert.ok(difference < SAME, `${difference}`);
  assert.ok(Math.abs(psnr - command) < SAME_DB, `${psnr} and ${command}`);
  // Another page solves with the settings of the copied link, and computes the same patterns.
  await at.click("#link");
  await at.waitForFunction(() => /link is|copied/i.test(document.querySelector("#link").textContent));
  const address = at.url();
  const asked = (text) => Object.fromEntries(new URLSearchParams(new URL(text).hash.slice(1)));
  const wanted = { scene: "letters", preset: "paper-three-layer", cols: "96", layers: "3", gap_mm: "40", frames: "3", brightness: "0.2", zone_samples: "100", iterations: "6", device: "cpu", threads: "2" };
  assert.deepEqual(asked(address), wanted);
  const other = await page(address);
  await stage(other, "done");
  assert.equal(await other.evaluate(() => document.documentElement.dataset.psnr), String(psnr));
  assert.match(await other.textContent("#status"), /On the processor: the address of this page chooses the processor/);
  await other.click("#link");
  assert.deepEqual(asked(other.url()), wanted);
  for (const each of [at, other]) {
    assert.deepEqual(each.trouble, []);
    await each.context().close();
  }
});

test("the page shows intermediate patterns, stops, continues, and solves for another display", async () => {
  const at = await page("#preset=paper-three-layer&cols=96&frames=2&zone_samples=400&iterations=2");
  await shot(at, "empty");
  await at.click("text=Letters");
  await at.waitForFunction(() => performance.getEntriesByName("lumistack-first-patterns").length > 0);
  await at.click("#pause");
  await at.waitForFunction(() => /Stopped/.test(document.querySelector("#status").textContent));
  const share = await at.evaluate(() => document.querySelector("#bar").value);
  await at.waitForTimeout(400);
  assert.equal(await at.evaluate(() => document.querySelector("#bar").value), share, "the work continued although it was stopped");
  await shot(at, "stopped");
  await at.click("#pause");
  await stage(at, "done");
  const before = await pixels(at, [0, 0]);
  assert.ok(before.data.some((value, i) => i % 4 < 3 && value > 60), "the picture is dark");
  await shot(at, "done");
  await savedQuilt(at);
  await savedTurn(at);
  await at.evaluate(() => {
    document.documentElement.dataset.stage = "";
    const frames = document.querySelector("#frames");
    frames.value = "3";
    frames.dispatchEvent(new Event("input"));
  });
  await stage(at, "done");
  await at.click("#closer");
  await at.waitForFunction(() => /3/.test(document.querySelector("lumistack-viewer").shadowRoot.querySelector("#caption").textContent));
  await shot(at, "apart");
  assert.deepEqual(at.trouble, []);
  await at.context().close();
});

test("a broken file gives the command's error, and the page stays usable", { skip: !BIN && "LUMISTACK_BIN is not set" }, async () => {
  const at = await page("#cols=96");
  const broken = {
    "short.glb": Buffer.from("glTF\u0002\0\0\0\u0040\0\0\0", "latin1"),
    "words.gltf": Buffer.from("no JSON at all"),
    "wrong.gltf": Buffer.from('{"asset": {"version": "2.0"}, "scenes": [{"nodes": [7]}], "scene": 0}'),
    "cut.ply": readFileSync(join(SCENES, "dandelion/dandelion.spz")).subarray(0, 100),
  };
  for (const [name, bytes] of Object.entries(broken)) {
    writeFileSync(join(folder, name), bytes);
    await at.setInputFiles("#files", { name, mimeType: "application/octet-stream", buffer: bytes });
    await at.waitForFunction((name) => document.querySelector("#problem").textContent.includes(name), name);
    const said = await problem(at);
    const { status, message } = refusal(folder, "info", name);
    assert.equal(status, 1);
    assert.ok(message.includes(plain(said)), `page: ${said}\ncommand: ${message}`);
  }
  // If a picture is cut short, the module of decoders reports the error, and not the solver's
  // module.
  const letters = join(folder, "cut");
  cpSync(join(SCENES, "letters"), letters, { recursive: true });
  writeFileSync(join(letters, "charts.png"), readFileSync(join(SCENES, "letters/charts.png")).subarray(0, 400));
  await at.setInputFiles("#files", ["letters.gltf", "letters.bin", "charts.png", "graph-paper.png", "sky.hdr"].map((name) => join(letters, name)));
  await at.waitForFunction(() => document.querySelector("#problem").textContent.includes("letters.gltf"));
  const said = await problem(at);
  const { message } = refusal(letters, "info", "letters.gltf");
  assert.ok(message.includes(plain(said)), `page: ${said}\ncommand: ${message}`);
  assert.match(said, /readable PNG/);
  await shot(at, "broken");
  await at.setInputFiles("#files", { name: "words.txt", mimeType: "text/plain", buffer: Buffer.from("a") });
  assert.match(await problem(at), /nothing to solve in this file.*Drop a \.glb/);
  await at.evaluate(() => (location.hash = ""));
  await at.click("text=Dandelion");
  await at.waitForFunction(() => performance.getEntriesByName("lumistack-first-patterns").length > 0);
  assert.ok(await at.isHidden("#problem"));
  await at.context().close();
});

test("patterns of light fields agree with those of the command", { skip: !BIN && "LUMISTACK_BIN is not set" }, async () => {
  const array = join(folder, "stripes.npy");
  stripes(array);
  const at = await page("#preset=paper-three-layer&cols=96&frames=2&iterations=5");
  const solved = async (choose, name) => {
    await at.evaluate(() => (document.documentElement.dataset.stage = ""));
    await choose();
    await stage(at, "done");
    assert.ok(await at.isHidden("#problem"));
    return save(at, join(folder, name));
  };
  const ours = await solved(() => at.setInputFiles("#files", array), "array");
  assert.match(await at.textContent("#caption"), /^stripes 3 layers, 2 frames/);
  await shot(at, "array");
  cpSync(array, join(ours, "stripes.npy"));
  const command = join(folder, "array-command");
  execFileSync(BIN, ["run", join(ours, "job.toml"), "-o", command], { stdio: "pipe" });
  assert.ok(apart(ours, command) < SAME, `${apart(ours, command)}`);
  // The command wrote the light field as OpenEXR pictures with rounded values. So the tolerance for
  // this folder is larger.
  const views = join(folder, "array-views");
  cpSync(join(command, "target"), views, { recursive: true });
  const again = await solved(() => at.setInputFiles("#folder", views), "views");
  assert.match(readFileSync(join(again, "job.toml"), "utf8"), /light_field = "array-views"/);
  assert.ok(apart(again, ours) < 0.01, `${apart(again, ours)}`);
  // The page also solves the quilt of 48 views that it saves itself.
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#quilt")]);
  const quilt = join(folder, download.suggestedFilename());
  await download.saveAs(quilt);
  const third = await solved(() => at.setInputFiles("#files", quilt), "quilt");
  cpSync(quilt, join(third, download.suggestedFilename()));
  const known = join(folder, "quilt-command");
  execFileSync(BIN, ["run", join(third, "job.toml"), "-o", known], { stdio: "pipe" });
  assert.ok(apart(third, known) < SAME, `${apart(third, known)}`);

  // A damaged light field gives the same error as in the command.
  const few = join(folder, "few");
  mkdirSync(few);
  writeFileSync(join(few, "cut.npy"), readFileSync(array).subarray(0, 5000));
  writeFileSync(join(few, "flat.npy"), Buffer.concat([Buffer.from("\x93NUMPY\x01\x00v\x00", "latin1"), Buffer.from("{'descr': '<i4', 'fortran_order': False, 'shape': (2, 2), }".padEnd(117) + "\n"), Buffer.alloc(16)]));
  writeFileSync(join(few, "plain.png"), readFileSync(join(SCENES, "letters/charts.png")));
  writeFileSync(join(few, "cut_qs2x2.png"), readFileSync(join(SCENES, "letters/charts.png")).subarray(0, 400));
  for (const name of ["cut.npy", "flat.npy", "plain.png", "cut_qs2x2.png"]) {
    await at.setInputFiles("#files", join(few, name));
    await at.waitForFunction((name) => document.querySelector("#problem").textContent.includes(name), name);
    const said = await problem(at);
    const { status, message } = refusal(few, "factorize", name, "-o", join(few, "run"));
    assert.notEqual(status, 0, name);
    assert.ok(message.includes(plain(said)), `page: ${said}\ncommand: ${message}`);
  }
  assert.deepEqual(at.trouble, []);
  await at.context().close();
});

test("axe finds no violation on a desk, on a phone, on a tablet, at 200 % and in forced colours, and nothing is cut off", async () => {
  for (const [name, options] of [
    ["desk", { colorScheme: "light" }],
    ["phone", { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 }],
    ["tablet", { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true }],
    ["zoom-200", { viewport: { width: 720, height: 450 } }],
    ["forced", { forcedColors: "active", colorScheme: "light" }],
    ["forced-dark", { forcedColors: "active", colorScheme: "dark" }],
  ]) {
    const at = await page("#scene=dandelion&preset=paper-three-layer&cols=96&frames=2&zone_samples=30&iterations=1", options);
    await stage(at, "done");
    assert.deepEqual(at.trouble, [], name);
    await at.evaluate(AXE);
    const { violations } = await at.evaluate(() => window.axe.run());
    assert.deepEqual(
      violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html).join(" ")}`),
      [],
      name,
    );
    await shot(at, name);
    const over = await at.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(over <= 0, `${name}: the page is ${over} pixels too wide`);
    // Unfold the sliders; then the Tab key reaches every control.
    await at.focus("#built summary");
    await at.keyboard.press("Enter");
    await at.evaluate(() => document.activeElement.blur());
    const reached = new Set();
    for (let i = 0; i < 30; i++) {
      await at.keyboard.press("Tab");
      reached.add(await at.evaluate(() => document.activeElement.id || document.activeElement.textContent));
    }
    for (const id of ["choose", "preset", "cols", "layers", "gap_mm", "frames", "brightness", "save", "quilt", "turn", "link", "closer"]) assert.ok(reached.has(id), `${name}: ${id} is not among ${[...reached].join(", ")}`);
    // Every control can be scrolled into view, and is then inside the window.
    for (const id of ["choose", "preset", "brightness", "bar", "link"]) {
      const inside = await at.evaluate((id) => {
        const element = document.getElementById(id);
        element.scrollIntoView({ block: "nearest" });
        const { left, right, top, bottom } = element.getBoundingClientRect();
        return left >= 0 && right <= innerWidth && top >= -1 && bottom <= innerHeight + 1;
      }, id);
      assert.ok(inside, `${name}: ${id} is cut off`);
    }
    assert.deepEqual(at.trouble, []);
    await at.context().close();
  }
});
