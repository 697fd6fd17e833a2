// The content of the viewer: a layer stack with its simulator, or a light field from other
// programs.
import type { Engine } from "./engine.js";
import { infoOf, nearestView, viewSlope, type FileInfo, type Info } from "./info.js";
import type { Wish } from "./painter.js";
import { problemOf, REWRITE } from "./problem.js";
import type { Shot, Stage } from "./stage.js";
import type { Slope, State } from "./state.js";

export interface Content {
  readonly info: Info;
  /** Numbers of the frames of which all files have arrived, in rising order. */
  readonly frames: readonly number[];
  /** True if all frames are complete, or every file has arrived or failed. Then the picture stays the same. */
  readonly whole: boolean;
  /** Creates or releases the graphics context, as `wish` states. */
  attach(wish: Wish): void;
  /** Applies the user's options. */
  apply(state: State): void;
  /** The picture to show for a state, seen from a slope. */
  shot(state: State, slope: Slope): Shot;
  free(): void;
}

export class StackContent implements Content {
  readonly info: Info;
  readonly frames: number[] = [];
  whole = false;
  /**
   * Version of the module, the error map's colours, and the error that the last colour shows;
   * undefined until the module has opened the preview.
   */
  about: { version: string; heat: string; heatTop: number } | undefined;
  private engine: Engine | undefined;
  /** Views of the target that have arrived, each as "row/column". */
  private readonly targets = new Set<string>();
  /** For each frame the number of its files that have not arrived. */
  private readonly missing: number[];
  private options = "";
  private wanted = "";

  /** Throws if the text is not a preview.json. */
  constructor(readonly json: string) {
    this.info = infoOf(json);
    this.missing = Array.from({ length: this.info.frames }, (_, frame) => this.info.files.filter((file) => file.frame === frame).length);
  }

  /** Opens the preview in the simulator, which checks the preview. */
  async open(engine: Engine, stage: Stage): Promise<void> {
    this.about = await openPreview(engine, this.json);
    this.engine = engine;
    stage.use(engine);
    this.sendOptions();
  }

  /** Records a file that has arrived; returns true if the file completes its frame. */
  arrived({ frame, view }: FileInfo): boolean {
    if (view) this.targets.add(view.join("/"));
    if (frame === undefined || --this.missing[frame]! > 0) return false;
    this.frames.push(frame);
    this.frames.sort((a, b) => a - b);
    this.whole = this.frames.length === this.info.frames;
    return true;
  }

  /** Replaces all masks together, so that no drawn picture mixes old and new masks. */
  async exchange(codes: Uint8Array<ArrayBuffer>): Promise<void> {
    await this.engine?.call("exchange", [codes], [codes.buffer]);
    if (this.whole) return;
    for (const file of this.info.files) this.arrived(file);
  }

  /** Replaces all files of the preview, given as PNG bytes in the preview's order. */
  async renew(files: readonly ArrayBuffer[]): Promise<void> {
    await this.engine?.call("renew", [files]);
  }

  get targetsReady(): number {
    return this.targets.size;
  }

  attach(wish: Wish): void {
    void this.engine?.call("attach", [wish]);
  }

  apply(state: State): void {
    const most = 1 / this.info.brightness;
    const single = state.mode === "slow";
    this.wanted = JSON.stringify({
      gain: Math.min(state.gain ?? most, most),
      gap_mm: state.gapMm,
      shift_mm: [state.shiftXMm, state.shiftYMm],
      black_level: state.blackLevel,
      pupil_mm: state.pupilMm,
      eye_distance_mm: state.eyeMm,
      frame: single ? readyFrame(this.frames, state.frame) : null,
    });
    this.sendOptions();
  }

  /**
   * Returns the mask of a layer in a frame. The index after the last layer stands for the
   * backlight.
   */
  mask(layer: number, frame: number): Shot {
    const { layers, backlight, field } = this.info;
    const { cols, rows } = layers[layer] ?? backlight ?? field;
    return { kind: "mask", field: [field.cols, field.rows], layer, frame, size: [cols, rows], backlight: layer >= layers.length };
  }

  /**
   * Returns the PSNR for the target's view nearest to the slope, as text: "31.4 dB · view 3, 2 of
   * 7 × 5". If there is no PSNR, the text states this.
   */
  async psnr(slope: Slope): Promise<string> {
    const [row, col] = nearestView(this.info, slope);
    const { cols, rows } = this.info.views;
    const name = `view ${col + 1}, ${row + 1} of ${cols} × ${rows}`;
    const db = await this.engine?.call("psnr", [slope[0], slope[1]]);
    if (db === undefined) return `${name}: no PSNR, for example because the target is not loaded yet`;
    return `${Number.isFinite(db) ? db.toFixed(1) : "∞"} dB · ${name}`;
  }

  free(): void {
    this.engine?.stop();
    this.engine = undefined;
  }

  shot(state: State, slope: Slope): Shot {
    const { info } = this;
    const frame = readyFrame(this.frames, state.frame);
    const field = [info.field.cols, info.field.rows] as const;
    if (state.mode === "layers") return this.mask(state.layer, frame);
    if (state.mode === "exploded") {
      const { yaw, pitch, spread } = state;
      return { kind: "exploded", field, slope, yaw, pitch, spread, frame, stack: { field: info.field, layers: info.layers } };
    }
    const view = nearestView(info, slope);
    if (state.mode !== "compare" || !this.targets.has(view.join("/"))) return { kind: "view", field, slope };
    // The display is drawn from the slope of the target's view, so that the two can be compared.
    const snapped = viewSlope(info, ...view);
    if (state.comparison === "slider") return { kind: "split", field, slope: snapped, view, at: state.split };
    if (state.comparison === "side") return { kind: "side", field, slope: snapped, view };
    return { kind: "error", field, slope: snapped };
  }

  private sendOptions(): void {
    if (!this.engine || this.wanted === "" || this.wanted === this.options) return;
    this.options = this.wanted;
    void this.engine.call("options", [this.wanted]);
  }
}

/** Opens a preview in the simulator; throws the reason if the preview is invalid. */
export async function openPreview(engine: Engine, json: string): Promise<{ version: string; heat: string; heatTop: number }> {
  try {
    return await engine.call("open", [json]);
  } catch (error) {
    throw problemOf(error, REWRITE);
  }
}

export class FieldContent implements Content {
  readonly frames = [0];
  readonly whole = true;

  constructor(
    readonly info: Info,
    private readonly engine: Engine,
    stage: Stage,
  ) {
    stage.use(engine);
  }

  attach(): void {
    // A light field needs no graphics context: the processor blends its views.
  }

  apply(): void {
    // The views are shown unchanged, so the options have no effect.
  }

  shot(_state: State, [x, y]: Slope): Shot {
    const { zone } = this.info;
    const along = (value: number, half: number): number => (half > 0 ? Math.min(Math.max(0.5 + value / Math.tan(half) / 2, 0), 1) : 0.5);
    return { kind: "between", u: along(x, zone.x_rad), v: along(-y, zone.y_rad) };
  }

  free(): void {
    this.engine.stop();
  }
}

/**
 * Returns `frame` if it is in `frames`, the rising numbers of complete frames. Otherwise it returns
 * the last complete frame before `frame`, or else the first complete frame.
 */
export function readyFrame(frames: readonly number[], frame: number): number {
  return frames.findLast((each) => each <= frame) ?? frames[0] ?? 0;
}
