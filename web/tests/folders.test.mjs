// Opens folders by real drag and drop of the browser, and by its dialog for folders.
import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { complete, launch, open, pixels, site, text } from "./browser.mjs";
import { png, twoSquares } from "./fixture.mjs";

const folder = mkdtempSync(join(tmpdir(), "lumistack-folders-"));
let browser;
let server;
let page;
before(async () => {
  browser = await launch();
  server = await site(new Map([...twoSquares()]));
  page = await open(browser, server.url);
  await complete(page);
});
after(async () => {
  await browser?.close();
  await server?.close();
  rmSync(folder, { recursive: true });
});

/** Writes files into a new folder; returns the folder's path. */
function write(name, files) {
  for (const [path, bytes] of files) {
    mkdirSync(dirname(join(folder, name, path)), { recursive: true });
    writeFileSync(join(folder, name, path), bytes);
  }
  return join(folder, name);
}

/** Drops files and folders of the disk on the picture. */
async function drop(...paths) {
  const mouse = await page.context().newCDPSession(page);
  const data = { items: [], files: paths, dragOperationsMask: 1 };
  const send = (type) => mouse.send("Input.dispatchDragEvent", { type, x: 500, y: 400, data });
  await send("dragEnter");
  await send("dragOver");
  assert.ok(await text(page, "#drop"), "the invitation to drop is missing");
  await send("drop");
  await page.waitForTimeout(700);
  assert.equal(await text(page, "#drop"), undefined, "the invitation to drop stays");
}

/** Returns the files of a run folder with patterns and a preview. */
function run(title) {
  const preview = JSON.parse(twoSquares().get("stack/preview.json").toString());
  const files = new Map([["report.html", "<p>report"], ["job.toml", ""], ["layers/stack.json", "{}"], ["target/view_00_00.exr", "x"]]);
  for (const [path, bytes] of twoSquares()) files.set(`outputs/tensor-display/web_simulator/${path}`, bytes);
  files.set("outputs/tensor-display/images/layer_0_frame_00.png", png(4, 4, () => [0, 0, 0]));
  files.set("outputs/tensor-display/web_simulator/stack/preview.json", JSON.stringify({ ...preview, title }));
  return files;
}

const colourAt = ({ width, height, data }) => [...data.subarray(((height >> 1) * width + (width >> 1)) * 4).subarray(0, 3)];
const near = (found, wanted) => assert.ok(found.every((v, i) => Math.abs(v - wanted[i]) <= 3), `${found}, expected ${wanted}`);

test("a run's folder, dropped", async () => {
  await drop(write("run", run("A run")));
  assert.equal(await complete(page), undefined);
  assert.equal(await text(page, "#title"), "A run");
  const { data } = await pixels(page, [0.1, 0]);
  assert.ok(new Set(data.filter((_, i) => i % 4 !== 3)).size > 1);
  assert.deepEqual(page.trouble, []);
});

test("the preview's folder, dropped", async () => {
  const preview = JSON.parse(twoSquares().get("stack/preview.json").toString());
  await drop(write("preview", new Map([...twoSquares()].map(([path, bytes]) => [path, path.endsWith(".json") ? JSON.stringify({ ...preview, title: "Alone" }) : bytes]))));
  assert.equal(await complete(page), undefined);
  assert.equal(await text(page, "#title"), "Alone");
});

test("a folder of views that also contains other files, dropped", async () => {
  const colour = (row, col) => [40 + 50 * row, 40 + 50 * col, 90];
  const files = new Map([["parameters.cfg", "[extrinsics]"], ["lightfield.json", "{}"]]);
  // The folder has more entries than one call of readEntries returns.
  for (let row = 0; row < 3; row++) for (let col = 0; col < 40; col++) files.set(`view_${row}_${col}.png`, png(12, 8, () => colour(row, col / 10)));
  await drop(write("garden", files));
  assert.equal(await text(page, "#title"), "garden");
  assert.match(await text(page, "#facts"), /40 × 3 views of 12 × 8/);
  const [x, y] = [Math.tan((17.5 * Math.PI) / 180), Math.tan((10 * Math.PI) / 180)];
  near(colourAt(await pixels(page, [x, -y])), colour(2, 3.9));
  near(colourAt(await pixels(page, [-x, y])), colour(0, 0));
  assert.deepEqual(page.trouble, []);
});

test("a quilt of the disk, dropped: its name states the aspect ratio of a view", async () => {
  const colours = [[200, 40, 40], [40, 200, 40], [40, 40, 200], [200, 200, 40], [40, 200, 200], [200, 40, 200]];
  const quilt = png(60, 40, (r, c) => colours[(r < 20 ? 3 : 0) + Math.floor(c / 20)]);
  await drop(join(write("quilts", new Map([["walk_qs3x2a2.png", quilt]])), "walk_qs3x2a2.png"));
  assert.equal(await text(page, "#title"), "walk");
  assert.match(await text(page, "#facts"), /6 × 1 views/);
  const edge = Math.tan((17.5 * Math.PI) / 180);
  near(colourAt(await pixels(page, [-edge, 0])), colours[0]);
  near(colourAt(await pixels(page, [edge, 0])), colours[5]);
  // The canvas has the aspect ratio 2, which the file's name states, and the picture fills it to
  // the edges.
  const { width, height, shot } = await page.evaluate(async () => {
    const { width, height } = document.querySelector("lumistack-viewer").shadowRoot.querySelector("canvas.main").getBoundingClientRect();
    const all = await document.querySelector("lumistack-viewer").pixels();
    return { width, height, shot: [0, all.width * (all.height >> 1) * 4].map((at) => [...all.data.subarray(at, at + 3)]) };
  });
  assert.ok(Math.abs(width / height - 2) < 0.02, `${width} × ${height}`);
  shot.forEach((corner) => near(corner, colours[5]));
  assert.deepEqual(page.trouble, []);
});

test("a run without a preview, dropped: a message states the remedy", async () => {
  const title = await text(page, "#title");
  await drop(write("bare", new Map([["layers/stack.json", "{}"], ["layers/layer_0.npy", "x"]])));
  assert.match(await text(page, "#notice"), /no preview.*lumistack preview/);
  assert.equal(await text(page, "#title"), title);
});

test("a run's folder, chosen with the button", async () => {
  await page.click("#open");
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.click("#choose-folder")]);
  await chooser.setFiles(write("chosen", run("Chosen")));
  await page.waitForTimeout(700);
  assert.equal(await complete(page), undefined);
  assert.equal(await text(page, "#title"), "Chosen");
  assert.deepEqual(page.trouble, []);
});
