// Reads the parts of preview.json that the page needs. The WebAssembly module checks the file.
import type { Slope } from "./state.js";

export interface LayerInfo {
  cols: number;
  rows: number;
  d_mm: number;
  pitch_mm: number;
}

export interface FileInfo {
  path: string;
  kind: "layer" | "emission" | "target";
  layer?: number;
  frame?: number;
  view?: [number, number];
  bytes?: number;
}

/** Small views in one picture: a grid of tiles, columns from left to right, rows from the top. */
export interface Around {
  path: string;
  /** Pixel columns and rows of a view. */
  cols: number;
  rows: number;
  /**
   * Slopes of the columns of views, in rising order, and slopes of the rows of views, in falling
   * order.
   */
  slope_x: number[];
  slope_y: number[];
}

export interface Info {
  title: string;
  caption: string;
  field: { cols: number; rows: number; width_mm: number; height_mm: number };
  layers: LayerInfo[];
  directional: boolean;
  backlight?: { cols: number; rows: number };
  frames: number;
  brightness: number;
  views: { rows: number; cols: number; slopes: [number, number][]; projection: string; distance_mm?: number };
  /** Half the full angles of the viewing zone. */
  zone: { x_rad: number; y_rad: number };
  files: FileInfo[];
  /** Path of a picture of the scene, seen straight ahead. */
  poster?: string;
  around?: Around;
}

/** Reads the text of a preview.json; throws if the text is no preview. */
export function infoOf(json: string): Info {
  const { title = "", caption = "", display, target, frames, brightness, files, poster, around } = JSON.parse(json);
  const emission = files.find(({ kind }: FileInfo) => kind === "emission");
  const [rows, cols] = [target.slope_y.length, target.slope_x.length];
  // Along an axis with a single view the zone has no width.
  const half = (axis: number, views: number): number => (views > 1 ? (display.field.fov_deg[axis] * Math.PI) / 360 : 0);
  return {
    title,
    caption,
    field: { cols: target.cols, rows: target.rows, width_mm: target.cols * target.pitch_mm, height_mm: target.rows * target.pitch_mm },
    layers: display.layers.map(({ resolution, d_mm, pitch_mm }: { resolution: [number, number]; d_mm: number; pitch_mm: number }) => ({
      cols: resolution[0],
      rows: resolution[1],
      d_mm,
      pitch_mm,
    })),
    directional: emission !== undefined,
    ...(emission && { backlight: { cols: emission.cols, rows: emission.rows } }),
    frames,
    brightness,
    views: {
      rows,
      cols,
      slopes: target.slope_y.flatMap((y: number) => target.slope_x.map((x: number) => [x, y])),
      projection: target.projection,
      // Patterns of perspective views have a viewing distance; parallel projections have none.
      ...(target.distance_mm && { distance_mm: target.distance_mm }),
    },
    zone: { x_rad: half(0, cols), y_rad: half(1, rows) },
    files,
    ...(poster && { poster }),
    ...(around && { around }),
  };
}

/**
 * Returns the slopes at the edge of the zone along x and y. These slopes are never 0, since callers
 * divide by them.
 */
export function zoneSlope(info: Info): Slope {
  return [Math.max(Math.tan(info.zone.x_rad), 1e-6), Math.max(Math.tan(info.zone.y_rad), 1e-6)];
}

/** Returns the slope of a view of the target. */
export function viewSlope(info: Info, row: number, col: number): Slope {
  return info.views.slopes[row * info.views.cols + col] ?? [0, 0];
}

/** Returns row and column of the target's view that is nearest to a slope. */
export function nearestView({ views }: Info, [x, y]: Slope): [number, number] {
  const nearest = (slopes: number[], slope: number): number =>
    slopes.reduce((best, each, i) => (Math.abs(each - slope) < Math.abs(slopes[best]! - slope) ? i : best), 0);
  const first = views.slopes.slice(0, views.cols).map(([x]) => x);
  const column = Array.from({ length: views.rows }, (_, row) => views.slopes[row * views.cols]![1]);
  return [nearest(column, y), nearest(first, x)];
}
