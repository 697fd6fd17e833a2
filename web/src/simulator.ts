// The WebAssembly module: the forward model of crates/display, and what it says about a stack.
import init, { LightField, Viewer, version } from "../pkg/lumistack_web.js";
import { Problem, problemOf } from "./problem.js";
import { fromBase64 } from "./source.js";
import type { Slope } from "./state.js";

export { LightField, Viewer, version };

export interface LayerInfo {
  cols: number;
  rows: number;
  d_mm: number;
  pitch_mm: number;
  black_level: number;
}

export interface FileInfo {
  path: string;
  kind: "layer" | "emission" | "target";
  layer?: number;
  frame?: number;
  view?: [number, number];
  bytes?: number;
}

/** `Viewer.info()`. */
export interface Info {
  title: string;
  field: { cols: number; rows: number; width_mm: number; height_mm: number };
  layers: LayerInfo[];
  directional: boolean;
  backlight?: { cols: number; rows: number };
  frames: number;
  refresh_hz?: number;
  brightness: number;
  views: { rows: number; cols: number; slopes: [number, number][]; projection: string; distance_mm?: number };
  /** Half angles of the zone. */
  zone: { x_rad: number; y_rad: number };
  files: FileInfo[];
  heat?: { max: number; stops: string[] };
}

let loading: Promise<unknown> | undefined;

/** Starts the module once; a failed attempt may be repeated. It lies beside the script, elsewhere, or in the page. */
export async function startModule(url: string | null): Promise<void> {
  const inline = window.LUMISTACK_INLINE?.["wasm"];
  loading ??= init({ module_or_path: inline !== undefined ? fromBase64(inline) : (url ?? new URL("lumistack_web_bg.wasm", import.meta.url)) });
  try {
    await loading;
  } catch (error) {
    loading = undefined;
    const advice = "See that lumistack_web_bg.wasm lies beside viewer.js and that the server sends it, then load this page again.";
    throw new Problem(
      `The simulator could not start: ${problemOf(error, "").message}`,
      typeof WebAssembly === "undefined" ? "This browser has no WebAssembly, or it is switched off: use another one." : advice,
    );
  }
}

/** Tangents of the zone's half angles; never 0, so that they may divide. */
export function zoneSlope(info: Info): Slope {
  return [Math.max(Math.tan(info.zone.x_rad), 1e-6), Math.max(Math.tan(info.zone.y_rad), 1e-6)];
}

/** The slope of a view of the target. */
export function viewSlope(info: Info, row: number, col: number): Slope {
  return info.views.slopes[row * info.views.cols + col] ?? [0, 0];
}
