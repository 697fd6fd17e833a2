// A light field for the tests of `solve.html`, the page that solves.
import { writeFileSync } from "node:fs";

/** Writes an array of 3 × 5 views of stripes at two depths, as .npy. */
export function stripes(path) {
  const [rows, cols, height, width] = [3, 5, 40, 64];
  const values = new Float32Array(rows * cols * height * width * 3);
  let at = 0;
  for (let y = 0; y < rows; y++)
    for (let x = 0; x < cols; x++)
      for (let row = 0; row < height; row++)
        for (let col = 0; col < width; col++) {
          const near = (col + 2 * x) % 16 < 5 && (row + y) % 12 > 3;
          values.set([near ? 0.8 : 0.05, (col + 60 - x) % 9 < 4 ? 0.5 : 0.1, near ? 0.1 : 0.3], at);
          at += 3;
        }
  const header = `{'descr': '<f4', 'fortran_order': False, 'shape': (${rows}, ${cols}, ${height}, ${width}, 3), }`.padEnd(117) + "\n";
  writeFileSync(path, Buffer.concat([Buffer.from("\x93NUMPY\x01\x00v\x00", "latin1"), Buffer.from(header), Buffer.from(values.buffer)]));
}
