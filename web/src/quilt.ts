// Makes a quilt for lenticular displays: views of the display along one row of slopes.
import { toPng } from "./capture.js";
import type { Info } from "./info.js";
import type { Slope } from "./state.js";

/** Columns and rows of tiles, as the smallest lenticular displays use them. */
const [COLUMNS, ROWS] = [8, 6];

/**
 * Returns the slopes of `count` views from left to right, on the central row of the target's views;
 * of two central rows on the upper one. The zone is divided into `count` equal parts, and each view
 * is at the centre of its part. If the target has A views per row, view i is at the index
 * (i + ½) / count · A − ½ among them, as in the quilts of the command.
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
 * Draws all views; view 0 is the tile at the bottom left. `picture` returns the view from a slope
 * in the light field's size. `ending` is the end of the file's name, which states the layout.
 */
export async function quilt(info: Info, picture: (slope: Slope) => Promise<ImageData>): Promise<{ blob: Blob; ending: string }> {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d")!;
  for (const [i, slope] of slopesAcross(info, COLUMNS * ROWS).entries()) {
    const view = await picture(slope);
    if (i === 0) [canvas.width, canvas.height] = [COLUMNS * view.width, ROWS * view.height];
    context.putImageData(view, (i % COLUMNS) * view.width, (ROWS - 1 - Math.floor(i / COLUMNS)) * view.height);
  }
  const aspect = Math.round((1e5 * info.field.width_mm) / info.field.height_mm) / 1e5;
  return { blob: await toPng(canvas), ending: `_qs${COLUMNS}x${ROWS}a${aspect}.png` };
}
