// Pictures while the patterns load: one from the middle, and blends of small views around it.
import type { Around } from "./info.js";
import type { Slope } from "./state.js";

export class Surroundings {
  /** Columns and rows of the canvas: those of a view. */
  private constructor(
    private readonly quilt: ImageBitmap,
    private readonly around: Around,
  ) {}

  /** Decodes the picture; its bytes are those of `around.path`. */
  static async of(around: Around, bytes: Uint8Array<ArrayBuffer>): Promise<Surroundings> {
    return new Surroundings(await createImageBitmap(new Blob([bytes], { type: "image/jpeg" })), around);
  }

  /** Draws the four nearest views with their weights. */
  draw(on: HTMLCanvasElement, [x, y]: Slope): void {
    const { cols, rows, slope_x, slope_y } = this.around;
    if (on.width !== cols) on.width = cols;
    if (on.height !== rows) on.height = rows;
    const context = on.getContext("2d")!;
    const [left, right] = between(slope_x, x);
    const [above, below] = between(slope_y, y);
    let sum = 0;
    for (const [row, high] of [above, below]) {
      for (const [col, wide] of [left, right]) {
        const share = high * wide;
        if (share === 0) continue;
        // Each picture covers those before it, so its alpha is its weight among all so far.
        sum += share;
        context.globalAlpha = share / sum;
        context.drawImage(this.quilt, col * cols, row * rows, cols, rows, 0, 0, cols, rows);
      }
    }
  }

  free(): void {
    this.quilt.close();
  }
}

/**
 * The indices on either side of a slope and their weights. Slopes rise or fall; past the last one
 * the last view is used.
 */
export function between(slopes: readonly number[], slope: number): [[number, number], [number, number]] {
  const last = slopes.length - 1;
  if (last === 0) return [[0, 1], [0, 0]];
  const place = Math.min(Math.max(((slope - slopes[0]!) / (slopes[last]! - slopes[0]!)) * last, 0), last);
  const first = Math.min(Math.floor(place), last - 1);
  return [[first, 1 - (place - first)], [first + 1, place - first]];
}
