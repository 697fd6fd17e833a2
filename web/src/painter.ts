// Draws pictures. WebGL2 or the processor draws the views of the display, as `Wish` states. The
// processor draws all other pictures.
//
// With WebGL2 and with the processor a view has one pixel for each pixel of the light field, and
// the page scales it. So both renderers give the same picture.
import type { Viewer } from "../pkg/lumistack_web.js";
import { explode, type Stack } from "./explode.js";
import type { Path, Slope } from "./state.js";

/** A picture to draw; `field` is the size of the light field in pixels. */
export type Scene = { field: Size } & (
  | { kind: "view"; slope: Slope }
  | { kind: "split"; slope: Slope; view: readonly [number, number]; at: number }
  | { kind: "side"; slope: Slope; view: readonly [number, number] }
  | { kind: "error"; slope: Slope }
  | { kind: "exploded"; slope: Slope; yaw: number; pitch: number; spread: number; frame: number; stack: Stack }
  | { kind: "mask"; layer: number; frame: number; size: Size; backlight: boolean }
);

/**
 * The wanted renderer. "auto" is WebGL2, unless it runs in software or is slower than the
 * processor. "rest" releases the graphics context until another renderer is wanted.
 */
export type Wish = Path | "auto" | "rest";
/** Columns and rows of pixels. */
export type Size = readonly [number, number];

/** Message to the page: the current renderer, and the reason if the requested renderer cannot be used. */
export interface PathChange {
  path: Path;
  why?: string;
}

/** Limit of the time of WebGL2 for a picture, milliseconds. If WebGL2 takes longer, the processor's time is also measured. */
const SLOW_MS = 60;
/** Number of pictures whose time through WebGL2 is measured. */
const TESTS = 2;
/** Words in the names of drivers that draw by the processor. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
/** Time to wait for the restoration of a lost graphics context before a new canvas is used, milliseconds. */
const RESTORE_MS = 2500;

export class Painter {
  private gl: { canvas: OffscreenCanvas; context: WebGL2RenderingContext } | undefined;
  private readonly flat = new OffscreenCanvas(1, 1);
  private readonly context = this.flat.getContext("2d", { willReadFrequently: true })!;
  private readonly masks = new Map<string, OffscreenCanvas>();
  private latest: OffscreenCanvas | undefined;
  private wish: Wish = "cpu";
  /** Number of pictures whose time through WebGL2 is still to be measured. */
  private untested = 0;

  constructor(
    private readonly viewer: Viewer,
    private readonly post: (change: PathChange) => void,
  ) {}

  attach(wish: Wish): void {
    this.leave();
    this.wish = wish;
    if (wish === "rest") return;
    if (wish !== "cpu" && this.enter()) this.post({ path: "webgl2" });
    else this.post({ path: "cpu" });
  }

  /** Removes the stored pictures of masks after the patterns have changed. */
  forget(): void {
    this.masks.clear();
  }

  paint(scene: Scene, size: Size): ImageBitmap[] {
    const { viewer, context } = this;
    const { field } = scene;
    switch (scene.kind) {
      case "view":
        return [this.view(scene.slope, field).transferToImageBitmap()];
      case "error":
        return [this.put(viewer.render_error(...scene.slope), field).transferToImageBitmap()];
      case "side":
        return [this.view(scene.slope, field).transferToImageBitmap(), this.put(viewer.render_target(...scene.view), field).transferToImageBitmap()];
      case "split": {
        const shown = this.view(scene.slope, field);
        if (shown !== this.flat) {
          this.clear(field);
          context.drawImage(shown, 0, 0);
        }
        const from = Math.round(scene.at * field[0]);
        context.putImageData(imageOf(viewer.render_target(...scene.view), field), 0, 0, from, 0, field[0] - from, field[1]);
        return [this.flat.transferToImageBitmap()];
      }
      case "mask":
        return [this.put(scene.backlight ? viewer.render_backlight(scene.frame) : viewer.render_layer(scene.layer, scene.frame), scene.size).transferToImageBitmap()];
      case "exploded":
        this.clear(size);
        explode(context, scene, (layer) => this.mask(layer, scene.frame, scene.stack));
        return [this.flat.transferToImageBitmap()];
    }
  }

  private view([x, y]: Slope, field: Size): OffscreenCanvas {
    if (this.gl) {
      const start = performance.now();
      const { canvas } = this.gl;
      if (canvas.width !== field[0]) canvas.width = field[0];
      if (canvas.height !== field[1]) canvas.height = field[1];
      this.viewer.draw(x, y);
      if (this.untested === 0 || this.isFast(start, x, y)) return canvas;
      this.leave();
      this.post({ path: "cpu" });
    }
    return this.put(this.viewer.render(x, y), field);
  }

