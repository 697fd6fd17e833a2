// The canvas agrees with the forward model in Rust, both with WebGL2 and with the processor.
//
// `cargo xtask web` writes the references into tests/fixtures, one folder per display. A folder
// contains a preview, and the views L̃/β that the simulator of lumistack-display computes at nine
// slopes.
import assert from "node:assert/strict";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { complete, launch, LINEAR, open, pixels, site } from "./browser.mjs";

const FIXTURES = process.env.LUMISTACK_FIXTURES ?? join(dirname(fileURLToPath(import.meta.url)), "fixtures");
/** Displays for which references must exist. */
const CASES = ["uniform3", "directional", "mixed", "layers8"];
/** Smallest PSNR of the canvas against the reference, dB. Rounding to 8 bits of sRGB alone gives about 56 dB. */
const LEAST_DB = 45;

let browser;
before(async () => {
  assert.ok(existsSync(FIXTURES), `${FIXTURES} is missing: \`cargo xtask web\` writes it`);
  browser = await launch();
});
after(() => browser?.close());

test("the references contain every kind of display", () => {
  const found = readdirSync(FIXTURES);
  for (const name of CASES) assert.ok(found.includes(name), `${name} is missing among ${found.join(", ")}`);
});

for (const name of CASES) {
  for (const renderer of ["webgl2", "cpu"]) {
    test(`${name} on ${renderer}: nine positions`, async () => {
      const folder = join(FIXTURES, name);
      const { slopes, rows, cols, files, brightness } = JSON.parse(readFileSync(join(folder, "references.json"), "utf8"));
      assert.equal(slopes.length, 9);
      const server = await site(folder);
      const query = `?renderer=${renderer}`;
      // With gain 1 no value exceeds white, so clipping cannot hide an error.
      const plain = await open(browser, `${server.url}/${query}#gain=1`);
      const adapted = await open(browser, `${server.url}/${query}`);
      try {
        for (const page of [plain, adapted]) {
          assert.equal(await complete(page), undefined);
          assert.equal(await page.evaluate(() => document.querySelector("lumistack-viewer").path), renderer);
        }
        for (const [i, slope] of slopes.entries()) {
          const bytes = readFileSync(join(folder, files[i]));
          const reference = new Float32Array(bytes.buffer, bytes.byteOffset, rows * cols * 3);
          for (const [page, gain, white] of [[plain, 1, Infinity], [adapted, 1 / brightness, 1]]) {
            const shown = await pixels(page, slope);
            assert.deepEqual([shown.width, shown.height], [cols, rows]);
            const { db, mean, deviation } = compare(shown.data, reference, gain * brightness, white);
            const where = `gain ${gain} at ${slope.map((s) => s.toFixed(3)).join(", ")}`;
            console.log(`  ${name} ${renderer} ${where}: ${db.toFixed(1)} dB`);
            assert.ok(mean > 0.01, `black, ${where}: mean ${mean}`);
            if (page === plain) assert.ok(deviation > 0.01, `one colour, ${where}: deviation ${deviation}`);
            assert.ok(db >= LEAST_DB, `${db.toFixed(1)} dB, ${where}; expected ${LEAST_DB}`);
          }
        }
        for (const page of [plain, adapted]) assert.deepEqual(page.trouble, []);
      } finally {
        await plain.context().close();
        await adapted.context().close();
        await server.close();
      }
    });
  }
}

/**
 * Compares a picture with the reference L̃/β. `db` is a PSNR with peak 1: it compares the picture's
 * linear values, divided by `scale`, with the reference, clipped at `white`. `mean` and `deviation`
 * are the mean and the standard deviation of the picture's values.
 */
function compare(rgba, reference, scale, white) {
  let [squares, sum, sum2] = [0, 0, 0];
  for (let p = 0; p < reference.length / 3; p++) {
    for (let k = 0; k < 3; k++) {
      const shown = LINEAR[rgba[p * 4 + k]] / scale;
      squares += (shown - Math.min(reference[p * 3 + k], white)) ** 2;
      sum += shown;
      sum2 += shown * shown;
    }
  }
  const mean = sum / reference.length;
  return { db: -10 * Math.log10(Math.max(squares / reference.length, 1e-12)), mean, deviation: Math.sqrt(Math.max(sum2 / reference.length - mean * mean, 0)) };
}
