/** The mode of the viewer. */
export type Mode = "perceived" | "slow" | "exploded" | "compare" | "layers";
/** The way in which the mode "compare" shows display and target. */
export type Comparison = "slider" | "side" | "error";
/** The renderer of the display's views. */
export type Path = "webgl2" | "cpu";
/** Slope of the view: x is positive to the right of the display's normal, and y is positive above the normal. */
export type Slope = readonly [x: number, y: number];
export declare const MODES: readonly Mode[];
export declare const COMPARISONS: readonly Comparison[];
export interface State {
    mode: Mode;
    comparison: Comparison;
    /** Boundary between display and target in the comparison "slider", 0..1 from the left. */
    split: number;
    /** Factor on the emitted light. Null stands for 1/β, the factor of an adapted eye. */
    gain: number | null;
    /** Error of every gap between neighbouring layers, and of the gap to the backlight, mm. */
    gapMm: number;
    /** Offset of the front layer to the right and upwards, mm. */
    shiftXMm: number;
    shiftYMm: number;
    /** Black level of every layer, 0..1. */
    blackLevel: number;
    /** Diameter of the pupil, mm; 0 for a pinhole. */
    pupilMm: number;
    /** Distance of the eye, mm. Null stands for the projection of the target's views. */
    eyeMm: number | null;
    /** The frame that the modes "slow", "exploded" and "layers" show, and the layer that "layers" shows. */
    frame: number;
    layer: number;
    /** Frames per second of slow motion. */
    rate: number;
    playing: boolean;
    /** Separation of the layers in the mode "exploded", which draws them apart, 0..1. */
    spread: number;
    yaw: number;
    pitch: number;
    /** True if the view swings when idle. */
    swing: boolean;
}
export declare const DEFAULTS: Readonly<State>;
/** Writes a state as `mode=compare&x=0.03&…`, without the values that are defaults. */
export declare function toHash(state: State, slope: Slope | undefined): string;
/**
 * Reads the text that `toHash` writes. Unknown keys and unusable values are ignored. Other numbers
 * are limited to their range.
 */
export declare function fromHash(hash: string): {
    state: State;
    slope: Slope | undefined;
};
