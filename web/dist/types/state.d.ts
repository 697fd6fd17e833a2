/** What the viewer shows. */
export type Mode = "perceived" | "slow" | "exploded" | "compare" | "layers";
/** How target and display are compared. */
export type Comparison = "slider" | "side" | "error";
/** Who draws what the display shows. */
export type Path = "webgl2" | "cpu";
/** Tangents of the angles at which one looks: right of the normal, above it. */
export type Slope = readonly [x: number, y: number];
export declare const MODES: readonly Mode[];
export declare const COMPARISONS: readonly Comparison[];
export interface State {
    mode: Mode;
    comparison: Comparison;
    /** Where the slider of the comparison stands, 0..1 from the left. */
    split: number;
    /** Factor on what the display shows; null: 1/β, the eye is adapted. */
    gain: number | null;
    /** Added to every distance between layers. */
    gapMm: number;
    /** Offset of the front layer. */
    shiftXMm: number;
    shiftYMm: number;
    /** Least transmittance of every layer. */
    blackLevel: number;
    /** Diameter of the pupil; 0: pinhole. */
    pupilMm: number;
    /** Distance of the eye; null: that of the target's views, which may be parallel projections. */
    eyeMm: number | null;
    /** Frame and layer that slow motion and layers show. */
    frame: number;
    layer: number;
    /** Frames per second of slow motion. */
    rate: number;
    playing: boolean;
    /** How far the layers are pulled apart, 0..1. */
    spread: number;
    yaw: number;
    pitch: number;
    /** Whether the view swings when nobody moves it. */
    swing: boolean;
}
export declare const DEFAULTS: Readonly<State>;
/** `mode=compare&x=0.03&…`; what stands at its default is left out. */
export declare function toHash(state: State, slope: Slope | undefined): string;
/** Reads what `toHash` writes; what is not understood keeps its default. */
export declare function fromHash(hash: string): {
    state: State;
    slope: Slope | undefined;
};
