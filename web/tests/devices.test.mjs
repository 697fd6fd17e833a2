// Touch, the tilt of a phone, and an element that is out of sight.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { complete, launch, open, site, text } from "./browser.mjs";
import { SCENE, twoSquares } from "./fixture.mjs";

const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };
const ZONE = Math.tan(((SCENE.fovDeg / 2) * Math.PI) / 180);
/** Largest difference between the slope of a view at rest and its expected value. */
const AT_REST = 1e-3;

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

const slope = (page) => page.evaluate(() => document.querySelector("lumistack-viewer").slope);
const shadow = (page, script) => page.evaluate(`(${script})(document.querySelector("lumistack-viewer").shadowRoot)`);
const near = (found, wanted, by = AT_REST) => assert.ok(found.every((v, i) => Math.abs(v - wanted[i]) <= by), `the eye is at ${found}, expected ${wanted}`);

/** Returns the centre and the size of a part of the element, CSS pixels of the window. */
const box = (page, selector) =>
  page.evaluate((within) => {
    const { x, y, width, height } = document.querySelector("lumistack-viewer").shadowRoot.querySelector(within).getBoundingClientRect();
    return { x: x + width / 2, y: y + height / 2, width, height };
  }, selector);

/** Drags one finger from a place by (dx, dy) in steps. Without `fling` the finger rests before its release, so that no inertia follows. */
async function drag(page, from, [dx, dy], fling = false) {
  const touch = await page.context().newCDPSession(page);
  const send = (type, points) => touch.send("Input.dispatchTouchEvent", { type, touchPoints: points });
  await send("touchStart", [from]);
  for (let n = 1; n <= 10; n++) {
    await send("touchMove", [{ x: from.x + (dx * n) / 10, y: from.y + (dy * n) / 10 }]);
    await page.waitForTimeout(16);
  }
  if (!fling) await page.waitForTimeout(900);
  await send("touchEnd", []);
}

