// The thread that decodes patterns and draws pictures. It answers calls in order.
import { heat, heat_top, initSync, LightField, Viewer, version } from "../pkg/lumistack_web.js";
import { Painter, pixelsOf, type Scene, type Size, type Wish } from "./painter.js";

let viewer: Viewer | undefined;
let painter: Painter | undefined;
let field: LightField | undefined;

const methods = {
  start(module: WebAssembly.Module): void {
    initSync({ module });
  },
  /** Opens a preview from the text of preview.json. */
  open(json: string): { version: string; heat: string; heatTop: number } {
    viewer = new Viewer(json);
    painter = new Painter(viewer, (change) => postMessage([0, change]));
    return { version: version(), heat: heat(), heatTop: heat_top() };
  },
  put(index: number, bytes: ArrayBuffer): void {
    viewer!.put(index, new Uint8Array(bytes));
  },
  /** Replaces the codes of all pictures together. */
  exchange(codes: Uint8Array): void {
    viewer!.exchange(codes);
    painter!.forget();
  },
  /** Replaces all files in one call, so that no drawn picture mixes old and new patterns. */
  renew(files: readonly ArrayBuffer[]): void {
    files.forEach((bytes, index) => viewer!.put(index, new Uint8Array(bytes)));
    painter!.forget();
  },
  options(json: string): void {
    viewer!.set_options(json);
  },
  /** Creates or releases the graphics context, as `wish` states. */
  attach(wish: Wish): void {
    painter!.attach(wish);
  },
  paint(scene: Scene, size: Size): ImageBitmap[] {
    return painter!.paint(scene, size);
  },
  pixels(scene: Scene, size: Size): ImageData {
    return pixelsOf(painter!.paint(scene, size)[0]!);
  },
  psnr(x: number, y: number): number | undefined {
    return viewer!.psnr(x, y);
  },
  openField(rows: number, cols: number, viewRows: number, viewCols: number): void {
    field = new LightField(rows, cols, viewRows, viewCols);
  },
  putView(row: number, col: number, picture: ImageData): void {
    field!.put(row, col, new Uint8Array(picture.data.buffer));
  },
  openQuilt(picture: ImageData, cols: number, rows: number): void {
    field = LightField.from_quilt(new Uint8Array(picture.data.buffer), picture.width, picture.height, cols, rows);
  },
  /**
   * Returns the picture at the position (u, v) between the views. u is 0..1 from the left, v is
   * 0..1 from the top.
   */
  between(u: number, v: number): ImageData {
    return new ImageData(new Uint8ClampedArray(field!.render(u, v)), field!.cols(), field!.rows());
  },
};

export type Methods = typeof methods;

onmessage = ({ data: [id, name, args] }: MessageEvent<[number, keyof Methods, never]>) => {
  try {
    const value = (methods[name] as (...args: never[]) => unknown)(...(args as never[]));
    postMessage([id, value], { transfer: Array.isArray(value) ? value : [] });
  } catch (error) {
    postMessage([id, undefined, error instanceof Error ? error.message : String(error)]);
  }
};
