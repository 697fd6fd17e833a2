// Parts of the page that need no browser: the state in the address, names of views, the motion of
// the eye, slopes of a quilt.
import assert from "node:assert/strict";
import { join } from "node:path";
import { test } from "node:test";
import { build } from "esbuild";
import { DIST } from "./browser.mjs";

async function source(name) {
  const { outputFiles } = await build({ entryPoints: [join(DIST, "../src", name)], bundle: true, write: false, format: "esm", logLevel: "silent" });
  return import(`data:text/javascript;base64,${Buffer.from(outputFiles[0].contents).toString("base64")}`);
}

test("an address restores its state", async () => {
  const { DEFAULTS, fromHash, toHash } = await source("state.ts");
  assert.equal(toHash(DEFAULTS, undefined), "");
  assert.deepEqual(fromHash(""), { state: { ...DEFAULTS }, slope: undefined });
  const state = { ...DEFAULTS, mode: "layers", comparison: "error", gain: 1.25, gapMm: -0.5, shiftXMm: 0.125, pupilMm: 4, frame: 3, layer: 2, rate: 0.5, playing: false, swing: false, yaw: 1.2 };
  const back = fromHash(`#${toHash(state, [0.1, -0.2])}`);
  assert.deepEqual(back, { state, slope: [0.1, -0.2] });
});

test("invalid values in an address are ignored, and others are limited to their range", async () => {
  const { DEFAULTS, fromHash } = await source("state.ts");
  const { state, slope } = fromHash("#mode=x&split=9&pupil=-1&gap=abc&frame=2.4&x=&rate=Infinity&gain=0");
  assert.deepEqual(state, { ...DEFAULTS, split: 1, frame: 2 });
  assert.equal(slope, undefined);
});

test("names of views determine their order", async () => {
  const { gridOf } = await source("drop.ts");
  const grid = (names) => gridOf(names.map((name) => [`some/folder/${name}`, name])).map((row) => row.join(" "));
  assert.deepEqual(grid(["view_01_00.png", "view_00_01.png", "view_00_00.png", "view_01_01.png"]), ["view_00_00.png view_00_01.png", "view_01_00.png view_01_01.png"]);
  assert.deepEqual(grid(["out_00_01_-3.5_2.1_.png", "out_00_00_-3.5_9.9_.png", "out_00_02_1_1_.png"]), ["out_00_00_-3.5_9.9_.png out_00_01_-3.5_2.1_.png out_00_02_1_1_.png"]);
  const cams = Array.from({ length: 9 }, (_, i) => `input_Cam${String(i).padStart(3, "0")}.png`);
  assert.deepEqual(grid([...cams].reverse()), [cams.slice(0, 3).join(" "), cams.slice(3, 6).join(" "), cams.slice(6).join(" ")]);
  // Three is not a square number, so these views form one row, in the order of their numbers.
  assert.deepEqual(grid(["frame10.jpg", "frame9.jpg", "frame11.jpg"]), ["frame9.jpg frame10.jpg frame11.jpg"]);
  // The names state an incomplete grid, so the views form one row.
  assert.deepEqual(grid(["view_0_0.png", "view_0_1.png", "view_1_0.png"]), ["view_0_0.png view_0_1.png view_1_0.png"]);
  // The third and the fourth name state the same view.
  const message = "some/folder/view_1_0.jpg and some/folder/view_01_00.png are both named as the view in row 1, column 0; expected one picture per view.";
  assert.throws(() => grid(["view_0_0.png", "view_0_1.png", "view_1_0.jpg", "view_01_00.png"]), { message });
  // The text before these numbers differs, so the pictures are different views.
  assert.deepEqual(grid(["a_1_0.png", "b_1_0.png"]), ["a_1_0.png b_1_0.png"]);
});

test("the eye reaches its goal with little overshoot, comes to rest, and stays within its limit", async () => {
  const { Motion, REACH } = await source("motion.ts");
  const motion = new Motion();
  motion.swing = false;
  motion.setZone([0.2, 0.1]);
  motion.lookTo([0.1, -5]);
  let most = 0;
  for (let n = 0; n < 300; n++) {
    motion.step(1 / 60);
    most = Math.max(most, motion.slope[0]);
  }
  assert.deepEqual(motion.slope, [0.1, -0.1 * REACH]);
  assert.equal(motion.active, false);
  assert.ok(most < 0.102, `it went to ${most}`);
});

test("the swing begins at the eye's position, stays in the zone, and ends when the user moves the view", async () => {
  const { Motion } = await source("motion.ts");
  const motion = new Motion();
  motion.setZone([0.2, 0.1]);
  let last = motion.slope;
  let furthest = [0, 0];
  for (let n = 0; n < 60 * 30; n++) {
    motion.step(1 / 60);
    const slope = motion.slope;
    for (const i of [0, 1]) {
      assert.ok(Math.abs(slope[i] - last[i]) < 0.01, "it jumps");
      furthest[i] = Math.max(furthest[i], Math.abs(slope[i]));
    }
    last = slope;
  }
  assert.ok(furthest[0] > 0.1 && furthest[0] < 0.2 && furthest[1] < 0.1, `it went to ${furthest}`);
  motion.lookTo([0, 0]);
  for (let n = 0; n < 180; n++) motion.step(1 / 60);
  assert.deepEqual(motion.slope, [0, 0]);
});

