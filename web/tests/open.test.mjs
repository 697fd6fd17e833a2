// Files that are dropped on the page: a preview, a quilt, the views of a light field, and files of
// other kinds.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { complete, launch, open, pixels, site, text } from "./browser.mjs";
import { png, twoSquares } from "./fixture.mjs";

let browser;
let server;
let page;
before(async () => {
  browser = await launch();
  server = await site(twoSquares());
});
after(async () => {
  await browser?.close();
  await server?.close();
});

/** Drops files (path → bytes) on the element by the event that a browser sends. */
async function drop(files) {
  const list = [...files].map(([name, bytes]) => ({ name, data: Buffer.from(bytes).toString("base64") }));
  await page.evaluate(async (dropped) => {
    const viewer = document.querySelector("lumistack-viewer");
    const transfer = new DataTransfer();
    for (const { name, data } of dropped) transfer.items.add(new File([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))], name));
    viewer.shadowRoot.querySelector("#stage").dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, composed: true, cancelable: true }));
  }, list);
}

/** Waits until an element shows a text that matches the pattern. */
async function shows(selector, pattern) {
  const shown = ([within, source]) => new RegExp(source).test(document.querySelector("lumistack-viewer").shadowRoot.querySelector(within)?.textContent ?? "");
  await page.waitForFunction(shown, [selector, pattern.source], { timeout: 20_000 }).catch(async () => assert.match((await text(page, selector)) ?? "", pattern));
}

const flat = (colour) => png(24, 16, () => colour);
const colourAt = ({ width, height, data }) => [...data.subarray(((height >> 1) * width + (width >> 1)) * 4, ((height >> 1) * width + (width >> 1)) * 4 + 3)];
const near = (found, wanted) => assert.ok(found.every((v, i) => Math.abs(v - wanted[i]) <= 3), `${found}, expected ${wanted}`);

test("the files of a preview without their folder", async () => {
  page = await open(browser, server.url);
  await complete(page);
  const preview = JSON.parse(twoSquares().get("stack/preview.json").toString());
  const files = new Map([...twoSquares()].map(([path, bytes]) => [path.replace("stack/", ""), bytes]));
  files.set("preview.json", Buffer.from(JSON.stringify({ ...preview, title: "Dropped" })));
  await drop(files);
  await shows("#title", /^Dropped$/);
  assert.equal(await complete(page), undefined);
  assert.deepEqual(page.trouble, []);
});

test("a quilt, whose first view is at the bottom left", async () => {
  const colours = [[200, 40, 40], [40, 200, 40], [40, 40, 200], [200, 200, 40]];
  // The quilt has 2 × 2 tiles of 24 × 16 pixels: views 0 and 1 are at the bottom, 2 and 3 at the
  // top.
  const quilt = png(48, 32, (r, c) => colours[(r < 16 ? 2 : 0) + (c < 24 ? 0 : 1)]);
  await drop(new Map([["holiday_qs2x2a1.5.png", quilt]]));
  await shows("#title", /^holiday$/);
  await shows("#facts", /4 × 1 views/);
  const edge = Math.tan((17.5 * Math.PI) / 180);
  near(colourAt(await pixels(page, [-edge, 0])), colours[0]);
  near(colourAt(await pixels(page, [edge, 0])), colours[3]);
  near(colourAt(await pixels(page, [-edge / 3, 0])), colours[1]);
  assert.deepEqual(page.trouble, []);
});

test("the views of a light field, whose rows count from the top", async () => {
  const colour = (row, col) => [60 + 60 * row, 60 + 60 * col, 90];
  const views = new Map();
  for (let row = 0; row < 3; row++) for (let col = 0; col < 3; col++) views.set(`view_${row}_${col}.png`, flat(colour(row, col)));
  await drop(views);
  await shows("#facts", /3 × 3 views of 24 × 16/);
  const [x, y] = [Math.tan((17.5 * Math.PI) / 180), Math.tan((10 * Math.PI) / 180)];
  near(colourAt(await pixels(page, [-x, y])), colour(0, 0));
  near(colourAt(await pixels(page, [x, -y])), colour(2, 2));
  near(colourAt(await pixels(page, [x, y])), colour(0, 2));
  near(colourAt(await pixels(page, [0, 0])), colour(1, 1));
  assert.deepEqual(page.trouble, []);
});

test("files that cannot be shown are refused, and the current picture stays", async () => {
  const title = await text(page, "#title");
  for (const [files, what] of [
    [[["notes.txt", "hello"]], /no picture among the dropped files \(1\)/],
    [[["picture.png", flat([1, 2, 3])]], /single picture/],
    [[["view_00_00.exr", "x"], ["view_00_01.exr", "x"]], /OpenEXR/],
    [[["view_0_0.png", flat([9, 9, 9])], ["view_0_1.png", png(8, 8, () => [0, 0, 0])]], /8 × 8 pixels/],
    [[["a_qs2x2a1.png", "no picture"]], /not a picture/],
  ]) {
    await drop(new Map(files));
    await shows("#notice", what);
    assert.equal(await text(page, "#title"), title);
    assert.equal(await text(page, "#card"), undefined);
  }
});

test("a preview after a light field has its modes again", async () => {
  await drop(new Map([...twoSquares()].map(([path, bytes]) => [path.replace("stack/", ""), bytes])));
  await shows("#title", /^Two squares$/);
  assert.equal(await complete(page), undefined);
  await page.click('input[name="mode"][value="layers"]');
  assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").mode), "layers");
  await page.context().close();
});
