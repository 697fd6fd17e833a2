// The first seconds of a page. The page shows a poster immediately, then small views in which the
// user can look around, with a hint. Then the picture appears, and the view swings.
import assert from "node:assert/strict";
import { cpSync, existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";
import { complete, DIST, launch, open, pixels, site, text } from "./browser.mjs";
import { altered, png, SCENE, twoSquares } from "./fixture.mjs";

const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
/** Duration of a task, ms, above which the browser reports it as long. */
const LONG_MS = 50;
const HALF = Math.tan(((SCENE.fovDeg / 2) * Math.PI) / 180);
const RED = [220, 30, 30];
const [LEFT, RIGHT] = [[30, 200, 30], [30, 30, 220]];

let browser;
let server;
before(async () => {
  browser = await launch();
  // The poster is red, the small view from the left is green, the small view from the right is
  // blue. The picture of the patterns is black and white.
  const { cols, rows } = SCENE;
  const around = { path: "stack/around.jpg", cols, rows, slope_x: [-HALF, HALF], slope_y: [0] };
  const files = altered(
    twoSquares(),
    { "stack/poster.jpg": png(cols, rows, () => RED), "stack/around.jpg": png(2 * cols, rows, (_, col) => (col < cols ? LEFT : RIGHT)) },
    (preview) => ({ ...preview, title: "Squares", caption: "Two squares in depth.", poster: "stack/poster.jpg", around }),
  );
  server = await site(files);
});
after(async () => {
  await browser?.close();
  await server?.close();
});

/** Delays the server's answers for the patterns. Returns a function that sends them. */
function hold(matching = /layer/) {
  const waiting = [];
  let open = false;
  server.state.hook = (path, response) => {
    if (open || !matching.test(path)) return false;
    const bytes = server.state.files.get(path.slice(1));
    waiting.push(() => response.writeHead(200, { "content-type": "image/png" }).end(bytes));
    return true;
  };
  return () => {
    open = true;
    server.state.hook = undefined;
    waiting.forEach((answer) => answer());
  };
}

/** Returns the colour of the screen at a point in the upper half of the picture. */
async function middle(page) {
  const box = await page.evaluate(() => {
    const { x, y, width, height } = document.querySelector("lumistack-viewer").shadowRoot.querySelector("#shown").getBoundingClientRect();
    return { x: x + width / 2, y: y + height / 4, width: 4, height: 4 };
  });
  const shot = (await page.screenshot({ clip: box })).toString("base64");
  return page.evaluate(async (data) => {
    const picture = await createImageBitmap(await (await fetch(`data:image/png;base64,${data}`)).blob());
    const context = new OffscreenCanvas(1, 1).getContext("2d");
    context.drawImage(picture, 0, 0);
    return [...context.getImageData(0, 0, 1, 1).data.subarray(0, 3)];
  }, shot);
}
const near = (found, wanted, by = 12) => assert.ok(found.every((v, i) => Math.abs(v - wanted[i]) <= by), `${found}, expected ${wanted}`);
const mark = (page, name) => page.waitForFunction((wanted) => performance.getEntriesByName(wanted).length > 0, name);

test("the poster is shown first, small views after a move, and then the picture, without a gap", async () => {
  const go = hold();
  const loaded = [];
  const page = await open(browser, server.url, { seen: (request) => loaded.push(request.url()) });
  await mark(page, "lumistack-interactive");
  await page.waitForTimeout(150);
  near(await middle(page), RED);
  assert.equal(await text(page, "#title"), "Squares");
  assert.equal(await text(page, "#caption"), "Two squares in depth.");
  assert.match(await text(page, "#nudge"), /Move the mouse/);
  assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").shadowRoot.querySelector("#build").open), false);
  // The view from the right is blue; the view from the middle is a blend of green and blue.
  await page.evaluate((slope) => void (document.querySelector("lumistack-viewer").slope = slope), [HALF, 0]);
  await page.waitForTimeout(150);
  near(await middle(page), RIGHT);
  assert.equal(await text(page, "#nudge"), undefined, "the hint stays");
  await page.evaluate(() => void (document.querySelector("lumistack-viewer").slope = [0, 0]));
  await page.waitForTimeout(150);
  near(await middle(page), LEFT.map((v, i) => (v + RIGHT[i]) / 2));
  // Count the animation frames in which neither the small views nor the picture cover the stage.
  await page.evaluate(() => {
    const root = document.querySelector("lumistack-viewer").shadowRoot;
    window.bare = 0;
    const look = () => {
      const covered = root.querySelector("#picture").classList.contains("early");
      const drawn = !root.querySelector("canvas.main").hidden;
      if (!covered && !drawn) window.bare += 1;
      requestAnimationFrame(look);
    };
    look();
  });
  go();
  assert.equal(await complete(page), undefined);
  await mark(page, "lumistack-first-picture");
  await page.waitForTimeout(500);
  near(await middle(page), [255, 255, 255]);
  assert.equal(await page.evaluate(() => window.bare), 0, "in some animation frames nothing was shown");
  // The viewer loads its own script and module, and nothing of the page that solves.
  const parts = new Set(loaded.filter((url) => url.startsWith("http")).map((url) => new URL(url).pathname.replace(/^\/stack\/.*/, "/stack/")));
  assert.deepEqual([...parts].sort(), ["/", "/app/lumistack_web_bg.wasm", "/app/viewer.js", "/stack/"]);
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("the page has one primary action, which takes the display apart and puts it together", async () => {
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  const primary = page.locator(".primary:visible");
  assert.deepEqual(await primary.allInnerTexts(), ["Take it apart"]);
  const mode = () => page.evaluate(() => document.querySelector("lumistack-viewer").mode);
  for (const [wanted, label] of [["exploded", "Put it together"], ["perceived", "Take it apart"]]) {
    await primary.click();
    assert.equal(await mode(), wanted);
    assert.deepEqual(await primary.allInnerTexts(), [label]);
  }
  // On the page that solves, the primary action chooses a file.
  await page.goto(`${server.url}/solve.html`);
  assert.deepEqual(await primary.allInnerTexts(), ["Choose a file"]);
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), primary.click()]);
  assert.ok(chooser.isMultiple());
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

test("a picture without all its frames also replaces the poster", async () => {
  const files = server.state.files;
  server.state.files = altered(files, { "stack/layer0_frame1.png": undefined });
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  await page.waitForTimeout(500);
  near(await middle(page), [255, 255, 255]);
  await page.context().close();
  server.state.files = files;
});

test("a preview whose poster cannot be loaded is shown without it", async () => {
  const files = server.state.files;
  server.state.files = altered(files, { "stack/poster.jpg": undefined, "stack/around.jpg": undefined });
  const page = await open(browser, server.url);
  assert.equal(await complete(page), undefined);
  await page.waitForTimeout(500);
  near(await middle(page), [255, 255, 255]);
  await page.context().close();
  server.state.files = files;
});

test("the view swings at once until the user moves it, unless the user prefers less motion", async () => {
  for (const reducedMotion of ["no-preference", "reduce"]) {
    const page = await open(browser, server.url, { reducedMotion });
    assert.equal(await complete(page), undefined);
    await mark(page, "lumistack-first-picture");
    await page.waitForTimeout(900);
    const slope = () => page.evaluate(() => document.querySelector("lumistack-viewer").slope);
    const moved = Math.hypot(...(await slope())) > 1e-3;
    assert.equal(moved, reducedMotion === "no-preference");
    assert.ok(await text(page, "#nudge"), "no hint");
    await page.mouse.move(400, 400);
    await page.waitForTimeout(900);
    assert.equal(await text(page, "#nudge"), undefined, "the hint stays");
    const [before] = [await slope()];
    await page.waitForTimeout(400);
    near(await slope(), before, 1e-3);
    await page.context().close();
  }
});

test("no task blocks the page while patterns are decoded and pictures drawn", async () => {
  // Use large masks of noise, which take longest to decode.
  const [cols, rows, frames] = [640, 400, 4];
  let seed = 1;
  const noise = () => (seed = (seed * 48271) % 2147483647) & 255;
  const files = new Map();
  const listed = [];
  for (let frame = 0; frame < frames; frame++) {
    for (let layer = 0; layer < 2; layer++) {
      const path = `stack/layer${layer}_frame${frame}.png`;
      files.set(path, png(cols, rows, () => [noise(), noise(), noise()]));
      listed.push({ path, kind: "layer", layer, frame, cols, rows, bytes: files.get(path).length });
    }
  }
  const preview = JSON.parse(twoSquares().get("stack/preview.json").toString());
  preview.display.frames = preview.frames = frames;
  preview.display.field.resolution = [cols, rows];
  preview.display.layers.forEach((layer) => (layer.resolution = [cols, rows]));
  Object.assign(preview.target, { cols, rows });
  files.set("stack/preview.json", Buffer.from(JSON.stringify({ ...preview, files: listed })));
  const large = await site(files);
  try {
    // Other programs on the machine also make tasks long. So two long tasks of at most twice
    // LONG_MS are allowed, and one of up to three loads must have no more.
    const loads = [];
    const isQuiet = (long) => long.length <= 2 && long.every((ms) => ms <= 2 * LONG_MS);
    while (loads.length < 3 && !loads.some(isQuiet)) {
      const page = await open(browser, large.url, {
        reducedMotion: "no-preference",
        init: () => {
          window.long = [];
          new PerformanceObserver((list) => window.long.push(...list.getEntries().map(({ duration }) => duration))).observe({ type: "longtask", buffered: true });
        },
      });
      assert.equal(await complete(page), undefined);
      await page.waitForTimeout(1500);
      const { long, moved } = await page.evaluate(() => ({ long: window.long, moved: document.querySelector("lumistack-viewer").slope }));
      console.log(`  long tasks: ${long.map((ms) => ms.toFixed(0)).join(", ") || "none"} ms`);
      assert.ok(Math.hypot(...moved) > 1e-3, "the view did not swing");
      loads.push(long);
      await page.context().close();
    }
    assert.ok(loads.some(isQuiet), `long tasks, ms, of each load: ${JSON.stringify(loads)}`);
  } finally {
    // an open server would keep this process alive after a failure
    await large.close();
  }
});

test("a page that is opened from its folder states a remedy", async () => {
  const folder = mkdtempSync(join(tmpdir(), "lumistack-folder-"));
  cpSync(DIST, join(folder, "app"), { recursive: true });
  writeFileSync(join(folder, "index.html"), readFileSync(join(DIST, "index.html")));
  const page = await (await browser.newContext()).newPage();
  await page.goto(pathToFileURL(join(folder, "index.html")).href);
  assert.match(await page.innerText("main"), /do not run this page from a folder.*preview\.html.*lumistack preview/s);
  assert.equal(await page.isVisible(".folder"), true);
  await page.context().close();
  rmSync(folder, { recursive: true });
});

test("the poster of a site that the plugin wrote is visible without scripts", { skip: !existsSync(FIXTURES) && "no fixtures" }, async () => {
  const folder = join(FIXTURES, "uniform3");
  const { serve } = await import("./server.mjs");
  const written = await serve({ "/": folder });
  const page = await (await browser.newContext({ javaScriptEnabled: false, viewport: { width: 1440, height: 900 } })).newPage();
  await page.goto(written.url);
  const before = await page.locator('img[slot="poster"]').boundingBox();
  assert.ok(before.width > 800 && before.height > 500, `${before.width} × ${before.height}`);
  await page.context().close();
  // Without scripts the poster has the same position and size as with scripts.
  for (const viewport of [{ width: 1440, height: 900 }, { width: 390, height: 844 }]) {
    const [bare, full] = await Promise.all([false, true].map(async (javaScriptEnabled) => {
      const page = await (await browser.newContext({ javaScriptEnabled, viewport, reducedMotion: "reduce" })).newPage();
      await page.goto(written.url);
      if (javaScriptEnabled) await page.evaluate(() => document.querySelector("lumistack-viewer").complete);
      const { x, y, width, height } = await page.locator('img[slot="poster"]').boundingBox();
      // The image of 60 × 40 pixels is centred in its box, and as large as the box allows.
      const scale = Math.min(width / 60, height / 40);
      await page.context().close();
      return [x + (width - 60 * scale) / 2, y + (height - 40 * scale) / 2, 60 * scale, 40 * scale];
    }));
    near(bare, full, 6);
  }
  await written.close();
});
