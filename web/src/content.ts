// What is on show: a stack of layers with its simulator, or a light field of somebody else's.
import type { Foreign } from "./lightfield.js";
import { problemOf, REWRITE } from "./problem.js";
import { Viewer, viewSlope, type FileInfo, type Info } from "./simulator.js";
import type { Scene, Stage } from "./stage.js";
import type { Slope, State } from "./state.js";

export interface Content {
  readonly info: Info;
  /** Frames that can be drawn, rising. */
  readonly frames: readonly number[];
  /** Hands its pictures to the stage; `force_cpu` leaves WebGL2 alone. */
  attach(forceCpu: boolean): void;
  /** Takes over what the user has chosen. */
  apply(state: State): void;
  draw(state: State, slope: Slope): void;
  free(): void;
}

export class StackContent implements Content {
  readonly viewer: Viewer;
  readonly info: Info;
  readonly frames: number[] = [];
  /** Views of the target that have arrived, as row/column. */
  private readonly targets = new Set<string>();
  /** Parts of each frame that have yet to arrive. */
  private readonly missing: number[];
  private options = "";

  constructor(
    json: string,
    private readonly stage: Stage,
  ) {
    try {
      this.viewer = new Viewer(json);
    } catch (error) {
      throw problemOf(error, REWRITE);
    }
    this.info = JSON.parse(this.viewer.info()) as Info;
    this.missing = Array.from({ length: this.info.frames }, (_, frame) => this.info.files.filter((file) => file.frame === frame).length);
  }

  /** A file has become part of the picture; whether there is a first picture now. */
  arrived({ frame, view }: FileInfo): boolean {
    if (view) this.targets.add(view.join("/"));
    if (frame === undefined || --this.missing[frame]! > 0) return false;
    this.frames.push(frame);
    this.frames.sort((a, b) => a - b);
    return this.frames.length === 1;
  }

  get targetsReady(): number {
    return this.targets.size;
  }

  attach(forceCpu: boolean): void {
    this.stage.use(this.viewer, this.info, forceCpu);
  }

  apply(state: State): void {
    const most = 1 / this.info.brightness;
    const single = state.mode === "slow" || state.mode === "exploded";
    const options = JSON.stringify({
      gain: Math.min(state.gain ?? most, most),
      gap_mm: state.gapMm,
      shift_mm: [state.shiftXMm, state.shiftYMm],
      black_level: state.blackLevel,
      pupil_mm: state.pupilMm,
      eye_distance_mm: state.eyeMm,
      frame: single ? readyFrame(this.frames, state.frame) : null,
    });
    if (options !== this.options) this.viewer.set_options(options);
    this.options = options;
  }

  draw(state: State, slope: Slope): void {
    this.stage.draw(this.scene(state, slope));
  }

  /** PSNR of the view that the comparison shows, in words. */
  psnr(slope: Slope): string {
    const [row, col] = this.nearest(slope);
    const { cols, rows } = this.info.views;
    const name = `view ${col + 1}, ${row + 1} of ${cols} × ${rows}`;
    const db = this.viewer.psnr(slope[0], slope[1]);
    if (db === undefined) return `${name}: target not loaded yet`;
    return `${Number.isFinite(db) ? db.toFixed(1) : "∞"} dB · ${name}`;
  }

  /** Row and column of the nearest view of the target. */
  nearest([x, y]: Slope): [number, number] {
    const view = this.viewer.nearest_view(x, y);
    return [view[0]!, view[1]!];
  }

  free(): void {
    this.viewer.free();
  }

  private scene(state: State, slope: Slope): Scene {
    const frame = readyFrame(this.frames, state.frame);
    if (state.mode === "layers") return { kind: "mask", layer: state.layer, frame };
    if (state.mode === "exploded") return { kind: "exploded", slope, yaw: state.yaw, pitch: state.pitch, spread: state.spread, frame };
    const view = this.nearest(slope);
    if (state.mode !== "compare" || !this.targets.has(view.join("/"))) return { kind: "view", slope };
    // Display and target are compared from exactly where the target was rendered.
    const snapped = viewSlope(this.info, ...view);
    if (state.comparison === "slider") return { kind: "split", slope: snapped, at: state.split };
    return { kind: state.comparison, slope: snapped };
  }
}

export class FieldContent implements Content {
  readonly info: Info;
  readonly frames = [0];

  constructor(
    private readonly foreign: Foreign,
    private readonly stage: Stage,
  ) {
    this.info = foreign.info;
  }

  attach(): void {
    this.stage.useLightField(this.foreign.field, this.info);
  }

  apply(): void {
    // Nothing to choose: the views are shown as they are.
  }

  draw(_state: State, [x, y]: Slope): void {
    const { zone } = this.info;
    const along = (value: number, half: number): number => (half > 0 ? Math.min(Math.max(0.5 + value / Math.tan(half) / 2, 0), 1) : 0.5);
    this.stage.drawLightField(along(x, zone.x_rad), along(-y, zone.y_rad));
  }

  free(): void {
    this.foreign.field.free();
  }
}

/** A frame itself, or the last before it that can be drawn, or the first after it. */
export function readyFrame(frames: readonly number[], frame: number): number {
  return frames.findLast((each) => each <= frame) ?? frames[0] ?? 0;
}
