// Weaves the views for a lenticular panel: each subpixel shows the view in whose direction a lens
// sends the subpixel's light.
import { zoneSlope, type Info } from "./info.js";
import type { Views } from "./others.js";
import { Problem } from "./problem.js";
import { link } from "./program.js";
import type { Slope } from "./state.js";

/** Number of woven views. More would not be visible, since a lens covers fewer subpixels. */
const VIEWS = 48;

/** Lens and screen of one panel, from its calibration file. */
export interface Calibration {
  serial: string;
  /** Size of the screen, pixels. */
  cols: number;
  rows: number;
  /** Number of lenses across the width of the screen. */
  pitch: number;
  /** Shift of the lenses from the bottom of the screen to its top, screen widths. */
  tilt: number;
  /** Phase of the lens at the bottom left of the screen, as a fraction of a lens. */
  centre: number;
  /** True if the panel sends the first view to the right, and not to the left. */
  inverted: boolean;
  /** Full angle over which the panel spreads the views, radians. */
  coneRad: number;
  /** Positions of red, green and blue in each kind of pixel, relative to the pixel's middle, pixels. */
  cells: readonly (readonly [number, number])[][];
  /** Number of the rule that assigns a kind to each pixel. */
  pattern: number;
}

/** Largest width and height of the screen, pixels; most graphics drivers have this limit. */
const MOST_PX = 16_384;

type Check = readonly [what: string, right: (value: number) => boolean];
const ANY: Check = ["a number", () => true];
const FIELDS = {
  pitch: ["a number above 0", (value) => value > 0],
  slope: ["a number other than 0", (value) => value !== 0],
  center: ANY,
  viewCone: ["degrees between 0 and 180", (value) => value > 0 && value < 180],
  DPI: ["a number above 0", (value) => value > 0],
  screenW: [`1 to ${MOST_PX} pixels`, isSize],
  screenH: [`1 to ${MOST_PX} pixels`, isSize],
} as const satisfies Record<string, Check>;
/** Fields that some calibration files lack, with their defaults. */
const OPTIONAL = {
  invView: [0, ["0 or 1", isFlag]],
  flipImageX: [0, ["0 or 1", isFlag]],
  flipSubp: [0, ["0 or 1", isFlag]],
  CellPatternMode: [0, ["0 to 4", (value) => [0, 1, 2, 3, 4].includes(value)]],
} as const satisfies Record<string, readonly [number, Check]>;
const OFFSETS = ["ROffsetX", "ROffsetY", "GOffsetX", "GOffsetY", "BOffsetX", "BOffsetY"] as const;

function isSize(value: number): boolean {
  return Number.isInteger(value) && value >= 1 && value <= MOST_PX;
}

function isFlag(value: number): boolean {
  return value === 0 || value === 1;
}

/**
 * Reads a calibration file; messages name the file by `name`. `plugins/quilt/src/weave.rs` reads
 * the same fields and has the same equations.
 */
export function calibrationOf(text: string, name: string): Calibration {
  const wrong = (place: string, expected: string, found: unknown): Problem =>
    new Problem(`${name}: ${place}expected ${expected}, found ${JSON.stringify(found) ?? "nothing"}.`, "Choose the panel's visual.json, as the maker's software stores it.", false);
  let file: Record<string, unknown>;
  try {
    file = JSON.parse(text) as Record<string, unknown>;
  } catch {
    throw wrong("", "the JSON of a calibration", text.slice(0, 20));
  }
  if (typeof file !== "object" || file === null) throw wrong("", "the JSON of a calibration", file);
  const number = (key: string, found: unknown, [what, right]: Check): number => {
    if (typeof found !== "number" || !Number.isFinite(found) || !right(found)) throw wrong(`${key}: `, what, found);
    return found;
  };
  // A value is a number, or an object whose key `value` is a number.
  const value = (key: string): unknown => {
    const found = file[key];
    return typeof found === "object" && found !== null && "value" in found ? found.value : found;
  };
  const needed = (key: keyof typeof FIELDS): number => number(key, value(key), FIELDS[key]);
  const optional = (key: keyof typeof OPTIONAL): number => (value(key) === undefined ? OPTIONAL[key][0] : number(key, value(key), OPTIONAL[key][1]));
  const [cols, rows, slope] = [needed("screenW"), needed("screenH"), needed("slope")];
  const flip = optional("flipImageX") === 1 ? -1 : 1;
  const kinds = Array.isArray(file["subpixelCells"]) ? (file["subpixelCells"] as Record<string, unknown>[]) : [];
  const pattern = optional("CellPatternMode");
  // On some panels the leftmost subpixel is blue.
  const order = optional("flipSubp") === 1 ? [2, 1, 0] : [0, 1, 2];
  const cells = kinds.map((kind, i) => {
    const at = OFFSETS.map((key) => number(`subpixelCells[${i}].${key}`, kind?.[key], ANY));
    return order.map((place) => [at[2 * place]!, at[2 * place + 1]!] as [number, number]);
  });
  const wanted = [1, 2, 2, 4, 2][pattern]!;
  if (cells.length > 0 && cells.length < wanted) throw wrong("subpixelCells: ", `at least ${wanted} kinds of pixels`, cells.length);
  return {
    serial: typeof file["serial"] === "string" ? file["serial"] : "",
    cols,
    rows,
    pitch: (needed("pitch") * cols * Math.cos(Math.atan(1 / slope))) / needed("DPI"),
    tilt: (flip * rows) / (cols * slope),
    centre: needed("center"),
    inverted: optional("invView") === 1,
    coneRad: (needed("viewCone") * Math.PI) / 180,
    // Without kinds of pixels, the three colours are stripes from left to right.
    cells: cells.length > 0 ? cells : [order.map((place) => [(flip * place) / 3, 0] as [number, number])],
    pattern: cells.length > 0 ? pattern : 0,
  };
}

