// Quilts and light fields from other programs, whose views are shown unchanged.
import type { Dropped } from "./drop.js";
import { Problem, problemOf } from "./problem.js";
import type { Engine } from "./engine.js";
import type { Info } from "./info.js";

/** Half the full angles of the viewing zone along x and y, degrees. Files do not state these angles, so they are assumed. */
const HALF_ANGLE: readonly [number, number] = [17.5, 10];

/**
 * Decodes the pictures of a quilt or of a light field's views, and passes them to the simulator.
 * `report` receives the finished fraction, 0..1.
 */
export async function loadForeign(dropped: Extract<Dropped, { kind: "quilt" | "views" }>, engine: Engine, report: (share: number) => void, signal: AbortSignal): Promise<Info> {
  if (dropped.kind === "quilt") {
    const picture = await pixelsOf(dropped.file);
    const { cols, rows } = dropped;
    if (picture.width < cols || picture.height < rows) throw new Problem(`${dropped.file.name} has ${picture.width} × ${picture.height} pixels for ${cols} × ${rows} views; expected at least one pixel per view.`, "Check the numbers in the file's name.", false);
    const width = Math.floor(picture.width / cols);
    const height = Math.floor(picture.height / rows);
    await checked(engine.call("openQuilt", [picture, cols, rows], [picture.data.buffer]));
    report(1);
    // The views of a quilt form one row of views, from left to right.
    return foreign(dropped.title, height, width, 1, cols * rows, dropped.aspect);
  }
  // The first view determines the size of all views.
  const { views } = dropped;
  const [rows, cols] = [views.length, views[0]!.length];
  let size: [number, number] | undefined;
  for (let row = 0; row < rows; row++) {
    for (let col = 0; col < cols; col++) {
      const file = views[row]![col]!;
      const picture = await pixelsOf(file);
      if (signal.aborted) throw signal.reason;
      if (!size) {
        size = [picture.height, picture.width];
        await checked(engine.call("openField", [...size, rows, cols]));
      } else if (picture.width !== size[1] || picture.height !== size[0]) {
        throw new Problem(`${file.name} has ${picture.width} × ${picture.height} pixels, but earlier views have ${size[1]} × ${size[0]} pixels.`, "All views of a light field must have the same size. Drop a folder that contains only the views.", false);
      }
      await checked(engine.call("putView", [row, col, picture], [picture.data.buffer]));
      report((row * cols + col + 1) / (rows * cols));
    }
  }
  return foreign(dropped.title, ...size!, rows, cols, undefined);
}

function foreign(title: string, rows: number, cols: number, viewRows: number, viewCols: number, aspect: number | undefined): Info {
  const zone = { x_rad: viewCols > 1 ? rad(HALF_ANGLE[0]) : 0, y_rad: viewRows > 1 ? rad(HALF_ANGLE[1]) : 0 };
  const slopes: [number, number][] = [];
  const place = (i: number, n: number, angle: number): number => (n > 1 ? ((2 * i) / (n - 1) - 1) * Math.tan(angle) : 0);
  for (let r = 0; r < viewRows; r++) for (let c = 0; c < viewCols; c++) slopes.push([place(c, viewCols, zone.x_rad), -place(r, viewRows, zone.y_rad)]);
  return {
    title,
    caption: "",
    field: { cols, rows, width_mm: aspect ?? cols / rows, height_mm: 1 },
    layers: [],
    directional: false,
    frames: 1,
    brightness: 1,
    views: { rows: viewRows, cols: viewCols, slopes, projection: "perspective" },
    zone,
    files: [],
  };
}

async function pixelsOf(file: File): Promise<ImageData> {
  let bitmap: ImageBitmap;
  try {
    bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (error) {
    throw new Problem(`${file.name} is not a picture that this browser can read: ${problemOf(error, "").message}`, "Convert the file to PNG or JPEG and try again.", false);
  }
  const canvas = document.createElement("canvas");
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  if (!context) throw new Problem(`${file.name} is too large for this browser: ${bitmap.width} × ${bitmap.height} pixels.`, "Reduce the picture and try again.", false);
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  return context.getImageData(0, 0, canvas.width, canvas.height);
}

async function checked(call: Promise<void>): Promise<void> {
  try {
    await call;
  } catch (error) {
    throw new Problem(problemOf(error, "").message, "Check that all views have the same size, and that the quilt's name is right.", false);
  }
}

function rad(degrees: number): number {
  return (degrees * Math.PI) / 180;
}
