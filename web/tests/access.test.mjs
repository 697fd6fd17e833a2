// Accessibility: axe finds no violation in any mode, nor in forced colours. Nothing is cut off at
// 200 % and 400 %. A finger scrolls the page that contains an element.
import assert from "node:assert/strict";
import { existsSync, mkdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { complete, DIST, launch, open, pixels, SHOTS, site } from "./browser.mjs";
import { twoSquares } from "./fixture.mjs";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
const MODES = [["perceived"], ["slow"], ["exploded"], ["compare", "slider"], ["compare", "side"], ["compare", "error"], ["layers"]];

let browser;
let server;
before(async () => {
  browser = await launch();
  server = await site(existsSync(FIXTURES) ? join(FIXTURES, "uniform3") : twoSquares());
  mkdirSync(SHOTS, { recursive: true });
});
after(async () => {
  await browser?.close();
  await server?.close();
});

const show = (page, mode, comparison) =>
  page.evaluate(
    ([mode, comparison]) => {
      const viewer = document.querySelector("lumistack-viewer");
      viewer.mode = mode;
      if (comparison) viewer.comparison = comparison;
    },
    [mode, comparison ?? null],
  );

for (const colorScheme of ["dark", "light"]) {
  for (const forcedColors of ["none", "active"]) {
    test(`axe finds no violation in any mode, ${colorScheme}${forcedColors === "active" ? ", forced colours" : ""}`, async () => {
      const page = await open(browser, server.url, { colorScheme, forcedColors });
      assert.equal(await complete(page), undefined);
      await page.evaluate(AXE);
      await page.evaluate(() => void (document.querySelector("lumistack-viewer").shadowRoot.querySelector("#build").open = true));
      for (const [mode, comparison] of MODES) {
        await show(page, mode, comparison);
        await page.waitForTimeout(700);
        const found = await page.evaluate(async () => (await window.axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, failureSummary }) => `${target} ${failureSummary}`).join("; ")}`));
        assert.deepEqual(found, [], `in ${mode} ${comparison ?? ""}`);
        if (forcedColors === "active" && colorScheme === "dark") await page.screenshot({ path: join(SHOTS, `forced-${mode}${comparison ? `-${comparison}` : ""}.png`) });
      }
      await page.context().close();
    });
  }
}

test("at 200 % and 400 % nothing is cut off, and the picture is visible", async () => {
  for (const [name, width, height] of [["zoom-200", 720, 450], ["zoom-400", 360, 225]]) {
    const page = await open(browser, server.url, { viewport: { width, height } });
    assert.equal(await complete(page), undefined);
    for (const [mode, comparison] of MODES) {
      await show(page, mode, comparison);
      await page.waitForTimeout(150);
      const { over, high } = await page.evaluate(() => ({
        over: document.documentElement.scrollWidth - innerWidth,
        high: document.querySelector("lumistack-viewer").shadowRoot.querySelector("#shown").getBoundingClientRect().height,
      }));
      assert.ok(over <= 0, `${mode} is ${over} pixels wider than the page of ${name}`);
      assert.ok(high > 40, `${mode} at ${name}: a picture of ${high} pixels`);
      await page.screenshot({ path: join(SHOTS, `${name}-${mode}${comparison ? `-${comparison}` : ""}.png`) });
    }
    // The controls' lowest heading can be scrolled into view.
    await page.evaluate(() => document.querySelector("lumistack-viewer").shadowRoot.querySelector("summary").scrollIntoView());
    assert.ok(await page.evaluate(() => {
      const { top, bottom } = document.querySelector("lumistack-viewer").shadowRoot.querySelector("summary").getBoundingClientRect();
      return top >= -1 && bottom <= innerHeight + 1;
    }), name);
    await page.context().close();
  }
});

test("on a plain element a vertical drag scrolls the page, and a horizontal drag moves the view", async () => {
  const page = await open(browser, server.url, { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  await page.evaluate(() => {
    document.body.innerHTML = `<div style="height:100px"></div><lumistack-viewer src="stack/preview.json" plain style="height:400px"></lumistack-viewer><div style="height:2000px"></div>`;
  });
  assert.equal(await complete(page), undefined);
  const touch = await page.context().newCDPSession(page);
  const drag = async (dx, dy) => {
    const from = { x: 195, y: 300 };
    await touch.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [from] });
    for (let n = 1; n <= 10; n++) {
      await touch.send("Input.dispatchTouchEvent", { type: "touchMove", touchPoints: [{ x: from.x + (dx * n) / 10, y: from.y + (dy * n) / 10 }] });
      await page.waitForTimeout(16);
    }
    await touch.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
    await page.waitForTimeout(600);
  };
  const state = () => page.evaluate(() => ({ top: scrollY, x: document.querySelector("lumistack-viewer").slope[0] }));
  await drag(-100, 0);
  const aside = await state();
  assert.equal(aside.top, 0);
  assert.ok(aside.x > 0.02, `dragged to the left, the eye is at ${aside.x}`);
  await drag(0, -120);
  const down = await state();
  assert.ok(down.top > 60, `the page scrolled by ${down.top}`);
  assert.ok(Math.abs(down.x - aside.x) < 0.03, "the vertical drag moved the view");
  await page.context().close();
});
