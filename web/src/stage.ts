// The canvases: WebGL2 where there is one, otherwise pictures that the processor makes.
import { problemOf } from "./problem.js";
import { explode } from "./explode.js";
import type { Info, LightField, Viewer } from "./simulator.js";
import type { Slope } from "./state.js";

/** One picture to show. */
export type Scene =
  | { kind: "view"; slope: Slope }
  | { kind: "split"; slope: Slope; at: number }
  | { kind: "side"; slope: Slope }
  | { kind: "error"; slope: Slope }
  | { kind: "exploded"; slope: Slope; yaw: number; pitch: number; spread: number; frame: number }
  | { kind: "mask"; layer: number; frame: number };

export type Path = "webgl2" | "cpu";

export interface StageEvents {
  /** The way pictures are made has changed, why, and whether it will stay so. */
  path(path: Path, why: string | undefined, lasting: boolean): void;
  /** Ask for a new picture. */
  stale(): void;
}

/** Drawing buffers beyond this give no visible detail and cost time. */
const MOST_PX = 2400;
/** Milliseconds after which a lost context is given up and a new canvas tried. */
const RESTORE_MS = 2500;

export class Stage {
  private gl: HTMLCanvasElement;
  private readonly flat = canvas("flat");
  /** The target of the side-by-side comparison. */
  readonly aside = canvas("aside");
  private viewer: Viewer | undefined;
  private lightField: LightField | undefined;
  private info: Info | undefined;
  private wanted: Path = "webgl2";
  path: Path = "cpu";
  private size: [number, number] = [1, 1];
  private retry: ReturnType<typeof setTimeout> | undefined;
  private drawn: Scene | undefined;

  constructor(
    private readonly box: HTMLElement,
    private readonly events: StageEvents,
  ) {
    this.gl = this.newGl();
    this.box.prepend(this.gl, this.flat, this.aside);
  }

  /** Shows a simulator's pictures from now on; `force_cpu` leaves WebGL2 alone. */
  use(viewer: Viewer, info: Info, forceCpu: boolean): void {
    this.release();
    this.viewer = viewer;
    this.info = info;
    this.wanted = forceCpu ? "cpu" : "webgl2";
    if (forceCpu) this.switchTo("cpu", undefined);
    else this.attach();
  }

  /** Shows a light field, whose views the processor blends. */
  useLightField(field: LightField, info: Info): void {
    this.release();
    this.lightField = field;
    this.info = info;
  }

  /** A picture between the views of the light field, 0..1 from the left and from the top. */
  drawLightField(u: number, v: number): void {
    if (!this.lightField || !this.info) return;
    this.aside.hidden = true;
    this.show(this.flat);
    put(this.flat, this.lightField.render(u, v), this.info.field.cols, this.info.field.rows);
  }

  /** Lets go of the simulator before it is freed. */
  release(): void {
    clearTimeout(this.retry);
    if (this.viewer && this.path === "webgl2") this.viewer.detach();
    this.viewer = undefined;
    this.lightField = undefined;
    this.drawn = undefined;
    this.path = "cpu";
  }

  /** Size of the box in CSS pixels. */
  resize(width: number, height: number): void {
    const scale = Math.min(devicePixelRatio || 1, 2, MOST_PX / Math.max(width, height, 1));
    this.size = [Math.max(Math.round(width * scale), 1), Math.max(Math.round(height * scale), 1)];
  }

  draw(scene: Scene): void {
    if (!this.viewer) return;
    this.drawn = scene;
    this.aside.hidden = scene.kind !== "side";
    if (this.path === "webgl2" && scene.kind !== "mask") {
      this.show(this.gl);
      this.drawGl(scene, this.size);
    } else {
      this.show(this.flat);
      this.drawFlat(scene);
    }
  }

  /** What is on the canvas; at the field's own size where `native`. */
  pixels(native: boolean): ImageData {
    if (this.lightField) return copy(this.visible);
    const scene = this.drawn;
    if (!scene || !this.info) return new ImageData(1, 1);
    const { cols, rows } = this.info.field;
    if (this.path === "cpu" || scene.kind === "mask") {
      this.draw(scene);
      return copy(this.flat);
    }
    this.drawGl(scene, native ? [cols, rows] : this.size);
    const data = copy(this.gl);
    if (native) this.drawGl(scene, this.size);
    return data;
  }

  /** The picture on show as a canvas of its own; both halves of a side-by-side comparison. */
  snapshot(): HTMLCanvasElement {
    const main = this.pixels(false);
    const out = document.createElement("canvas");
    const both = !this.aside.hidden;
    out.width = main.width * (both ? 2 : 1);
    out.height = main.height;
    const context = out.getContext("2d")!;
    context.putImageData(main, 0, 0);
    if (both) context.drawImage(this.aside, main.width, 0, main.width, main.height);
    return out;
  }

  /** The canvas on show, to be recorded. */
  get visible(): HTMLCanvasElement {
    return this.gl.hidden ? this.flat : this.gl;
  }