  /**
   * Returns true if the time of WebGL2 for the picture, from `start` on, is below a limit or below
   * the processor's time. Some browsers run WebGL2 in software and do not report this.
   */
  private isFast(start: number, x: number, y: number): boolean {
    this.gl!.context.readPixels(0, 0, 1, 1, WebGL2RenderingContext.RGBA, WebGL2RenderingContext.UNSIGNED_BYTE, new Uint8Array(4));
    const took = performance.now() - start;
    this.untested--;
    // The limit for the first picture is ten times larger, since the driver compiles the shaders.
    if (took < (this.untested > 0 ? 10 : 1) * SLOW_MS) return true;
    const again = performance.now();
    this.viewer.render(x, y);
    return took < performance.now() - again;
  }

  /** Creates a WebGL2 context; returns false if the browser has no suitable context. */
  private enter(): boolean {
    const canvas = new OffscreenCanvas(1, 1);
    const auto = this.wish === "auto";
    try {
      const context = canvas.getContext("webgl2", { antialias: false, depth: false, failIfMajorPerformanceCaveat: auto }) as WebGL2RenderingContext | null;
      if (!context || (auto && isSoftware(context))) return false;
      this.viewer.attach(context);
      canvas.addEventListener("webglcontextlost", (event) => {
        event.preventDefault();
        if (this.gl?.canvas !== canvas) return;
        this.viewer.detach();
        this.gl = undefined;
        this.post({ path: "cpu", why: "The browser took the graphics context away. The processor draws until the context is back." });
        // If the browser does not restore the context, use a new one.
        setTimeout(again, RESTORE_MS);
      });
      const again = (): void => {
        if (!this.gl && this.latest === canvas && this.wish !== "rest") this.attach(this.wish);
      };
      canvas.addEventListener("webglcontextrestored", again);
      this.gl = { canvas, context };
      this.latest = canvas;
      this.untested = auto ? TESTS : 0;
      // Tests use this global variable of the thread to end the context.
      Object.assign(self, { context });
      return true;
    } catch (error) {
      console.info(`lumistack-viewer: ${error instanceof Error ? error.message : error}`);
      return false;
    }
  }

  private leave(): void {
    const { gl } = this;
    this.gl = undefined;
    if (!gl) return;
    this.viewer.detach();
    gl.context.getExtension("WEBGL_lose_context")?.loseContext();
  }

  private mask(layer: number, frame: number, { layers }: Stack): OffscreenCanvas {
    const key = `${layer}/${frame}`;
    let mask = this.masks.get(key);
    if (!mask) {
      // The picture shows the masks of one frame, so remove the stored masks of other frames.
      if (this.masks.size >= layers.length) this.masks.clear();
      const { cols, rows } = layers[layer]!;
      mask = new OffscreenCanvas(cols, rows);
      mask.getContext("2d")!.putImageData(imageOf(this.viewer.render_layer(layer, frame), [cols, rows]), 0, 0);
      this.masks.set(key, mask);
    }
    return mask;
  }

  private put(rgba: Uint8ClampedArray, size: Size): OffscreenCanvas {
    this.clear(size);
    this.context.putImageData(imageOf(rgba, size), 0, 0);
    return this.flat;
  }

  private clear([cols, rows]: Size): void {
    this.flat.width = cols;
    this.flat.height = rows;
  }
}

/**
 * Returns true if the driver's name shows that the driver draws in software. Some browsers give a
 * context in software in spite of `failIfMajorPerformanceCaveat`.
 */
function isSoftware(context: WebGL2RenderingContext): boolean {
  let name = String(context.getParameter(context.RENDERER));
  // Safari gives the driver's name only through an extension.
  const named = name === "WebKit WebGL" ? context.getExtension("WEBGL_debug_renderer_info") : null;
  if (named) name = String(context.getParameter(named.UNMASKED_RENDERER_WEBGL));
  return SOFTWARE.test(name);
}

function imageOf(rgba: Uint8ClampedArray, [cols, rows]: Size): ImageData {
  return new ImageData(rgba as Uint8ClampedArray<ArrayBuffer>, cols, rows);
}

/** Reads the RGBA bytes of a picture and releases it. */
export function pixelsOf(picture: ImageBitmap): ImageData {
  const context = new OffscreenCanvas(picture.width, picture.height).getContext("2d", { willReadFrequently: true })!;
  context.drawImage(picture, 0, 0);
  picture.close();
  return context.getImageData(0, 0, context.canvas.width, context.canvas.height);
}
