// The page that solves (`solve.html`) with files of a user: nothing leaves the computer, and files
// that are hostile or too large give a message.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { appendFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { DIST, launch, open } from "./browser.mjs";
import { pngOf, twoSquares } from "./fixture.mjs";
import { glb } from "./glb.mjs";
import { serve } from "./server.mjs";
import { apart, BIN, plain, problem, refusal, save, stage } from "./solving.mjs";

const LETTERS = join(dirname(fileURLToPath(import.meta.url)), "../../scenes/letters/letters.gltf");
/** Largest root mean square difference between the patterns of the page and of the command; `solve.test.mjs` states the reason. */
const SAME = 2e-3;
/** Largest memory of the solver's module in the test of a lack of memory, bytes. */
const MEMORY = 32 << 20;
const skip = !BIN && "LUMISTACK_BIN is not set";

let browser;
let server;
let folder;
/** Method, path and content length of every request that reaches the server. */
const asked = [];
before(async () => {
  browser = await launch();
  server = await serve({ "/": DIST }, (path, _, request) => void asked.push(`${request.method} ${path} ${request.headers["content-length"] ?? 0}`));
  folder = mkdtempSync(join(tmpdir(), "lumistack-files-"));
});
after(async () => {
  await browser?.close();
  await server?.close();
  if (folder) rmSync(folder, { recursive: true });
});

/** Drops files on the page, as the browser does when the user releases the mouse button. */
async function drop(at, ...files) {
  const input = await at.context().newCDPSession(at);
  const data = { items: [], files, dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) await input.send("Input.dispatchDragEvent", { type, x: 900, y: 400, data });
}

/** Sets a control of the panel. */
const choose = (at, id, value) =>
  at.evaluate(
    ([id, value]) => {
      const control = document.getElementById(id);
      control.value = value;
      control.dispatchEvent(new Event(id === "cols" ? "change" : "input"));
    },
    [id, value],
  );

/** Returns a WebAssembly module whose memory cannot grow above `most` bytes. */
function limited(module, most) {
  const PAGE = 65536;
  let at = 8;
  const number = () => {
    for (let [value, shift] = [0, 0]; ; shift += 7) {
      const byte = module[at++];
      value += (byte & 127) * 2 ** shift;
      if (byte < 128) return value;
    }
  };
  const encoded = (value) => (value < 128 ? [value] : [(value & 127) | 128, ...encoded(Math.floor(value / 128))]);
  while (at < module.length) {
    const start = at;
    const [section, length] = [number(), number()];
    if (section !== 5) {
      at += length;
      continue;
    }
    const end = at + length;
    const [memories, flags, least] = [number(), number(), number()];
    assert.deepEqual([memories, flags & ~1], [1, 0], "the module's memory");
    const body = [1, 1, ...encoded(least), ...encoded(most / PAGE)];
    return Buffer.concat([module.subarray(0, start), Buffer.from([5, ...encoded(body.length), ...body]), module.subarray(end)]);
  }
  throw new Error("the module has no memory");
}

/** The letters in one file. The sky is left out, since `glb` does not pack the environment's picture. */
const letters = (edit = () => undefined) =>
  glb(LETTERS, (gltf) => {
    for (const scene of gltf.scenes) delete scene.extras;
    edit(gltf);
  });

