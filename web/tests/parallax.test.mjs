// Near and far objects move in opposite directions, by the distances that the geometry gives.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { complete, launch, open, pixels, site, text } from "./browser.mjs";
import { SCENE, twoSquares } from "./fixture.mjs";

let browser;
let server;
before(async () => {
  browser = await launch();
  server = await site(twoSquares());
});
after(async () => {
  await browser?.close();
  await server?.close();
});

/** Returns the centroid [row, col] of the dark pixels in the rows `from` to `to`. */
function darkCentre({ width, data }, from, to) {
  let [weight, row, col] = [0, 0, 0];
  for (let r = from; r < to; r++) {
    for (let c = 0; c < width; c++) {
      const dark = 255 - data[(r * width + c) * 4];
      weight += dark;
      row += r * dark;
      col += c * dark;
    }
  }
  assert.ok(weight > 0, `no dark pixel in rows ${from} to ${to}`);
  return [row / weight, col / weight];
}

for (const renderer of ["webgl2", "cpu"]) {
  test(`on ${renderer}, a square at position d moves by −d·s`, async () => {
    const page = await open(browser, `${server.url}/?renderer=${renderer}`);
    assert.equal(await complete(page), undefined);
    const { far, near, pitchMm, rows } = SCENE;
    // A slope of k·pitch/d moves the near square by k whole pixels. Rows are numbered from the top.
    for (const [kx, ky] of [[0, 0], [3, 0], [-3, 0], [0, 2], [0, -2], [5, 1]]) {
      const slope = [(kx * pitchMm) / near.dMm, (ky * pitchMm) / near.dMm];
      const shown = await pixels(page, slope);
      const half = rows / 2;
      const [farRow, farCol] = darkCentre(shown, 0, half);
      const [nearRow, nearCol] = darkCentre(shown, half, rows);
      // The near square moves by −kx columns, and the far square, at −d, by +kx columns.
      const off = [nearCol - (near.col - kx), nearRow - (near.row + ky), farCol - (far.col + kx), farRow - (far.row - ky)];
      assert.ok(off.every((value) => Math.abs(value) < 0.02), `at ${slope}: off by ${off.map((v) => v.toFixed(3))} pixels`);
    }
    await page.context().close();
  });
}

test("if the mouse moves to the right, near objects move to the left and far objects to the right", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  const box = await page.evaluate(() => {
    const { left, top, width, height } = document.querySelector("lumistack-viewer").shadowRoot.querySelector("#stage").getBoundingClientRect();
    return { left, top, width, height };
  });
  const at = async (share) => {
    await page.mouse.move(box.left + box.width * share, box.top + box.height / 2);
    const slope = await page.evaluate(() => document.querySelector("lumistack-viewer").slope);
    const shown = await pixels(page);
    return { slope, far: darkCentre(shown, 0, SCENE.rows / 2)[1], near: darkCentre(shown, SCENE.rows / 2, SCENE.rows)[1] };
  };
  const [left, right] = [await at(0.3), await at(0.7)];
  const moved = right.slope[0] - left.slope[0];
  assert.ok(moved > 0.1, `the eye moved by a slope of ${moved}`);
  assert.ok(Math.abs(right.near - left.near + (SCENE.near.dMm * moved) / SCENE.pitchMm) <= 1, `near: ${left.near} to ${right.near}`);
  assert.ok(Math.abs(right.far - left.far + (SCENE.far.dMm * moved) / SCENE.pitchMm) <= 1, `far: ${left.far} to ${right.far}`);
  await page.mouse.move(box.left + box.width * 0.985, box.top + box.height / 2);
  await page.waitForTimeout(200);
  assert.match(await text(page, "#place"), /outside/i);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});