test("a recorded turn begins and ends at the left, and the eye returns to its position", async () => {
  const { Motion } = await source("motion.ts");
  const motion = new Motion();
  motion.swing = false;
  motion.setZone([0.2, 0.1]);
  motion.standAt([0.05, 0.02]);
  motion.startTurn(2);
  const start = motion.slope;
  assert.ok(start[0] < -0.1);
  let right = 0;
  for (let n = 0; n < 8; n++) {
    motion.step(0.25);
    right = Math.max(right, motion.slope[0]);
  }
  assert.ok(right > 0.1, `it went to ${right}`);
  assert.ok(Math.hypot(motion.slope[0] - start[0], motion.slope[1] - start[1]) < 1e-9);
  for (let n = 0; n < 180; n++) motion.step(1 / 60);
  assert.deepEqual(motion.slope, [0.05, 0.02]);
});

test("if the user prefers less motion, the view jumps to its goal", async () => {
  const { Motion } = await source("motion.ts");
  const motion = new Motion();
  motion.calm = true;
  motion.swing = false;
  motion.setZone([0.2, 0.1]);
  motion.lookTo([0.1, 0.05]);
  assert.deepEqual(motion.slope, [0.1, 0.05]);
  // After a recorded turn, the view also jumps.
  motion.startTurn(2);
  motion.step(2);
  assert.deepEqual(motion.slope, [0.1, 0.05]);
  assert.equal(motion.active, false);
});

test("the contact sheet draws the thumbnails of the last call, and changed patterns again", async (t) => {
  const { Sheet } = await source("sheet.ts");
  const drawn = [];
  // Elements with the members that the sheet uses.
  const element = () => {
    const made = { style: {}, setAttribute() {}, addEventListener() {}, replaceChildren() {}, scrollIntoView() {} };
    made.append = (child) => (made.firstElementChild ??= child);
    made.getContext = () => ({ drawImage: (picture) => drawn.push(picture.name) });
    return made;
  };
  globalThis.document = { createElement: element };
  t.after(() => delete globalThis.document);
  const waiting = [];
  let patterns = "old";
  const mask = (layer, frame) => new Promise((resolve) => waiting.push(() => resolve({ name: `${patterns} ${frame}`, width: 1, height: 1, close() {} })));
  const answer = async () => {
    waiting.shift()?.();
    await new Promise((resolve) => setImmediate(resolve));
  };
  const info = { layers: [{ d_mm: 0, cols: 2, rows: 2 }], frames: 2, directional: false };
  const sheet = new Sheet(element(), () => undefined);
  sheet.setUp(mask, info);
  sheet.show(0, 0, [0]);
  sheet.show(0, 0, [0, 1]);
  for (let n = 0; n < 3; n++) await answer();
  assert.deepEqual(drawn.splice(0), ["old 0", "old 1"]);
  // Patterns change while the sheet waits for an old thumbnail.
  sheet.forget();
  sheet.show(0, 0, [0, 1]);
  await answer();
  sheet.forget();
  patterns = "new";
  sheet.show(0, 0, [0, 1]);
  for (let n = 0; n < 5; n++) await answer();
  assert.deepEqual(drawn.splice(0).slice(-2).sort(), ["new 0", "new 1"]);
  // A stack that is removed while the sheet waits for its thumbnail never answers.
  sheet.forget();
  sheet.show(0, 0, [0]);
  waiting.length = 0;
  sheet.clear();
  sheet.setUp(mask, info);
  sheet.show(0, 0, [0]);
  await answer();
  assert.deepEqual(drawn, ["new 0"]);
});

test("each view of a quilt is at the centre of its part of the zone", async () => {
  const { slopesAcross } = await source("quilt.ts");
  const across = [-0.2, -0.1, 0, 0.1, 0.2];
  const slopes = [0.1, 0, -0.1].flatMap((y) => across.map((x) => [x, y]));
  const near = (found, expected) => found.forEach(([x, y], i) => assert.ok(Math.abs(x - expected[i]) < 1e-12 && y === 0, `${x} ${y}`));
  // With as many views as the target has per row, the slopes of the quilt equal the slopes of the
  // target's views.
  near(slopesAcross({ views: { rows: 3, cols: 5, slopes } }, 5), across);
  near(slopesAcross({ views: { rows: 3, cols: 5, slopes } }, 2), [-0.125, 0.125]);
  // With more views, the outermost slopes of the quilt are farther out than the outermost slopes of
  // the target.
  near(slopesAcross({ views: { rows: 3, cols: 5, slopes } }, 10), across.flatMap((x) => [x - 0.025, x + 0.025]));
  near(slopesAcross({ views: { rows: 1, cols: 1, slopes: [[0, 0]] } }, 2), [0, 0]);
});
