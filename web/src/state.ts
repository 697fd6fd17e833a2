// The user's options, and the text in the page's address that describes them.

/** The mode of the viewer. */
export type Mode = "perceived" | "slow" | "exploded" | "compare" | "layers";
/** The way in which the mode "compare" shows display and target. */
export type Comparison = "slider" | "side" | "error";
/** The renderer of the display's views. */
export type Path = "webgl2" | "cpu";
/** Slope of the view: x is positive to the right of the display's normal, and y is positive above the normal. */
export type Slope = readonly [x: number, y: number];

export const MODES: readonly Mode[] = ["perceived", "slow", "exploded", "compare", "layers"];
export const COMPARISONS: readonly Comparison[] = ["slider", "side", "error"];

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

export const DEFAULTS: Readonly<State> = {
  mode: "perceived",
  comparison: "slider",
  split: 0.5,
  gain: null,
  gapMm: 0,
  shiftXMm: 0,
  shiftYMm: 0,
  blackLevel: 0,
  pupilMm: 0,
  eyeMm: null,
  frame: 0,
  layer: 0,
  rate: 2,
  playing: true,
  spread: 0.6,
  yaw: -0.62,
  pitch: 0.34,
  swing: true,
};

type Numeric = { [K in keyof State]: State[K] extends number ? K : never }[keyof State];

const NUMBERS: readonly { name: string; key: Numeric; least: number; most: number; digits: number }[] = [
  { name: "split", key: "split", least: 0, most: 1, digits: 3 },
  { name: "gap", key: "gapMm", least: -100, most: 100, digits: 3 },
  { name: "shiftx", key: "shiftXMm", least: -100, most: 100, digits: 3 },
  { name: "shifty", key: "shiftYMm", least: -100, most: 100, digits: 3 },
  { name: "black", key: "blackLevel", least: 0, most: 1, digits: 4 },
  { name: "pupil", key: "pupilMm", least: 0, most: 20, digits: 2 },
  { name: "frame", key: "frame", least: 0, most: 1e4, digits: 0 },
  { name: "layer", key: "layer", least: 0, most: 100, digits: 0 },
  { name: "rate", key: "rate", least: 0.25, most: 64, digits: 2 },
  { name: "spread", key: "spread", least: 0, most: 1, digits: 3 },
  { name: "yaw", key: "yaw", least: -Math.PI, most: Math.PI, digits: 3 },
  { name: "pitch", key: "pitch", least: -1.5, most: 1.5, digits: 3 },
];

/** Writes a state as `mode=compare&x=0.03&…`, without the values that are defaults. */
export function toHash(state: State, slope: Slope | undefined): string {
  const out = new URLSearchParams();
  if (state.mode !== DEFAULTS.mode) out.set("mode", state.mode);
  if (state.comparison !== DEFAULTS.comparison) out.set("compare", state.comparison);
  if (slope) {
    out.set("x", short(slope[0], 4));
    out.set("y", short(slope[1], 4));
  }
  if (state.gain !== null) out.set("gain", short(state.gain, 3));
  if (state.eyeMm !== null) out.set("eye", short(state.eyeMm, 0));
  for (const { name, key, digits } of NUMBERS) {
    if (state[key] !== DEFAULTS[key]) out.set(name, short(state[key], digits));
  }
  if (!state.playing) out.set("playing", "0");
  if (!state.swing) out.set("swing", "0");
  return out.toString();
}

/**
 * Reads the text that `toHash` writes. Unknown keys and unusable values are ignored. Other numbers
 * are limited to their range.
 */
export function fromHash(hash: string): { state: State; slope: Slope | undefined } {
  const params = new URLSearchParams(hash.replace(/^#/, ""));
  const state: State = { ...DEFAULTS };
  const mode = params.get("mode") as Mode;
  if (MODES.includes(mode)) state.mode = mode;
  const comparison = params.get("compare") as Comparison;
  if (COMPARISONS.includes(comparison)) state.comparison = comparison;
  for (const { name, key, least, most } of NUMBERS) {
    const value = number(params.get(name));
    if (value !== undefined) state[key] = Math.min(Math.max(value, least), most);
  }
  state.frame = Math.round(state.frame);
  state.layer = Math.round(state.layer);
  const gain = number(params.get("gain"));
  if (gain !== undefined && gain > 0) state.gain = gain;
  const eye = number(params.get("eye"));
  if (eye !== undefined && eye >= 50 && eye <= 1e5) state.eyeMm = eye;
  if (params.get("playing") === "0") state.playing = false;
  if (params.get("swing") === "0") state.swing = false;
  const x = number(params.get("x"));
  const y = number(params.get("y"));
  return { state, slope: x === undefined && y === undefined ? undefined : [x ?? 0, y ?? 0] };
}

function number(text: string | null): number | undefined {
  if (text === null || text.trim() === "") return undefined;
  const value = Number(text);
  return Number.isFinite(value) ? value : undefined;
}

function short(value: number, digits: number): string {
  return String(Number(value.toFixed(digits)));
}