/**
 * Returns the slopes of the views, from the left. They are the slopes of the panel's cone. If the
 * viewing zone is narrower than the cone, the slopes are scaled to the zone, so that no view is
 * outside of the zone. The panel spreads these views over the cone, which makes depth flatter.
 */
export function slopesOf(info: Pick<Info, "zone">, { coneRad }: Pick<Calibration, "coneRad">, count: number): Slope[] {
  const half = Math.tan(coneRad / 2);
  const scale = Math.min(1, zoneSlope(info as Info)[0] / half);
  return Array.from({ length: count }, (_, i) => [scale * Math.tan(((i + 0.5) / count - 0.5) * coneRad), 0]);
}

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int; precision highp sampler2DArray;
uniform sampler2DArray views;
uniform vec2 size, extent;
uniform float pitch, tilt, centre, count;
uniform bool inverted;
uniform int pattern;
uniform vec2 cells[12];
out vec4 colour;
int kind(ivec2 pixel) {
  if (pattern == 1) return (pixel.x + pixel.y) & 1;
  if (pattern == 2) return pixel.x & 1;
  if (pattern == 3) return (pixel.y + 2 * (pixel.x & 1)) & 3;
  if (pattern == 4) return pixel.y & 1;
  return 0;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 on = (gl_FragCoord.xy / size - 0.5) / extent + 0.5;
  vec3 light = vec3(0.0);
  bool inside = all(greaterThanEqual(on, vec2(0.0))) && all(lessThanEqual(on, vec2(1.0)));
  for (int c = 0; c < 3; c++) {
    vec2 lens = (gl_FragCoord.xy + cells[3 * kind(pixel) + c]) / size;
    float phase = fract((lens.x + lens.y * tilt) * pitch - centre);
    if (inverted) phase = 1.0 - phase;
    float view = min(floor(phase * count), count - 1.0);
    light[c] = texture(views, vec3(on.x, 1.0 - on.y, view))[c];
  }
  colour = vec4(inside ? light : vec3(0.0), 1.0);
}`;

/** Weaves the views into a picture of the panel's size. */
export async function weave(views: Views, panel: Calibration): Promise<HTMLCanvasElement> {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [panel.cols, panel.rows];
  const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: false, alpha: false, depth: false });
  if (!gl || gl.drawingBufferWidth !== panel.cols || gl.drawingBufferHeight !== panel.rows) {
    throw new Problem(`The panel needs a WebGL2 canvas of ${panel.cols} × ${panel.rows} pixels, which this browser does not provide.`, "Use another browser or computer.", false);
  }
  const { cols, rows, width_mm, height_mm } = views.info.field;
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, cols, rows, VIEWS);
  for (const [key, to] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
    [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ] as const)
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, key, to);
  try {
    for (const [i, slope] of slopesOf(views.info, panel, VIEWS).entries()) {
      const picture = await views.picture(slope);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, i, cols, rows, 1, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      picture.close();
    }
  } finally {
    views.done();
  }
  const program = link(gl, VERTEX, FRAGMENT);
  gl.useProgram(program);
  if (gl.getError() !== gl.NO_ERROR) {
    throw new Problem(`WebGL2 does not weave ${VIEWS} views of ${cols} × ${rows} pixels here.`, "Use another browser or computer.", false);
  }
  const at = (name: string): WebGLUniformLocation | null => gl.getUniformLocation(program, name);
  // Show the whole picture as large as the panel allows.
  const shape = (width_mm / height_mm) * (panel.rows / panel.cols);
  gl.uniform2f(at("size"), panel.cols, panel.rows);
  gl.uniform2f(at("extent"), Math.min(shape, 1), Math.min(1 / shape, 1));
  gl.uniform1f(at("pitch"), panel.pitch);
  gl.uniform1f(at("tilt"), panel.tilt);
  gl.uniform1f(at("centre"), panel.centre);
  gl.uniform1f(at("count"), VIEWS);
  gl.uniform1i(at("inverted"), Number(panel.inverted));
  gl.uniform1i(at("pattern"), panel.pattern);
  gl.uniform2fv(at("cells"), panel.cells.slice(0, 4).flat(2));
  gl.viewport(0, 0, panel.cols, panel.rows);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  return canvas;
}

/** Shows the canvas on the whole screen of the panel, if the browser lists it, otherwise on the window's screen. */
export async function fill(canvas: HTMLCanvasElement): Promise<void> {
  const screens = await (window as { getScreenDetails?: () => Promise<{ screens: (Screen & { devicePixelRatio: number })[] }> }).getScreenDetails?.().catch(() => undefined);
  const screen = screens?.screens.find(
    ({ width, height, devicePixelRatio }) => Math.round(width * devicePixelRatio) === canvas.width && Math.round(height * devicePixelRatio) === canvas.height,
  );
  await canvas.requestFullscreen({ navigationUI: "hide", ...(screen && { screen }) } as FullscreenOptions);
}
