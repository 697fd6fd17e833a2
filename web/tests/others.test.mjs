// Other displays: a headset (Meta's emulator), lenticular panels (compared with a simple
// reference), and Looking Glass Bridge (recorded answers).
import assert from "node:assert/strict";
import { mkdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { complete, launch, LINEAR, open, pixels, SHOTS, site, text } from "./browser.mjs";
import { altered, SCENE, twoSquares } from "./fixture.mjs";

const WEB = dirname(dirname(fileURLToPath(import.meta.url)));
const AXE = readFileSync(join(WEB, "node_modules/axe-core/axe.min.js"), "utf8");

let browser;
let server;
before(async () => {
  browser = await launch();
  server = await site(twoSquares());
  mkdirSync(SHOTS, { recursive: true });
});
after(async () => {
  await browser?.close();
  await server?.close();
});

const shadow = (page, action, argument) => page.evaluate(`(${action})(document.querySelector("lumistack-viewer").shadowRoot, ${JSON.stringify(argument ?? null)})`);
const status = (page) => text(page, "#others-status");
/** Waits until the dialog shows a text that matches the pattern. */
async function said(page, pattern) {
  await page.waitForFunction((source) => new RegExp(source).test(document.querySelector("lumistack-viewer").shadowRoot.querySelector("#others-status").textContent), pattern.source, { timeout: 20_000 }).catch(async () => assert.match(await shadow(page, "(root) => root.querySelector('#others-status').textContent"), pattern));
}

async function dialog(options = {}, url = server.url) {
  const page = await open(browser, url, options);
  assert.equal(await complete(page), undefined);
  await page.click("#elsewhere");
  return page;
}

test("the dialog fits phones, tablets and desktops, axe finds nothing, and nothing is loaded before it is chosen", async () => {
  for (const [name, options] of [
    ["desktop", {}],
    ["phone", { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true, colorScheme: "light" }],
    ["tablet", { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true }],
  ]) {
    const loaded = [];
    const page = await dialog({ ...options });
    page.on("request", (request) => loaded.push(request.url()));
    await page.evaluate(AXE);
    const found = await page.evaluate(async () => (await window.axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target }) => target).join("; ")}`));
    assert.deepEqual(found, []);
    // the button is disabled, since this browser has no headset
    assert.equal(await shadow(page, "(root) => root.querySelector('#headset').disabled"), true);
    const inside = await shadow(page, "(root) => { const box = root.querySelector('#others').getBoundingClientRect(); return box.left >= 0 && box.right <= innerWidth && box.top >= 0 && box.bottom <= innerHeight; }");
    assert.ok(inside, name);
    await page.screenshot({ path: join(SHOTS, `others-${name}.png`) });
    assert.deepEqual(loaded.filter((url) => /headset|lenticular|bridge/.test(url)), []);
    await page.context().close();
  }
});

/**
 * Returns the preview with two squares at ten times its size, so that it is wide enough for a
 * headset.
 */
function large() {
  return altered(twoSquares(), {}, (preview) => {
    preview.display.field.pitch_mm *= 10;
    preview.target.pitch_mm *= 10;
    for (const layer of preview.display.layers) {
      layer.pitch_mm *= 10;
      layer.d_mm *= 10;
    }
    return preview;
  });
}

test("in a headset both eyes see every depth where it is, at true scale", async (t) => {
  const { outputFiles } = await build({ stdin: { contents: 'import { oculusQuest1, XRDevice } from "iwer"; Object.assign(window, { oculusQuest1, XRDevice });', resolveDir: WEB }, bundle: true, write: false, format: "iife", logLevel: "silent" });
  const emulator = `${outputFiles[0].text}
    window.device = new XRDevice({ ...oculusQuest1, supportedSessionModes: ["inline", "immersive-vr"] }, { stereoEnabled: true, ipd: 0.063 });
    device.installRuntime({ forceInstall: true });
    device.stereoEnabled = true;
    device.ipd = 0.063;
    device.position.set(0.3, 1.6, 0.2);
    window.eyes = {};
    window.first = {};
    const { getViewport } = XRWebGLLayer.prototype;
    XRWebGLLayer.prototype.getViewport = function (view) {
      const { x, y, width, height } = getViewport.call(this, view);
      eyes[view.eye] = { x, y, width, height, projection: [...view.projectionMatrix], inverse: [...view.transform.inverse.matrix], at: [view.transform.position.x, view.transform.position.y, view.transform.position.z] };
      if (!first[view.eye]) first = { ...first, [view.eye]: eyes[view.eye] };
      return { x, y, width, height };
    };
    const { requestSession } = navigator.xr;
    navigator.xr.requestSession = async function (...words) { return (window.session = await requestSession.apply(this, words)); };`;
  const big = await site(large());
  t.after(() => big.close());
  const page = await dialog({ init: emulator }, big.url);
  const before = await pixels(page, [0.1, 0.05]);
  await page.waitForFunction(() => !document.querySelector("lumistack-viewer").shadowRoot.querySelector("#headset").disabled, undefined, { timeout: 10_000 }).catch(() => assert.deepEqual(page.trouble, []));
  await page.click("#headset");
  // the display stands in front of the head, at a distance of one and a half times its width
  await page.waitForFunction(() => first.right);
  const { left, right } = await page.evaluate(() => first);
  const centre = [0, 1, 2].map((i) => (left.at[i] + right.at[i]) / 2 - (i === 2 ? 1.5 * (SCENE.cols / 100) : 0));
  for (const [name, head] of [
    ["front", [0.3, 1.6, 0.2]],
    ["aside", [0.24, 1.65, 0.1]],
  ]) {
    await page.evaluate(([x, y, z]) => device.position.set(x, y, z), head);
    // wait until the pictures of both eyes have arrived
    await page.waitForTimeout(900);
    const eyes = await page.evaluate(() => eyes);
    assert.ok(Math.abs(eyes.right.at[0] - eyes.left.at[0] - 0.063) < 1e-3, `the eyes are at ${eyes.left.at} and ${eyes.right.at}`);
    const shot = await page.screenshot({ path: join(SHOTS, `headset-${name}.png`) });
    const size = page.viewportSize();
    const green = await page.evaluate(async (base64) => {
      const picture = await createImageBitmap(await (await fetch(`data:image/png;base64,${base64}`)).blob());
      const context = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
      context.drawImage(picture, 0, 0);
      const { data } = context.getImageData(0, 0, picture.width, picture.height);
      let text = "";
      for (let i = 1; i < data.length; i += 4) text += String.fromCharCode(data[i]);
      return btoa(text);
    }, shot.toString("base64"));
    const bright = Buffer.from(green, "base64");
    for (const eye of [eyes.left, eyes.right]) {
      /** Returns the pixel at which an eye sees a point of the room, from the left and from the top of the screenshot. */
      const seen = (point) => {
        const to = (m, v) => [0, 1, 2, 3].map((row) => [0, 1, 2, 3].reduce((sum, k) => sum + m[row + 4 * k] * v[k], 0));
        const [x, y, , w] = to(eye.projection, to(eye.inverse, [...point, 1]));
        return [eye.x + (0.5 + x / w / 2) * eye.width, size.height - eye.y - (0.5 + y / w / 2) * eye.height];
      };
      for (const { row, col, half, dMm } of [SCENE.far, SCENE.near]) {
        // the preview is ten times as large as the fixture, so 100 pixels measure one metre
        const place = (dx, dy) => seen([centre[0] + (col + 0.5 + dx - SCENE.cols / 2) / 100, centre[1] - (row + 0.5 + dy - SCENE.rows / 2) / 100, centre[2] + dMm / 100]);
        const [left, top] = place(-half - 2, -half - 2);
        const [right, bottom] = place(half + 2, half + 2);
        let [sum, sumX, sumY] = [0, 0, 0];
        for (let y = Math.round(top); y < bottom; y++) {
          for (let x = Math.round(left); x < right; x++) {
            const dark = 1 - LINEAR[bright[y * size.width + x]];
            [sum, sumX, sumY] = [sum + dark, sumX + dark * (x + 0.5), sumY + dark * (y + 0.5)];
          }
        }
        const [x, y] = place(0, 0);
        const found = [sumX / sum, sumY / sum];
        const [[x0, y0], [x1, y1]] = [place(-half - 0.5, -half - 0.5), place(half + 0.5, half + 0.5)];
        const area = sum / ((x1 - x0) * (y1 - y0));
        assert.ok(Math.hypot(found[0] - x, found[1] - y) < 0.8, `${name}, ${dMm}: at ${found}, expected ${[x, y]}`);
        assert.ok(Math.abs(area - 1) < 0.15, `${name}, ${dMm}: ${area} of the area`);
      }
      // outside of the display's edge the room is dark
      const [x, y] = seen([centre[0] + SCENE.cols / 200 + 0.02, centre[1], centre[2]]);
      assert.ok(bright[Math.round(y) * size.width + Math.round(x)] < 10);
    }
  }
  await page.evaluate(() => session.end());
  await page.waitForTimeout(100);
  assert.deepEqual(await pixels(page, [0.1, 0.05]), before, "the viewer shows what it showed");
  assert.deepEqual(page.trouble, []);
  await page.context().close();
});

const value = (number) => ({ value: number });
/** The calibration of a panel with stripes of colours. Its values are similar to the values of real panels, for a smaller screen. */
const STRIPES = { configVersion: "1.0", serial: "LKG-TEST", pitch: value(49.8), slope: value(-6.9), center: value(0.41), viewCone: value(40), invView: value(1), verticalAngle: value(0), DPI: value(491), screenW: value(240), screenH: value(150), flipImageX: value(0), flipImageY: value(0), flipSubp: value(0) };
/** The calibration of a panel with two kinds of pixels. It is higher than wide, and its cone is wider than the viewing zone. */
const CELLS = {
  ...STRIPES,
  configVersion: "3.0",
  slope: value(5.1),
  viewCone: value(60),
  invView: value(0),
  flipImageX: value(1),
  screenW: value(112),
  screenH: value(200),
  CellPatternMode: value(2),
  subpixelCells: [
    { ROffsetX: -0.31, ROffsetY: 0.25, GOffsetX: 0.28, GOffsetY: 0.25, BOffsetX: 0, BOffsetY: -0.25 },
    { ROffsetX: -0.31, ROffsetY: -0.25, GOffsetX: 0.28, GOffsetY: -0.25, BOffsetX: 0, BOffsetY: 0.25 },
  ],
};

async function choose(page, name, content) {
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.click("#lenticular")]);
  await chooser.setFiles({ name, mimeType: "application/json", buffer: Buffer.from(content) });
}

for (const [name, panel] of Object.entries({ stripes: STRIPES, cells: CELLS })) {
  test(`a panel of ${name} shows in every subpixel what the plain reference does`, async () => {
    const page = await dialog();
    await choose(page, "visual.json", JSON.stringify(panel));
    await said(page, /^The picture is woven for LKG-TEST/);
    const text = await shadow(page, "(root) => { const canvas = root.querySelector('.woven'); const copy = document.createElement('canvas'); [copy.width, copy.height] = [canvas.width, canvas.height]; const context = copy.getContext('2d'); context.drawImage(canvas, 0, 0); return btoa(Array.from(context.getImageData(0, 0, canvas.width, canvas.height).data, (byte) => String.fromCharCode(byte)).join('')); }");
    const woven = Buffer.from(text, "base64");
    const get = (key) => panel[key].value;
    const [cols, rows, count] = [get("screenW"), get("screenH"), 48];
    // the expected views have the slopes of the panel's cone, scaled down so that they stay in the
    // viewing zone
    const cone = (get("viewCone") * Math.PI) / 180;
    const share = Math.min(1, Math.tan((SCENE.fovDeg * Math.PI) / 360) / Math.tan(cone / 2));
    const views = [];
    for (let i = 0; i < count; i++) views.push((await pixels(page, [share * Math.tan(((i + 0.5) / count - 0.5) * cone), 0])).data);
    const sample = (data, u, v, c) => {
      const at = (x, n) => Math.min(Math.max(x, 0), n - 1);
      const [x, y] = [u * SCENE.cols - 0.5, v * SCENE.rows - 0.5];
      const [x0, y0] = [Math.floor(x), Math.floor(y)];
      const texel = (dx, dy) => data[4 * (at(y0 + dy, SCENE.rows) * SCENE.cols + at(x0 + dx, SCENE.cols)) + c];
      return (1 - y + y0) * ((1 - x + x0) * texel(0, 0) + (x - x0) * texel(1, 0)) + (y - y0) * ((1 - x + x0) * texel(0, 1) + (x - x0) * texel(1, 1));
    };
    const flip = get("flipImageX") ? -1 : 1;
    const lenses = ((get("pitch") * cols) / get("DPI")) * Math.cos(Math.atan(1 / get("slope")));
    // the whole picture fits into the screen
    const shape = (SCENE.cols / SCENE.rows) * (rows / cols);
    const [wide, high] = [Math.min(shape, 1), Math.min(1 / shape, 1)];
    let compared = 0;
    const used = new Set();
    for (let row = 0; row < rows; row++) {
      for (let col = 0; col < cols; col++) {
        const [u, v] = [((col + 0.5) / cols - 0.5) / wide + 0.5, ((row + 0.5) / rows - 0.5) / high + 0.5];
        // the calibration counts rows from the bottom
        const up = rows - 1 - row;
        for (let c = 0; c < 3; c++) {
          const found = woven[4 * (row * cols + col) + c];
          if (u < 0 || u > 1 || v < 0 || v > 1) {
            assert.equal(found, 0);
            continue;
          }
          const cell = panel.subpixelCells?.[col % 2];
          const [dx, dy] = cell ? [cell[`${"RGB"[c]}OffsetX`], cell[`${"RGB"[c]}OffsetY`]] : [(flip * c) / 3, 0];
          const phase = ((col + 0.5 + dx) / cols + ((up + 0.5 + dy) / rows) * ((flip * rows) / (cols * get("slope")))) * lenses - get("center");
          const part = phase - Math.floor(phase);
          const view = count * (get("invView") ? 1 - part : part);
          // skip positions near the border of two views, where single precision may choose the
          // other view
          if (Math.abs(view - Math.round(view)) < 0.02) continue;
          used.add(Math.floor(view));
          compared++;
          const expected = sample(views[Math.floor(view)], u, v, c);
          assert.ok(Math.abs(found - expected) <= 3, `${name}: row ${row}, column ${col}, ${"RGB"[c]}: ${found}, expected ${expected} of view ${view}`);
        }
      }
    }
    assert.equal(used.size, count);
    assert.ok(compared > 0.9 * 3 * cols * rows * wide * high, `${compared} compared`);
    if (name === "stripes") {
      const [file] = await Promise.all([page.waitForEvent("download"), page.click("#woven")]);
      assert.equal(file.suggestedFilename(), "two-squares_240x150.png");
      await page.screenshot({ path: join(SHOTS, "others-woven.png") });
      await page.click("#fill");
      await page.waitForFunction(() => document.fullscreenElement !== null);
      assert.ok(await shadow(page, "(root) => root.querySelector('.woven').checkVisibility()"));
      await page.evaluate(() => document.exitFullscreen());
      await page.waitForFunction(() => document.fullscreenElement === null);
      assert.ok(!(await shadow(page, "(root) => root.querySelector('.woven').checkVisibility()")));
    }
    assert.deepEqual(page.trouble, []);
    await page.context().close();
  });
}

test("a wrong calibration is refused by file, place, expected and found", async () => {
  const page = await dialog();
  for (const [content, message] of [
    ["{", "visual.json: expected the JSON of a calibration, found"],
    [JSON.stringify({ ...STRIPES, pitch: undefined }), "visual.json: pitch: expected a number above 0, found nothing."],
    [JSON.stringify({ ...STRIPES, slope: value(0) }), "visual.json: slope: expected a number other than 0, found 0."],
    [JSON.stringify({ ...STRIPES, screenW: value(1e9) }), "visual.json: screenW: expected 1 to 16384 pixels, found 1000000000."],
    [JSON.stringify({ ...CELLS, subpixelCells: [CELLS.subpixelCells[0]] }), "visual.json: subpixelCells: expected at least 2 kinds of pixels, found 1."],
    [JSON.stringify({ ...CELLS, subpixelCells: [{}, {}] }), "visual.json: subpixelCells[0].ROffsetX: expected a number, found nothing."],
  ]) {
    await choose(page, "visual.json", content);
    await said(page, /^visual/);
    assert.ok((await status(page)).startsWith(message), await status(page));
    await shadow(page, "(root) => void (root.querySelector('#others-status').textContent = '')");
  }
  await page.context().close();
});

const SESSION = "1a6aed0d-77bf-4129-8e01-71d61c58473d";
const word = (name, text) => ({ name, type: "WSTRING", value: text });
const device = (index, { calibration = "", quilt = "{}", version = "thirdparty", hwid = "" }) => ({
  name: String(index),
  type: "VARIANT_MAP",
  value: {
    calibration: word("calibration", calibration),
    defaultQuilt: word("defaultQuilt", quilt),
    hardwareVersion: word("hardwareVersion", version),
    hwid: word("hwid", hwid),
    index: { name: "index", type: "UNSIGNED_INT", value: index },
    state: word("state", "ok"),
    windowCoords: { name: "windowCoords", type: "INT2", value: { x: 0, y: 0 } },
  },
});
const map = (content) => ({ name: "payload", type: "VARIANT_MAP", value: content });
const GO = device(1, { calibration: JSON.stringify(STRIPES), quilt: JSON.stringify({ quiltAspect: 0.5625, quiltX: 4092, quiltY: 4092, tileX: 11, tileY: 6 }), version: "go_p", hwid: "LKG-E00001" });
/** The expected requests in their order: the name, the types of the keys, and Bridge's answer, as docs.lookingglassfactory.com describes them. */
const TRANSCRIPT = [
  ["enter_orchestration", { name: "string" }, { payload: word("payload", SESSION) }],
  ["available_output_devices", { orchestration: "string" }, { payload: map({ 0: device(0, {}), 1: GO }) }],
  ["delete_playlist", { orchestration: "string", name: "string", loop: "boolean" }, { status: word("status", "Failure") }],
  ["show_window", { orchestration: "string", show_window: "boolean", head_index: "number" }, {}],
  ["instance_playlist", { orchestration: "string", name: "string", loop: "boolean" }, { payload: map({ name: word("name", "Lumistack") }) }],
  [
    "insert_playlist_entry",
    { orchestration: "string", name: "string", id: "number", index: "number", uri: "string", rows: "number", cols: "number", focus: "number", aspect: "number", view_count: "number", crop_pos_x: "number", crop_pos_y: "number", zoom: "number", isRGBD: "number", tag: "string" },
    { payload: map({ index: word("index", "0") }) },
  ],
  ["play_playlist", { orchestration: "string", name: "string", head_index: "number" }, { payload: map({ message: word("message", "") }) }],
];

/** Answers requests in place of Bridge, with the answers of the transcript, which `change` may replace. Returns the list of requests. */
async function bridge(page, change = (_, answer) => answer) {
  const asked = [];
  await page.route("http://localhost:33334/**", async (route) => {
    const request = route.request();
    const step = TRANSCRIPT[asked.length];
    asked.push({ what: new URL(request.url()).pathname.slice(1), method: request.method(), kind: await request.headerValue("content-type"), content: request.postDataJSON() });
    const answer = change(asked.at(-1).what, { name: "value", orchestration: word("orchestration", SESSION), status: word("status", "Completion"), ...step[2] });
    if (answer) await route.fulfill({ json: answer, headers: { "access-control-allow-origin": "*" } });
    else await route.abort("connectionrefused");
  });
  return asked;
}

test("a quilt is handed over to Looking Glass Bridge as its protocol wants it", async () => {
  const page = await dialog();
  const asked = await bridge(page);
  await page.click("#bridge");
  await said(page, /^Bridge reads the quilt from a file\. Enter the folder/);
  await page.fill("#stored", "C:\\Users\\Me\\Downloads");
  const [file] = await Promise.all([page.waitForEvent("download"), page.click("#bridge")]);
  await said(page, /^LKG-E00001 shows two-squares-/);
  await page.screenshot({ path: join(SHOTS, "others-bridge.png") });
  assert.deepEqual(
    asked.map(({ what, method, kind, content }) => [what, method, kind, Object.fromEntries(Object.entries(content).map(([key, value]) => [key, typeof value]))]),
    TRANSCRIPT.map(([what, keys]) => [what, "PUT", "application/json", keys]),
  );
  for (const { what, content } of asked.slice(1)) assert.equal(content.orchestration, SESSION, what);
  const { uri, rows, cols, aspect, view_count: views } = asked.find(({ what }) => what === "insert_playlist_entry").content;
  assert.equal(uri, `C:\\Users\\Me\\Downloads\\${file.suggestedFilename()}`);
  assert.match(uri, /_qs11x6a1\.6\.png$/);
  assert.deepEqual([rows, cols, aspect, views], [6, 11, 1.6, 66]);
  // the PNG file states its width and height at bytes 16 and 20
  const png = readFileSync(await file.path());
  assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [11 * SCENE.cols, 6 * SCENE.rows]);
  assert.deepEqual(page.trouble, []);
  // after a reload, the dialog still contains the folder
  await page.reload();
  assert.equal(await complete(page), undefined);
  assert.equal(await shadow(page, "(root) => root.querySelector('#stored').value"), "C:\\Users\\Me\\Downloads");
  await page.context().close();
});

test("a Bridge that is absent, has no panel or refuses is reported in words", async () => {
  const page = await dialog();
  for (const [change, message] of [
    [() => undefined, /^Looking Glass Bridge does not answer on this computer: .*\. Start Looking Glass Bridge/],
    [(what, answer) => (what === "available_output_devices" ? { ...answer, payload: map({ 0: device(0, {}) }) } : answer), /^Looking Glass Bridge runs, but has no panel\./],
    [(what, answer) => (what === "insert_playlist_entry" ? { ...answer, status: word("status", "Failure") } : answer), /^Looking Glass Bridge: expected “Completion” or “Pending” in the answer to insert_playlist_entry, found “Failure”\./],
  ]) {
    await bridge(page, change);
    await page.fill("#stored", "/home/me/Downloads/");
    await page.click("#bridge");
    await said(page, message);
    await page.unroute("http://localhost:33334/**");
  }
  await page.context().close();
});
