// Draws the layers of a stack apart from each other, without WebGL. A parallel projection maps
// every layer by an affine transform, which a 2D canvas supports.
import type { Info } from "./info.js";
import type { Slope } from "./state.js";

/** The layers of a display, and the size of its light field. */
export type Stack = Pick<Info, "field" | "layers">;

export interface Exploded {
  slope: Slope;
  yaw: number;
  pitch: number;
  spread: number;
  stack: Stack;
}

/** Fraction of the canvas that the rotated stack fills. */
const FILL = 0.86;
/** Number of drawn rays, evenly spread over the light field's width. */
const RAYS = 5;

/** Draws the backlight, the layers and some rays; `mask` returns the picture of a layer. */
export function explode(context: OffscreenCanvasRenderingContext2D, { slope, yaw, pitch, spread, stack }: Exploded, mask: (layer: number) => OffscreenCanvas): void {
  const on = context.canvas;
  const { layers } = stack;
  const { width_mm, height_mm } = stack.field;
  const count = layers.length;
  const apart = (spread * width_mm * 1.1) / Math.max(count, 2);
  // Position of element i along the normal of the layers, mm. The backlight is element 0, layer n
  // is element n + 1. The middle of the stack is at the origin.
  const place = (i: number): number => (i - count / 2) * apart;
  const [cosY, sinY, cosP, sinP] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const project = (x: number, y: number, z: number): [number, number] => {
    const right = x * cosY + z * sinY;
    const back = z * cosY - x * sinY;
    return [right, y * cosP - back * sinP];
  };
  // Scale the stack to the canvas.
  const halfX = (width_mm / 2) * Math.abs(cosY) + Math.abs(place(count) * sinY);
  const halfY = (height_mm / 2) * cosP + (Math.abs(place(count) * cosY) + (width_mm / 2) * Math.abs(sinY)) * Math.abs(sinP);
  const scale = FILL * Math.min(on.width / 2 / halfX, on.height / 2 / halfY);
  const toCanvas = (x: number, y: number, z: number): [number, number] => {
    const [u, v] = project(x, y, z);
    return [on.width / 2 + u * scale, on.height / 2 - v * scale];
  };
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, on.width, on.height);
  // Draw from back to front.
  const far = Math.cos(yaw) >= 0 ? 0 : count;
  for (let n = 0; n <= count; n++) {
    const i = far === 0 ? n : count - n;
    const layer = layers[i - 1];
    const wide = layer ? layer.cols * layer.pitch_mm : width_mm;
    const high = layer ? layer.rows * layer.pitch_mm : height_mm;
    const corner = toCanvas(-wide / 2, high / 2, place(i));
    const right = toCanvas(wide / 2, high / 2, place(i));
    const down = toCanvas(-wide / 2, -high / 2, place(i));
    const picture = layer && mask(i - 1);
    const cols = picture?.width ?? 1;
    const rows = picture?.height ?? 1;
    context.setTransform((right[0] - corner[0]) / cols, (right[1] - corner[1]) / cols, (down[0] - corner[0]) / rows, (down[1] - corner[1]) / rows, ...corner);
    context.globalAlpha = layer ? 0.82 : 1;
    if (picture) context.drawImage(picture, 0, 0);
    else {
      context.fillStyle = "#fbf6ea";
      context.fillRect(0, 0, 1, 1);
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    outline(context, [corner, right, [right[0] + down[0] - corner[0], right[1] + down[1] - corner[1]], down]);
  }
  // Draw some rays, which have the view's slope, over the layers.
  context.setTransform(1, 0, 0, 1, 0, 0);
  const thin = Math.max(on.width / 600, 1.2);
  const gap = count > 1 ? (layers[count - 1]!.d_mm - layers[0]!.d_mm) / (count - 1) : 1;
  for (let r = 0; r < RAYS; r++) {
    const x = ((r + 0.5) / RAYS - 0.5) * width_mm;
    context.beginPath();
    for (const i of [0, count + 0.7]) {
      const drift = (i - (count + 1) / 2) * gap;
      const point = toCanvas(x + slope[0] * drift, slope[1] * drift, place(i));
      context.lineTo(point[0], point[1]);
    }
    // A wide dark line under a thin bright line is visible on any pattern and in both themes.
    for (const [colour, width] of [
      ["rgb(0 0 0 / 0.6)", 2.6 * thin],
      ["#f2ad3f", thin],
    ] as const) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.stroke();
    }
  }
}

function outline(context: OffscreenCanvasRenderingContext2D, corners: readonly (readonly [number, number])[]): void {
  context.globalAlpha = 1;
  context.beginPath();
  for (const [x, y] of corners) context.lineTo(x, y);
  context.closePath();
  context.strokeStyle = "rgb(128 132 142 / 0.8)";
  context.lineWidth = 1;
  context.stroke();
}
