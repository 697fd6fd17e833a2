// Pictures that the viewer shows while the patterns load: blends of small views from several
// slopes.
import type { Around } from "./info.js";
import type { Slope } from "./state.js";

export class Surroundings {
  private constructor(
    private readonly quilt: ImageBitmap,
    private readonly around: Around,
  ) {}

  /** Decodes `bytes`, the content of the file `around.path`, which holds all views side by side. */
  static async of(around: Around, bytes: Uint8Array<ArrayBuffer>): Promise<Surroundings> {
    return new Surroundings(await createImageBitmap(new Blob([bytes], { type: "image/jpeg" })), around);
  }

  /** Draws the mean of the four views nearest to the slope [x, y], weighted bilinearly. */
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
        // Drawing a picture with an alpha scales the pictures under it by 1 − alpha. So the alpha
        // must be the picture's weight divided by the sum of all weights so far.
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
 * Returns the two views next to a slope, one on either side, each as [index, weight]. `slopes` must
 * be evenly spaced. If the slope is outside the range of `slopes`, the outermost view has all the
 * weight.
 */
export function between(slopes: readonly number[], slope: number): [[number, number], [number, number]] {
  const last = slopes.length - 1;
  if (last === 0) return [[0, 1], [0, 0]];
  const place = Math.min(Math.max(((slope - slopes[0]!) / (slopes[last]! - slopes[0]!)) * last, 0), last);
  const first = Math.min(Math.floor(place), last - 1);
  return [[first, 1 - (place - first)], [first + 1, place - first]];
}
