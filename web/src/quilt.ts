// Makes a quilt for lenticular displays: views of the display along one row of slopes.
import { toPng } from "./capture.js";
import type { Info } from "./info.js";
import type { Views } from "./others.js";
import type { Slope } from "./state.js";

/** Columns and rows of a quilt for an unknown panel; the smallest lenticular displays use this layout. */
const [COLUMNS, ROWS] = [8, 6];

/** Columns and rows of views. */
export interface Layout {
  columns: number;
  rows: number;
}

/**
 * Returns the slopes of `count` views from left to right. They lie on the central row of the
 * target's views; if two rows are central, on the upper row. The row is divided into `count` equal
 * parts, and each view is at the centre of its part. If the target has A views per row, view i is
 * at the index (i + ½) / count · A − ½ of the row, as in the quilts of the command.
 */
export function slopesAcross({ views }: Pick<Info, "views">, count: number): Slope[] {
  const start = Math.floor((views.rows - 1) / 2) * views.cols;
  const row = views.slopes.slice(start, start + views.cols);
  const last = row.length - 1;
  return Array.from({ length: count }, (_, i) => {
    const place = ((i + 0.5) / count) * row.length - 0.5;
    const from = Math.max(Math.min(Math.floor(place), last - 1), 0);
    const [[a, y], [b]] = [row[from]!, row[Math.min(from + 1, last)]!];
    return [a + (place - from) * (b - a), y];
  });
}

/**
 * A quilt with two further values: the end of its file's name, which states the layout, and the
 * width of a view over its height.
 */
export interface Quilt {
  blob: Blob;
  ending: string;
  aspect: number;
}

/** Draws all views, view 0 as the bottom-left tile. */
export async function quilt(views: Views, { columns, rows }: Layout = { columns: COLUMNS, rows: ROWS }): Promise<Quilt> {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d")!;
  try {
    for (const [i, slope] of slopesAcross(views.info, columns * rows).entries()) {
      const view = await views.picture(slope);
      if (i === 0) [canvas.width, canvas.height] = [columns * view.width, rows * view.height];
      context.drawImage(view, (i % columns) * view.width, (rows - 1 - Math.floor(i / columns)) * view.height);
      view.close();
    }
  } finally {
    views.done();
  }
  const { width_mm, height_mm } = views.info.field;
  const aspect = Math.round((1e5 * width_mm) / height_mm) / 1e5;
  return { blob: await toPng(canvas), ending: `_qs${columns}x${rows}a${aspect}.png`, aspect };
}
