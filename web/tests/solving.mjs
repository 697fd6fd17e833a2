// Helpers of the tests of the page that solves: its state, its saved files, and the command's
// errors.
import { spawnSync } from "node:child_process";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { npy, unpacked } from "./saved.mjs";

export const BIN = process.env.LUMISTACK_BIN;

/** Waits until the page has reached a stage of the work. */
export const stage = (at, name) => at.waitForFunction((name) => document.documentElement.dataset.stage === name, name);

/** Returns the page's message, once there is one. */
export async function problem(at) {
  await at.waitForSelector("#problem:not([hidden])");
  return at.textContent("#problem");
}

/** Saves the patterns, and unpacks the zip into the folder `run`. */
export async function save(at, run) {
  const [download] = await Promise.all([at.waitForEvent("download"), at.click("#save")]);
  for (const [path, bytes] of unpacked(readFileSync(await download.path()))) {
    mkdirSync(dirname(join(run, path)), { recursive: true });
    writeFileSync(join(run, path), bytes);
  }
  return run;
}

/** Returns the root mean square difference between the patterns of two runs. */
export function apart(a, b) {
  let [squares, count] = [0, 0];
  for (let layer = 0; layer < 3; layer++) {
    const [ours, theirs] = [a, b].map((from) => npy(readFileSync(join(from, `layers/layer_${layer}.npy`))));
    if (ours.length !== theirs.length) return Infinity;
    for (let i = 0; i < ours.length; i++) squares += (ours[i] - theirs[i]) ** 2;
    count += ours.length;
  }
  return Math.sqrt(squares / count);
}

/** Runs the command in a folder. Returns its exit status, and its message without line breaks. */
export function refusal(folder, ...words) {
  const { stderr, status } = spawnSync(BIN, words, { cwd: folder, encoding: "utf8" });
  return { status, message: plain(stderr) };
}

/** Returns a text with single spaces in place of line breaks. */
export const plain = (text) => text.replace(/\s+/g, " ");
