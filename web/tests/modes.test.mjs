// Every mode, by mouse and by keyboard, without messages on the console; screenshots of all modes.
import assert from "node:assert/strict";
import { existsSync, mkdirSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { complete, launch, open, pixels, SHOTS, site, text } from "./browser.mjs";
import { twoSquares } from "./fixture.mjs";

const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
/** A preview folder with a more detailed picture, for the screenshots. */
const SHOWN = process.env.LUMISTACK_WEB_SHOWN ?? join(FIXTURES, "uniform3");
const MODES = [["perceived"], ["slow"], ["exploded"], ["compare", "slider"], ["compare", "side"], ["compare", "error"], ["layers"]];

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

const viewer = (page, action, argument) => page.evaluate(`(${action})(document.querySelector("lumistack-viewer"), ${JSON.stringify(argument ?? null)})`);

for (const renderer of ["webgl2", "cpu"]) {
  test(`every mode shows a picture after a click, on ${renderer}`, async () => {
    const page = await open(browser, `${server.url}/?renderer=${renderer}`);
    assert.equal(await complete(page), undefined);
    for (const [mode, comparison] of MODES) {
      await page.click(`input[name="mode"][value="${mode}"]`);
      if (comparison) await page.click(`input[name="comparison"][value="${comparison}"]`);
      await page.waitForTimeout(60);
      assert.equal(await viewer(page, "(v) => v.mode"), mode);
      const { data } = await pixels(page);
      assert.ok(new Set(data.filter((_, i) => i % 4 !== 3)).size > 1, `${mode} ${comparison ?? ""} is one colour`);
    }
    assert.deepEqual(page.trouble, []);
    await page.context().close();
  });
}

test("keys choose modes, look around and step through frames", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  const slope = () => viewer(page, "(v) => v.slope");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("ArrowUp");
  const [x, y] = await slope();
  assert.ok(x > 0 && y > 0, `the eye is at ${[x, y]}`);
  await page.keyboard.press("Home");
  assert.deepEqual(await slope(), [0, 0]);
  for (const [key, mode] of [["2", "slow"], ["3", "exploded"], ["4", "compare"], ["5", "layers"], ["1", "perceived"]]) {
    await page.keyboard.press(key);
    assert.equal(await viewer(page, "(v) => v.mode"), mode);
  }
  await page.keyboard.press("2");
  await page.keyboard.press(".");
  const first = await text(page, "#frame-count");
  await page.keyboard.press(".");
  assert.notEqual(await text(page, "#frame-count"), first);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the Tab key reaches every control, and every control has a name", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  for (const mode of ["perceived", "slow", "exploded", "compare", "layers"]) {
    await viewer(page, "(v, m) => void (v.mode = m)", mode);
    const wanted = await viewer(
      page,
      `(v) => [...v.shadowRoot.querySelectorAll("button, input, [tabindex]")]
        .filter((e) => e.checkVisibility({ visibilityProperty: true }) && !e.closest("dialog") && !e.disabled && e.tabIndex >= 0 && (e.type !== "radio" || e.checked))
        .map((e) => e.id || e.value || e.ariaLabel)`,
    );
    const reached = new Set();
    await page.evaluate(() => document.activeElement?.blur());
    for (let n = 0; n < wanted.length + 12; n++) {
      await page.keyboard.press("Tab");
      reached.add(await viewer(page, "(v) => { const e = v.shadowRoot.activeElement; return e && (e.id || e.value || e.ariaLabel); }"));
    }
    assert.deepEqual(wanted.filter((name) => !reached.has(name)), [], `in ${mode}`);
    const nameless = await viewer(
      page,
      `(v) => [...v.shadowRoot.querySelectorAll("button, input, [role]")].filter((e) => e.checkVisibility() &&
        !(e.ariaLabel || e.textContent.trim() || e.labels?.length || e.getAttribute("aria-labelledby") || e.role === "alert" || e.role === "status")).map((e) => e.outerHTML)`,
    );
    assert.deepEqual(nameless, [], `in ${mode}`);
  }
  await page.context().close();
});

