// What the user has chosen, and its form in the address bar.

/** What the viewer shows. */
export type Mode = "perceived" | "slow" | "exploded" | "compare" | "layers";
/** How target and display are compared. */
export type Comparison = "slider" | "side" | "error";
/** Who draws what the display shows. */
export type Path = "webgl2" | "cpu";
/** Tangents of the angles at which one looks: right of the normal, above it. */
export type Slope = readonly [x: number, y: number];

export const MODES: readonly Mode[] = ["perceived", "slow", "exploded", "compare", "layers"];
export const COMPARISONS: readonly Comparison[] = ["slider", "side", "error"];

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

/** `mode=compare&x=0.03&…`; what stands at its default is left out. */
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

/** Reads what `toHash` writes; what is not understood keeps its default. */
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
