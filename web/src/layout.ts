// Computes the picture's size. The picture is as large as the space allows, and has the shape of
// the light field or of the selected mask.
import type { Info } from "./info.js";
import { sizeOf } from "./sheet.js";
import type { State } from "./state.js";

export interface Layout {
  /** Width and height of the box around one or two pictures, and of one picture, CSS pixels. */
  box: [number, number];
  one: [number, number];
  /** True if the box contains two pictures, one above the other. */
  tall: boolean;
  /** Width over height of the content: of one picture, or of two together. */
  aspect: number;
}

/** Space around the picture on wide and on narrow pages, and between two pictures, CSS pixels. */
const MARGIN = { wide: 28, narrow: 10 };
const BETWEEN = 12;

/** Computes the layout. If only the size of a poster is known, its pixels determine the shape. */
export function layOut(info: Info | { field: { cols: number; rows: number } }, state: State, room: [number, number], narrow: boolean): Layout {
  const margin = narrow ? MARGIN.narrow : MARGIN.wide;
  const [roomX, roomY] = [Math.max(room[0] - 2 * margin, 1), Math.max(room[1] - 2 * margin, 1)];
  let aspect = "layers" in info ? info.field.width_mm / info.field.height_mm : info.field.cols / info.field.rows;
  if (state.mode === "exploded") return { box: room, one: room, tall: false, aspect };
  if (state.mode === "layers" && "layers" in info) {
    const [cols, rows] = sizeOf(info, state.layer);
    aspect = cols / rows;
  }
  if (state.mode === "compare" && state.comparison === "side") {
    const across = Math.min((roomX - BETWEEN) / 2, roomY * aspect);
    const down = Math.min(roomX, ((roomY - BETWEEN) / 2) * aspect);
    const tall = down > across;
    const width = Math.max(across, down);
    const height = width / aspect;
    return {
      box: tall ? [width, 2 * height + BETWEEN] : [2 * width + BETWEEN, height],
      one: [width, height],
      tall,
      aspect: tall ? aspect / 2 : aspect * 2,
    };
  }
  const one: [number, number] = roomX / roomY > aspect ? [roomY * aspect, roomY] : [roomX, roomX / aspect];
  return { box: one, one, tall: false, aspect };
}