test("the address contains the state, and a link restores it", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  await page.click('input[name="mode"][value="compare"]');
  await page.click('input[name="comparison"][value="side"]');
  await viewer(page, "(v) => void (v.slope = [0.1, -0.05])");
  await viewer(page, `(v) => { const gap = v.shadowRoot.querySelector("#gap"); gap.value = "2"; gap.dispatchEvent(new Event("input")); }`);
  await page.waitForTimeout(700);
  const url = page.url();
  assert.match(url, /mode=compare/);
  assert.match(url, /gap=2/);
  const other = await open(browser, url);
  assert.equal(await complete(other), undefined);
  assert.deepEqual(await viewer(other, "(v) => [v.mode, v.comparison, ...v.slope]"), ["compare", "side", 0.1, -0.05]);
  assert.match(await text(other, "#gap-value"), /\+2/);
  assert.equal(await viewer(other, `(v) => v.shadowRoot.querySelector("#gap-row").classList.contains("changed")`), true);
  for (const each of [page, other]) {
    assert.deepEqual(each.trouble, []);
    await each.context().close();
  }
});

test("errors of the construction change the picture, and the reset restores it", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  const designed = await pixels(page, [0.1, 0]);
  for (const id of ["gap", "shiftx", "black", "pupil", "eye"]) {
    await viewer(page, `(v, id) => { const e = v.shadowRoot.querySelector("#" + id); e.value = id === "eye" ? e.min : e.max; e.dispatchEvent(new Event("input")); }`, id);
    const changed = await pixels(page);
    assert.notDeepEqual(changed.data, designed.data, `${id} changes nothing`);
    await page.click("#reset");
    assert.deepEqual((await pixels(page)).data, designed.data, `${id} is not reset`);
  }
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the view swings when idle, unless the user prefers less motion", async () => {
  for (const [reducedMotion, swings] of [["no-preference", true], ["reduce", false]]) {
    const page = await open(browser, server.url, { reducedMotion });
    assert.equal(await complete(page), undefined);
    await page.waitForTimeout(5500);
    const [x, y] = await viewer(page, "(v) => v.slope");
    assert.equal(x !== 0 || y !== 0, swings, `${reducedMotion}: at ${[x, y]}`);
    await page.context().close();
  }
});

test("a picture and a video of a turn are saved", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  const [shot] = await Promise.all([page.waitForEvent("download"), page.click("#shot")]);
  assert.match(shot.suggestedFilename(), /^two-squares_perceived_.*\.png$/);
  const [video] = await Promise.all([page.waitForEvent("download"), page.click("#record")]);
  assert.match(video.suggestedFilename(), /^two-squares_turn\.(webm|mp4)$/);
  const path = await video.path();
  const { statSync } = await import("node:fs");
  assert.ok(statSync(path).size > 2000, `the video has ${statSync(path).size} bytes`);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("a screen reader receives the viewing position", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  await viewer(page, "(v) => void (v.slope = [0.1, 0])");
  await page.waitForTimeout(250);
  assert.equal(await viewer(page, `(v) => v.shadowRoot.querySelector("#live").textContent`), "5.7° right");
  assert.match(await viewer(page, `(v) => v.shadowRoot.querySelector("#shown").getAttribute("aria-label")`), /Two squares, seen from 5\.7° right/);
  await page.context().close();
});

test("screenshots of every mode at three sizes, dark and light", async () => {
  mkdirSync(SHOTS, { recursive: true });
  const folder = existsSync(SHOWN) ? await site(SHOWN) : server;
  for (const [name, width, height, schemes] of [
    ["wide", 1440, 900, ["dark", "light"]],
    ["phone", 390, 844, ["dark", "light"]],
    ["tablet", 820, 1180, ["dark"]],
  ]) {
    for (const colorScheme of schemes) {
      const touch = name !== "wide";
      const page = await open(browser, `${folder.url}/#x=0.03&y=0.02`, { viewport: { width, height }, colorScheme, hasTouch: touch, isMobile: touch });
      assert.equal(await complete(page), undefined);
      for (const [mode, comparison] of MODES) {
        await viewer(page, "(v, [mode, comparison]) => { v.mode = mode; if (comparison) v.comparison = comparison; }", [mode, comparison ?? null]);
        await page.waitForTimeout(400);
        const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        assert.ok(overflow <= 0, `${mode} is ${overflow} pixels wider than the ${name} page`);
        await page.screenshot({ path: join(SHOTS, `${name}-${colorScheme}-${mode}${comparison ? `-${comparison}` : ""}.png`) });
      }
      assert.deepEqual(page.trouble, []);
      await page.context().close();
    }
  }
  if (folder !== server) await folder.close();
});
