// Makes small previews in memory: path → bytes.
import { deflateSync } from "node:zlib";

const CRC = Array.from({ length: 256 }, (_, n) => {
  let c = n;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c >>> 0;
});

function chunk(type, data) {
  const body = Buffer.concat([Buffer.from(type, "latin1"), data]);
  let crc = 0xffffffff;
  for (const byte of body) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  const out = Buffer.alloc(body.length + 8);
  out.writeUInt32BE(data.length, 0);
  body.copy(out, 4);
  out.writeUInt32BE((crc ^ 0xffffffff) >>> 0, body.length + 4);
  return out;
}

/** Encodes an RGB picture of 8 bits as PNG; `at(row, col)` returns [r, g, b], 0..255. */
export function png(cols, rows, at) {
  const raw = Buffer.alloc(rows * (1 + cols * 3));
  for (let r = 0; r < rows; r++) for (let c = 0; c < cols; c++) raw.set(at(r, c), r * (1 + cols * 3) + 1 + c * 3);
  return pngOf(cols, rows, raw);
}

/** Makes an RGB picture of 8 bits as PNG from the bytes of its rows, which may be fewer than its size needs. */
export function pngOf(cols, rows, raw) {
  const head = Buffer.alloc(13);
  head.writeUInt32BE(cols, 0);
  head.writeUInt32BE(rows, 4);
  head.set([8, 2, 0, 0, 0], 8);
  return Buffer.concat([Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]), chunk("IHDR", head), chunk("IDAT", deflateSync(raw)), chunk("IEND", Buffer.alloc(0))]);
}

const WHITE = [255, 255, 255];
export const SCENE = {
  cols: 64,
  rows: 40,
  pitchMm: 1,
  /** A dark square on each layer: row and column of its centre, half its width in pixels, and the layer's position d in mm. */
  far: { row: 12, col: 20, half: 3, dMm: -24 },
  near: { row: 26, col: 44, half: 3, dMm: 24 },
  fovDeg: 40,
  views: 3,
  frames: 2,
};

/** Makes two clear layers with a dark square on each. From a slope s, a square at position d appears shifted by −d·s on the display plane. */
export function twoSquares() {
  const { cols, rows, pitchMm, far, near, fovDeg, views, frames } = SCENE;
  const files = new Map();
  const listed = [];
  const add = (path, entry, bytes, size) => {
    files.set(path, bytes);
    listed.push({ path, ...entry, cols: size[0], rows: size[1], bytes: bytes.length });
  };
  const square = ({ row, col, half }) =>
    png(cols, rows, (r, c) => (Math.abs(r - row) <= half && Math.abs(c - col) <= half ? [0, 0, 0] : WHITE));
  for (let frame = 0; frame < frames; frame++) {
    [far, near].forEach((spot, layer) => add(`stack/layer${layer}_frame${frame}.png`, { kind: "layer", layer, frame }, square(spot), [cols, rows]));
  }
  const half = Math.tan(((fovDeg / 2) * Math.PI) / 180);
  const slopes = Array.from({ length: views }, (_, a) => ((a - (views - 1) / 2) * 2 * half) / views);
  for (let y = 0; y < views; y++) {
    for (let x = 0; x < views; x++) {
      const [sx, sy] = [slopes[x], -slopes[y]];
      const dark = (r, c) =>
        [far, near].some((s) => Math.abs(r - s.row - (s.dMm * sy) / pitchMm) <= s.half + 0.5 && Math.abs(c - s.col + (s.dMm * sx) / pitchMm) <= s.half + 0.5);
      add(`stack/target_${y}_${x}.png`, { kind: "target", view: [y, x] }, png(cols, rows, (r, c) => (dark(r, c) ? [0, 0, 0] : WHITE)), [cols, rows]);
    }
  }
  const layer = (dMm) => ({ d_mm: dMm, resolution: [cols, rows], pitch_mm: pitchMm });
  const preview = {
    schema: "lumistack-preview",
    version: 1,
    title: "Two squares",
    display: {
      name: "Two layers",
      frames,
      missing: "clear",
      field: { resolution: [cols, rows], pitch_mm: pitchMm, views: [views, views], fov_deg: [fovDeg, fovDeg] },
      layers: [layer(far.dMm), layer(near.dMm)],
    },
    brightness: 1,
    frames,
    target: { rows, cols, pitch_mm: pitchMm, projection: "oblique", slope_x: slopes, slope_y: slopes.map((s) => -s) },
    files: listed,
  };
  files.set("stack/preview.json", Buffer.from(JSON.stringify(preview)));
  return files;
}

/** Copies a preview with changed files (bytes, or undefined to omit a file) and an edited preview.json. */
export function altered(files, changes, edit = (preview) => preview) {
  const out = new Map(files);
  for (const [path, bytes] of Object.entries(changes)) bytes === undefined ? out.delete(path) : out.set(path, bytes);
  if (out.has("stack/preview.json") && !("stack/preview.json" in changes)) {
    const preview = JSON.parse(out.get("stack/preview.json").toString());
    out.set("stack/preview.json", Buffer.from(JSON.stringify(edit(preview))));
  }
  return out;
}