  private show(which: HTMLCanvasElement): void {
    this.gl.hidden = which !== this.gl;
    this.flat.hidden = which !== this.flat;
  }

  private drawGl(scene: Exclude<Scene, { kind: "mask" }>, [width, height]: [number, number]): void {
    const viewer = this.viewer!;
    const [x, y] = scene.slope;
    if (this.gl.width !== width) this.gl.width = width;
    if (this.gl.height !== height) this.gl.height = height;
    switch (scene.kind) {
      case "view":
        return viewer.draw(x, y);
      case "split":
        return viewer.draw_split(x, y, scene.at);
      case "error":
        return viewer.draw_error(x, y);
      case "exploded":
        return viewer.draw_exploded(x, y, scene.yaw, scene.pitch, scene.spread);
      case "side": {
        const view = viewer.nearest_view(x, y);
        viewer.draw_target(view[0]!, view[1]!);
        this.aside.width = width;
        this.aside.height = height;
        this.aside.getContext("2d")!.drawImage(this.gl, 0, 0);
        return viewer.draw(x, y);
      }
    }
  }

  private drawFlat(scene: Scene): void {
    const viewer = this.viewer!;
    const info = this.info!;
    const { cols, rows } = info.field;
    if (scene.kind === "mask") {
      const layer = info.layers[scene.layer];
      if (layer) return put(this.flat, viewer.render_layer(scene.layer, scene.frame), layer.cols, layer.rows);
      const backlight = info.backlight!;
      return put(this.flat, viewer.render_backlight(scene.frame), backlight.cols, backlight.rows);
    }
    const [x, y] = scene.slope;
    switch (scene.kind) {
      case "view":
        return put(this.flat, viewer.render(x, y), cols, rows);
      case "error":
        return put(this.flat, viewer.render_error(x, y), cols, rows);
      case "side": {
        const view = viewer.nearest_view(x, y);
        put(this.aside, viewer.render_target(view[0]!, view[1]!), cols, rows);
        return put(this.flat, viewer.render(x, y), cols, rows);
      }
      case "split": {
        const view = viewer.nearest_view(x, y);
        put(this.flat, viewer.render(x, y), cols, rows);
        const target = new ImageData(clamped(viewer.render_target(view[0]!, view[1]!)), cols, rows);
        const from = Math.round(scene.at * cols);
        this.flat.getContext("2d")!.putImageData(target, 0, 0, from, 0, cols - from, rows);
        return;
      }
      case "exploded": {
        this.flat.width = this.size[0];
        this.flat.height = this.size[1];
        return explode(this.flat, viewer, info, scene);
      }
    }
  }

  private attach(): void {
    try {
      this.viewer!.attach(this.gl);
      this.switchTo("webgl2", undefined);
    } catch (error) {
      this.switchTo("cpu", "This browser offers no WebGL2: the processor draws the same picture, less fluently.");
      console.info(`lumistack-viewer: ${problemOf(error, "").message}`);
    }
  }

  private switchTo(path: Path, why: string | undefined, lasting = true): void {
    this.path = path;
    this.events.path(path, why, lasting);
    this.events.stale();
  }

  private newGl(): HTMLCanvasElement {
    const made = canvas("gl");
    made.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      if (made !== this.gl || !this.viewer || this.path !== "webgl2") return;
      this.viewer.detach();
      this.switchTo("cpu", "The browser took the graphics context away: the processor draws until it is back.", false);
      clearTimeout(this.retry);
      this.retry = setTimeout(() => this.replace(), RESTORE_MS);
    });
    made.addEventListener("webglcontextrestored", () => {
      if (made !== this.gl || !this.viewer || this.wanted !== "webgl2") return;
      clearTimeout(this.retry);
      this.attach();
    });
    return made;
  }

  /** A canvas whose context does not come back is exchanged. */
  private replace(): void {
    if (!this.viewer || this.wanted !== "webgl2" || this.path === "webgl2") return;
    const fresh = this.newGl();
    this.gl.replaceWith(fresh);
    this.gl = fresh;
    this.attach();
  }
}

function canvas(name: string): HTMLCanvasElement {
  const made = document.createElement("canvas");
  made.className = name;
  made.hidden = true;
  made.setAttribute("aria-hidden", "true");
  return made;
}

function clamped(data: Uint8ClampedArray): Uint8ClampedArray<ArrayBuffer> {
  return new Uint8ClampedArray(data);
}

/** Shows RGBA bytes at their own size. */
export function put(on: HTMLCanvasElement, rgba: Uint8ClampedArray, cols: number, rows: number): void {
  if (on.width !== cols) on.width = cols;
  if (on.height !== rows) on.height = rows;
  on.getContext("2d")!.putImageData(new ImageData(clamped(rgba), cols, rows), 0, 0);
}

function copy(from: HTMLCanvasElement): ImageData {
  const out = document.createElement("canvas");
  out.width = from.width;
  out.height = from.height;
  const context = out.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(from, 0, 0);
  return context.getImageData(0, 0, out.width, out.height);
}