test("a drag to the left shows the display from the right, and a drag downwards from above", async () => {
  const page = await open(browser, server.url, PHONE);
  assert.equal(await complete(page), undefined);
  const stage = await box(page, "#stage");
  // A drag over 0.32 of the width of the box around the picture crosses half the viewing zone.
  await drag(page, stage, [-0.16 * stage.width, 0.08 * stage.width]);
  await page.waitForTimeout(300);
  const [x, y] = await slope(page);
  near([x, y], [0.5 * ZONE, 0.25 * ZONE], 0.02);
  assert.equal(await page.evaluate(() => scrollY), 0, "the drag scrolled the page");
  // The opposite drag moves the view back.
  await drag(page, stage, [0.16 * stage.width, -0.08 * stage.width]);
  await page.waitForTimeout(300);
  near(await slope(page), [0, 0], 0.02);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("after a flick the view moves on, up to its limit, unless the user prefers less motion", async () => {
  const rest = [];
  for (const reducedMotion of ["no-preference", "reduce"]) {
    const page = await open(browser, `${server.url}/#swing=0`, { ...PHONE, reducedMotion });
    assert.equal(await complete(page), undefined);
    const stage = await box(page, "#stage");
    await drag(page, stage, [-0.1 * stage.width, 0], true);
    await page.waitForTimeout(900);
    rest.push((await slope(page))[0]);
    for (let n = 0; n < 6; n++) await drag(page, stage, [-0.4 * stage.width, 0], true);
    await page.waitForTimeout(900);
    near(await slope(page), [1.4 * ZONE, 0], 0.02);
    await page.context().close();
  }
  const [flung, still] = rest;
  assert.ok(Math.abs(still - (0.1 / 0.32) * ZONE) < 0.02, `without motion the eye is at ${still}`);
  assert.ok(flung > still + 0.005, `a flick went to ${flung}, a drag to ${still}`);
});

test("a finger on the map of the zone moves the eye to its position", async () => {
  const page = await open(browser, server.url, PHONE);
  assert.equal(await complete(page), undefined);
  await shadow(page, `(root) => root.querySelector("#pad").scrollIntoView({ block: "center" })`);
  const pad = await box(page, ".zone");
  await drag(page, { x: pad.x, y: pad.y }, [pad.width / 2, -pad.height / 4]);
  await page.waitForTimeout(300);
  near(await slope(page), [ZONE, ZONE / 2], 0.03);
  await page.context().close();
});

test("a finger turns the exploded stack", async () => {
  const page = await open(browser, `${server.url}/#mode=exploded`, PHONE);
  assert.equal(await complete(page), undefined);
  const stage = await box(page, "#stage");
  await drag(page, stage, [60, 20]);
  await page.waitForTimeout(700);
  const turned = new URLSearchParams(new URL(page.url()).hash.slice(1));
  assert.ok(turned.has("yaw") && turned.has("pitch"), page.url());
  near(await slope(page), [0, 0]);
  await page.context().close();
});

test("the tilt of the phone relative to its pose at the start moves the eye", async () => {
  const page = await open(browser, server.url, PHONE);
  assert.equal(await complete(page), undefined);
  const device = await page.context().newCDPSession(page);
  const pose = (beta, gamma) => device.send("DeviceOrientation.setDeviceOrientationOverride", { alpha: 0, beta, gamma });
  assert.ok(await text(page, "#tilt"), "the phone's page has no button for tilt");
  assert.equal(await text(page, "#nudge"), "Drag to look around, or press Tilt");
  await pose(40, 0);
  await page.tap("#tilt");
  await page.waitForTimeout(300);
  assert.equal(await shadow(page, `(root) => root.querySelector("#tilt").ariaPressed`), "true");
  near(await slope(page), [0, 0]);
  // The second pose shows the display from the left, the third from above.
  await pose(40, 10);
  await page.waitForTimeout(700);
  near(await slope(page), [-Math.tan((10 * Math.PI) / 180), 0], 0.01);
  await pose(50, 0);
  await page.waitForTimeout(700);
  near(await slope(page), [0, Math.tan((10 * Math.PI) / 180)], 0.012);
  await page.tap("#tilt");
  await pose(40, -20);
  await page.waitForTimeout(500);
  assert.ok((await slope(page))[0] < 0.02, "the view still follows the tilt");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the hint names tilt only if the element shows the button for it", async () => {
  for (const [options, plain, hint] of [
    [PHONE, true, "Drag to look around"],
    [{}, false, "Move the mouse to look around"],
  ]) {
    const page = await open(browser, server.url, options);
    if (plain) await page.evaluate(() => (document.querySelector("main").innerHTML = `<lumistack-viewer src="stack/preview.json" plain style="height:400px"></lumistack-viewer>`));
    assert.equal(await complete(page), undefined);
    await page.waitForFunction(() => document.querySelector("lumistack-viewer").shadowRoot.querySelector("#nudge").checkVisibility());
    assert.equal(await text(page, "#nudge"), hint);
    await page.context().close();
  }
});

test("a phone that reports no pose gives a message", async () => {
  const page = await open(browser, server.url, PHONE);
  assert.equal(await complete(page), undefined);
  await page.tap("#tilt");
  await page.waitForTimeout(1800);
  assert.match((await text(page, "#notice")) ?? "", /reports no tilt/);
  assert.equal(await shadow(page, `(root) => root.querySelector("#tilt").ariaPressed`), "false");
  await page.context().close();
});

test("an element out of sight stops its frames, and continues in sight", async () => {
  const page = await open(browser, `${server.url}/#mode=slow&rate=8`, { reducedMotion: "no-preference" });
  assert.equal(await complete(page), undefined);
  await page.evaluate(() => {
    const before = document.createElement("div");
    before.style.height = "200vh";
    document.body.prepend(before);
  });
  const frame = () => page.evaluate(() => document.querySelector("lumistack-viewer").shadowRoot.querySelector("#frame-count").textContent);
  const seen = async () => {
    const shown = new Set();
    for (let n = 0; n < 12; n++) {
      shown.add(await frame());
      await page.waitForTimeout(60);
    }
    return shown.size;
  };
  await page.evaluate(() => scrollTo(0, 0));
  await page.waitForTimeout(300);
  assert.equal(await seen(), 1, "frames change out of sight");
  await page.evaluate(() => document.querySelector("lumistack-viewer").scrollIntoView());
  await page.waitForTimeout(300);
  assert.ok((await seen()) > 1, "frames do not change in sight");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("an element out of sight releases its graphics context and keeps its picture; in sight it takes a new context", async () => {
  const page = await open(browser, `${server.url}/?renderer=webgl2`);
  assert.equal(await complete(page), undefined);
  await page.evaluate(() => {
    const before = document.createElement("div");
    before.style.height = "200vh";
    document.body.prepend(before);
    scrollTo(0, 0);
  });
  const lost = () => page.workers()[0].evaluate(() => self.context.isContextLost());
  const until = async (wanted) => {
    for (let n = 0; n < 100 && (await lost()) !== wanted; n++) await page.waitForTimeout(100);
    assert.equal(await lost(), wanted);
  };
  assert.equal(await lost(), false);
  await until(true);
  const size = await page.evaluate(() => document.querySelector("lumistack-viewer").shadowRoot.querySelector("canvas.main").width);
  assert.equal(size, SCENE.cols);
  await page.evaluate(() => document.querySelector("lumistack-viewer").scrollIntoView());
  await until(false);
  assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").path), "webgl2");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});
