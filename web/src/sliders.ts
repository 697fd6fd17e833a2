// The sliders for the eye, and for errors of the display's construction, such as wrong gaps. Their
// ranges depend on the display.
import type { Info } from "./info.js";
import { DEFAULTS, type State } from "./state.js";

interface Slider {
  id: string;
  key: "gain" | "gapMm" | "shiftXMm" | "shiftYMm" | "blackLevel" | "pupilMm" | "eyeMm";
  range(info: Info): { min: number; max: number; step: number };
  words(value: number, info: Info): string;
}

/** Largest eye distance of the slider, mm. At the next larger step the slider selects the projection of the target. */
const EYE_MOST_MM = 3000;

const SLIDERS: readonly Slider[] = [
  {
    id: "gain",
    key: "gain",
    range: ({ brightness }) => ({ min: 1, max: 1 / brightness, step: (1 / brightness - 1) / 200 || 0.01 }),
    words: (value, { brightness }) => `× ${value.toFixed(2)}${brightness < 1 && value > 0.999 / brightness ? " · adapted" : ""}`,
  },
  { id: "gap", key: "gapMm", range: gapRange, words: (value) => signed(value, "mm", 2) },
  { id: "shiftx", key: "shiftXMm", range: shiftRange, words: (value) => signed(value, "mm", 2) },
  { id: "shifty", key: "shiftYMm", range: shiftRange, words: (value) => signed(value, "mm", 2) },
  { id: "black", key: "blackLevel", range: () => ({ min: 0, max: 0.1, step: 0.001 }), words: (value) => `${(value * 100).toFixed(1)} %` },
  { id: "pupil", key: "pupilMm", range: () => ({ min: 0, max: 8, step: 0.25 }), words: (value) => (value > 0 ? `${value.toFixed(2)} mm` : "pinhole") },
  {
    id: "eye",
    key: "eyeMm",
    range: () => ({ min: 150, max: EYE_MOST_MM + 50, step: 50 }),
    words: (value, { views }) => (value <= EYE_MOST_MM ? `${Math.round(value)} mm` : views.projection === "oblique" ? "parallel views" : "as designed"),
  },
];

export class Sliders {
  private info: Info | undefined;

  constructor(
    private readonly root: ParentNode,
    private readonly state: () => State,
    changed: () => void,
  ) {
    for (const slider of SLIDERS) {
      this.input(slider).addEventListener("input", (event) => {
        const value = Number((event.target as HTMLInputElement).value);
        const state = this.state();
        // At the right end of its range the slider sets the gain to null, which stands for 1/β of
        // the current display.
        if (slider.key === "gain") state.gain = this.info && value > 0.9995 / this.info.brightness ? null : value;
        else if (slider.key === "eyeMm") state.eyeMm = value > EYE_MOST_MM ? null : value;
        else state[slider.key] = value;
        this.show();
        changed();
      });
    }
    this.button().addEventListener("click", () => {
      const state = this.state();
      for (const { key } of SLIDERS) Object.assign(state, { [key]: DEFAULTS[key] });
      this.show();
      changed();
    });
  }

  /** Sets the ranges for a display. */
  setUp(info: Info): void {
    this.info = info;
    for (const slider of SLIDERS) {
      const { min, max, step } = slider.range(info);
      const input = this.input(slider);
      [input.min, input.max, input.step] = [String(min), String(max), String(step)];
    }
    this.input(SLIDERS[0]!).disabled = info.brightness >= 1;
    (this.root.querySelector("#gap-row") as HTMLElement).hidden = info.layers.length < 2 && !info.directional;
    this.show();
  }

  show(): void {
    const info = this.info;
    if (!info) return;
    const state = this.state();
    for (const slider of SLIDERS) {
      const input = this.input(slider);
      const value = state[slider.key] ?? Number(input.max);
      input.value = String(value);
      const words = slider.words(value, info);
      input.setAttribute("aria-valuetext", words);
      (this.root.querySelector(`#${slider.id}-value`) as HTMLElement).textContent = words;
      this.root.querySelector(`#${slider.id}-row`)!.classList.toggle("changed", state[slider.key] !== DEFAULTS[slider.key]);
      paintTrack(input);
    }
    const changed = SLIDERS.some(({ key }) => state[key] !== DEFAULTS[key]);
    (this.button() as HTMLButtonElement).disabled = !changed;
    // A link may set errors of the display's construction. Then unfold the group of their sliders,
    // so that the values are visible.
    if (changed) (this.root.querySelector("#build") as HTMLDetailsElement).open = true;
  }

  private input({ id }: Slider): HTMLInputElement {
    return this.root.querySelector(`#${id}`)!;
  }

  private button(): HTMLElement {
    return this.root.querySelector("#reset")!;
  }
}

/** Paints a slider's track from the value 0 to its thumb; if 0 is not in its range, from the left end. */
export function paintTrack(input: HTMLInputElement): void {
  const [min, max, value] = [Number(input.min), Number(input.max), Number(input.value)];
  const share = (at: number): number => (max > min ? ((at - min) / (max - min)) * 100 : 0);
  const from = share(min < 0 && max > 0 ? 0 : min);
  const to = share(value);
  const [low, high] = [Math.min(from, to), Math.max(from, to)];
  input.style.setProperty("--track", `linear-gradient(90deg, var(--line) ${low}%, var(--accent) ${low}%, var(--accent) ${high}%, var(--line) ${high}%)`);
}

function gapRange(info: Info): { min: number; max: number; step: number } {
  const gaps = info.layers.slice(1).map((layer, i) => layer.d_mm - info.layers[i]!.d_mm);
  const most = nice(gaps.length > 0 ? Math.min(...gaps) * 0.5 : 1);
  return { min: -most, max: most, step: most / 50 };
}

function shiftRange(info: Info): { min: number; max: number; step: number } {
  const front = info.layers[info.layers.length - 1];
  const most = nice(8 * (front?.pitch_mm ?? 1));
  return { min: -most, max: most, step: most / 50 };
}

/**
 * Returns the largest number of the form 1, 2 or 5 times a power of ten, up to `value`; 1 if
 * `value` is not above 0.
 */
function nice(value: number): number {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  const lead = value / power;
  return power * (lead >= 5 ? 5 : lead >= 2 ? 2 : 1);
}

function signed(value: number, unit: string, digits: number): string {
  return `${value > 0 ? "+" : value < 0 ? "−" : ""}${Math.abs(value).toFixed(digits)} ${unit}`;
}