test("a dropped .glb becomes the command's patterns, and nothing is uploaded", { skip }, async (t) => {
  const model = join(folder, "letters.glb");
  writeFileSync(model, letters());
  asked.length = 0;
  const requests = [];
  const seen = (request) => requests.push([request.method(), request.url(), request.postDataBuffer()?.length ?? 0]);
  const at = await open(browser, `${server.url}/solve.html#preset=paper-three-layer&cols=96&frames=2&zone_samples=40&iterations=4`, { seen });
  at.on("websocket", (socket) => requests.push(["WEBSOCKET", socket.url(), 0]));
  await at.waitForFunction(() => document.querySelector("#preset").options.length > 0);
  await drop(at, model);
  await stage(at, "done");
  assert.ok(await at.isHidden("#problem"));
  const ours = await save(at, join(folder, "page"));
  await Promise.all([at.waitForEvent("download"), at.click("#quilt")]);
  writeFileSync(join(ours, "letters.glb"), letters());
  const theirs = join(folder, "command");
  // The command's own score of the display would take longer than the patterns.
  appendFileSync(join(ours, "job.toml"), "\n[report]\nzone_directions = 0\n");
  execFileSync(BIN, ["run", join(ours, "job.toml"), "-o", theirs], { stdio: "pipe" });
  assert.ok(apart(ours, theirs) < SAME, `${apart(ours, theirs)}`);

  // Every request reads a file of this server, or data of the page itself.
  const foreign = requests.filter(([method, url, bytes]) => method !== "GET" || bytes > 0 || !(url.startsWith(`${server.url}/`) || /^(blob|data):/.test(url)));
  assert.deepEqual(foreign, []);
  assert.ok(requests.some(([, url]) => url.endsWith("/lumistack_web_decoders_bg.wasm")), "no requests of the solver's thread are recorded");
  assert.deepEqual(asked.filter((line) => !/^GET \S+ 0$/.test(line)), []);
  assert.ok(asked.every((line) => !line.includes("letters")), asked.join("\n"));
  // The page's policy also forbids other requests, in the page and in its threads.
  let reached = 0;
  const other = createServer((_, response) => {
    reached += 1;
    response.writeHead(200, { "access-control-allow-origin": "*" }).end();
  });
  t.after(() => other.close());
  await new Promise((resolve) => other.listen(0, "127.0.0.1", resolve));
  const address = `http://127.0.0.1:${other.address().port}/`;
  const send = (address) => fetch(address, { method: "POST", body: "a model" }).then(() => "sent", () => "refused");
  const threads = at.workers();
  assert.ok(threads.length >= 2, `${threads.length} threads`);
  for (const from of [at, ...threads]) assert.equal(await from.evaluate(send, address), "refused");
  assert.equal(reached, 0);
  // Without the policy the same request arrives.
  const free = await at.context().newPage();
  await free.goto(`${server.url}/index.html`);
  assert.equal(await free.evaluate(send, address), "sent");
  assert.equal(reached, 1);
  await at.context().close();
});

test("each module of decoders is loaded once, by a file that needs it", async () => {
  const plain = letters((gltf) => {
    for (const { pbrMetallicRoughness } of gltf.materials) delete pbrMetallicRoughness.baseColorTexture;
    for (const key of ["images", "textures", "samplers"]) delete gltf[key];
  });
  for (const [name, bytes, expected] of [
    ["plain.glb", plain, []],
    ["letters.glb", letters(), ["pictures"]],
    ["dandelion.spz", readFileSync(join(dirname(LETTERS), "../dandelion/dandelion.spz")), ["decoders"]],
  ]) {
    const loaded = [];
    const seen = (request) => loaded.push(...request.url().matchAll(/lumistack_web_(pictures|decoders)_bg\.wasm$/g));
    const at = await open(browser, `${server.url}/solve.html#preset=paper-three-layer&cols=48&frames=2&zone_samples=20&iterations=1&device=cpu`, { seen });
    await at.waitForFunction(() => document.querySelector("#preset").options.length > 0);
    writeFileSync(join(folder, name), bytes);
    await drop(at, join(folder, name));
    await stage(at, "done");
    assert.deepEqual(loaded.map(([, which]) => which), expected, name);
    await at.context().close();
  }
});

test("hostile files give the command's message, and the page stays usable", { skip }, async () => {
  const at = await open(browser, `${server.url}/solve.html#preset=paper-three-layer&cols=96&frames=2&zone_samples=30&iterations=1`);
  await at.waitForFunction(() => document.querySelector("#preset").options.length > 0);
  const npy = (shape) => Buffer.concat([Buffer.from("\x93NUMPY\x01\x00v\x00", "latin1"), Buffer.from(`${`{'descr': '<f4', 'fortran_order': False, 'shape': (${shape}), }`.padEnd(117)}\n`), Buffer.alloc(64)]);
  const files = {
    // Each file states or contains far more data than its size suggests.
    "bomb_qs3x3.png": ["factorize", pngOf(20_000, 20_000, Buffer.alloc(1000))],
    // The number of these values does not fit into the 32 bits of the module's addresses.
    "huge.npy": ["factorize", npy("9, 9, 60000, 60000, 3")],
    "bomb.spz": ["info", gzipSync(Buffer.alloc(200_000_000))],
    "bomb.glb": ["info", letters(({ accessors }) => (accessors[0].count = 4_000_000_000))],
  };
  for (const [name, [command, bytes]] of Object.entries(files)) {
    writeFileSync(join(folder, name), bytes);
    await drop(at, join(folder, name));
    await at.waitForFunction((name) => document.querySelector("#problem").textContent.includes(name), name);
    const said = await problem(at);
    const { status, message } = refusal(folder, command, name, ...(command === "info" ? [] : ["-o", join(folder, "run")]));
    assert.notEqual(status, 0, name);
    assert.ok(message.includes(plain(said)), `page: ${said}\ncommand: ${message}`);
  }
  await at.click("text=Dandelion");
  await stage(at, "done");
  assert.ok(await at.isHidden("#problem"));
  await at.context().close();
});

