/** The mode of the viewer. */
export type Mode = "perceived" | "slow" | "exploded" | "compare" | "layers";
/** The kind of comparison of target and display. */
export type Comparison = "slider" | "side" | "error";
/** The renderer of the display's views. */
export type Path = "webgl2" | "cpu";
/** Slope of the view: right of the normal, above it. */
export type Slope = readonly [x: number, y: number];
export declare const MODES: readonly Mode[];
export declare const COMPARISONS: readonly Comparison[];
export interface State {
    mode: Mode;
    comparison: Comparison;
    /** Position of the comparison's slider, 0..1 from the left. */
    split: number;
    /** Factor on the emitted light; null: 1/β, for an adapted eye. */
    gain: number | null;
    /** Error of every gap between layers. */
    gapMm: number;
    /** Offset of the front layer. */
    shiftXMm: number;
    shiftYMm: number;
    /** Black level of every layer. */
    blackLevel: number;
    /** Diameter of the pupil; 0 for a pinhole. */
    pupilMm: number;
    /** Distance of the eye; null: that of the target's views, which may be parallel projections. */
    eyeMm: number | null;
    /** Frame and layer of slow motion and of the layers mode. */
    frame: number;
    layer: number;
    /** Frames per second of slow motion. */
    rate: number;
    playing: boolean;
    /** Separation of the exploded layers, 0..1. */
    spread: number;
    yaw: number;
    pitch: number;
    /** True if the view swings when idle. */
    swing: boolean;
}
export declare const DEFAULTS: Readonly<State>;
/** `mode=compare&x=0.03&…`; defaults are left out. */
export declare function toHash(state: State, slope: Slope | undefined): string;
/** Reads the text of `toHash`; unknown or wrong values keep their defaults. */
export declare function fromHash(hash: string): {
    state: State;
    slope: Slope | undefined;
};
