// What the canvas shows is what the Rust forward model says, on the graphics processor and without it.
//
// The references are written by `cargo xtask web` into tests/fixtures: one folder per display, each a preview and the views L̃/β of
// lumistack-display's own simulator at nine slopes.
import assert from "node:assert/strict";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { complete, launch, LINEAR, open, pixels, site } from "./browser.mjs";

const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
/** Displays that must be among the fixtures. */
const CASES = ["uniform3", "directional", "mixed", "layers8"];
/** PSNR of what is on the canvas against the reference; 8 bits of sRGB alone leave some 56 dB. */
const LEAST_DB = 45;

let browser;
before(async () => {
  assert.ok(existsSync(FIXTURES), `${FIXTURES} is missing: \`cargo xtask web\` writes it`);
  browser = await launch();
});
after(() => browser?.close());

test("every kind of display is among the references", () => {
  const found = readdirSync(FIXTURES);
  for (const name of CASES) assert.ok(found.includes(name), `${name} is missing among ${found.join(", ")}`);
});

for (const name of CASES) {
  for (const renderer of ["webgl2", "cpu"]) {
    test(`${name} on ${renderer}: nine positions`, async () => {
      const folder = join(FIXTURES, name);
      const { slopes, rows, cols, files } = JSON.parse(readFileSync(join(folder, "references.json"), "utf8"));
      assert.equal(slopes.length, 9);
      const server = await site(folder);
      const page = await open(browser, `${server.url}/${renderer === "cpu" ? "?renderer=cpu" : ""}`);
      try {
        assert.equal(await complete(page), undefined);
        assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").path), renderer);
        for (const [i, slope] of slopes.entries()) {
          const shown = await pixels(page, slope);
          assert.deepEqual([shown.width, shown.height], [cols, rows]);
          const bytes = readFileSync(join(folder, files[i]));
          const reference = new Float32Array(bytes.buffer, bytes.byteOffset, rows * cols * 3);
          const { db, mean } = compare(shown.data, reference);
          console.log(`  ${name} ${renderer} ${slope.map((s) => s.toFixed(3)).join(", ")}: ${db.toFixed(1)} dB`);
          assert.ok(mean > 0.01, `the picture at ${slope} is black: mean ${mean}`);
          assert.ok(db >= LEAST_DB, `${db.toFixed(1)} dB at ${slope}, expected ${LEAST_DB}`);
        }
        assert.deepEqual(page.trouble, []);
      } finally {
        await page.context().close();
        await server.close();
      }
    });
  }
}

/** PSNR with peak 1 of what can be shown, 0..1, and the picture's mean. */
function compare(rgba, reference) {
  let squares = 0;
  let sum = 0;
  for (let p = 0; p < reference.length / 3; p++) {
    for (let k = 0; k < 3; k++) {
      const shown = LINEAR[rgba[p * 4 + k]];
      squares += (shown - Math.min(Math.max(reference[p * 3 + k], 0), 1)) ** 2;
      sum += shown;
    }
  }
  return { db: -10 * Math.log10(Math.max(squares / reference.length, 1e-12)), mean: sum / reference.length };
}