test("patterns can be saved only while the page shows them", async () => {
  const at = await open(browser, `${server.url}/solve.html#scene=letters&preset=paper-three-layer&cols=48&frames=2&zone_samples=20&iterations=1&threads=1&device=cpu`);
  const canSave = () => at.isEnabled("#save");
  await stage(at, "done");
  assert.ok(await canSave());
  // After an error the thread has no patterns.
  const bad = join(folder, "bad.glb");
  writeFileSync(bad, "no model");
  await drop(at, bad);
  await problem(at);
  assert.ok(!(await canSave()), "after an error");
  await at.click("text=Dandelion");
  await at.waitForFunction(() => document.querySelector("#status").textContent.startsWith("Finished.") && !document.querySelector("#save").disabled);
  // A preview has no patterns of the thread.
  await at.setInputFiles("#files", [...twoSquares()].map(([path, buffer]) => ({ name: path.replace("stack/", ""), mimeType: path.endsWith(".json") ? "application/json" : "image/png", buffer })));
  await at.waitForFunction(() => document.querySelector("#status").textContent.includes("is a preview"));
  assert.ok(!(await canSave()), "in a preview");
  await at.click("text=Dandelion");
  await at.waitForFunction(() => document.querySelector("#status").textContent.startsWith("Finished.") && !document.querySelector("#save").disabled);
  // The thread never finishes reading the next file.
  for (const thread of at.workers()) await thread.evaluate(() => void (Blob.prototype.arrayBuffer = () => new Promise(() => undefined)));
  await drop(at, bad);
  await at.waitForFunction(() => document.querySelector("#status").textContent.startsWith("Reading the files"));
  assert.ok(!(await canSave()), "while a file is read");
  await at.context().close();
});

test("a display that is too large, and a lack of memory, give a message, and a smaller display is solved", async (t) => {
  const at = await open(browser, `${server.url}/solve.html#scene=letters&preset=paper-three-layer&cols=420&layers=5&frames=12&zone_samples=20&iterations=1&threads=1`);
  assert.match(await problem(at), /display: expected at most \d+ MB, found \d+ MB for this display; take fewer columns or frames/);
  await choose(at, "cols", "96");
  await choose(at, "frames", "2");
  await at.waitForFunction(() => performance.getEntriesByName("lumistack-first-patterns").length > 0);
  assert.ok(await at.isHidden("#problem"));
  await at.context().close();

  // The same page with a module whose memory ends early.
  const poor = await serve({ "/": DIST }, (path, response) => {
    if (!path.endsWith("lumistack_web_solver_bg.wasm")) return false;
    response.writeHead(200, { "content-type": "application/wasm" }).end(limited(readFileSync(join(DIST, path)), MEMORY));
    return true;
  });
  t.after(() => poor.close());
  const small = await open(browser, `${poor.url}/solve.html#scene=letters&preset=paper-three-layer&cols=420&frames=12&zone_samples=20&iterations=1&threads=1&device=cpu`);
  assert.match(await problem(small), /^Letters: the solver stopped, probably because it needs more memory than a page can have\. Choose less detail or fewer frames/);
  await choose(small, "cols", "96");
  await choose(small, "frames", "2");
  await small.waitForFunction(() => performance.getEntriesByName("lumistack-first-patterns").length > 0);
  assert.ok(await small.isHidden("#problem"));
  await small.context().close();
});
