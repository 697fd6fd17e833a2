// The user's choice of a display. The page's controls show the choice, and the page's address
// contains it.

interface About {
  layers: number;
  frames: number;
  brightness: number;
  gap_mm: number;
  directional: boolean;
}

export interface Preset {
  name: string;
  title: string;
  about: About;
}

const SLIDERS = ["layers", "gap_mm", "frames", "brightness"] as const;
type Key = (typeof SLIDERS)[number];

/** The choices of detail: the number of columns of the light field, and the choice's text. */
const DETAILS: readonly [number, string][] = [
  [96, "Quick, 96 columns"],
  [160, "Normal, 160 columns"],
  [240, "Fine, 240 columns"],
  [420, "Finest, 420 columns"],
];
/** Keys of the address that set the solver's effort; a job file has the same keys. */
const EFFORT = ["zone_samples", "iterations"] as const;
/** Keys of the address that choose the device and the number of threads. */
const MACHINE = ["device", "threads"] as const;
/** Largest number of frames that a preset sets. On the processor one thread solves, so more frames would be slow. */
const FRAMES = 6;
const DEFAULT = "paper-three-layer";

export class Choice {
  private presets: Preset[] = [];
  /** The choice in the page's address when it was loaded. */
  private readonly asked = new URLSearchParams(location.hash.slice(1));

  constructor(changed: () => void) {
    const cols = this.select("cols");
    cols.append(...DETAILS.map(([value, text]) => new Option(text, String(value), value === 160, value === 160)));
    const wanted = this.asked.get("cols");
    if (wanted && DETAILS.some(([value]) => String(value) === wanted)) cols.value = wanted;
    cols.addEventListener("change", changed);
    this.select("preset").addEventListener("change", () => {
      this.stand();
      changed();
    });
    for (const key of SLIDERS) {
      this.slider(key).addEventListener("input", () => {
        this.words();
        changed();
      });
    }
  }

  /** Fills the list of presets, and applies the choice of the address. */
  know(presets: Preset[]): void {
    if (this.presets.length > 0) return;
    this.presets = presets;
    this.select("preset").append(...presets.map(({ name, title }) => new Option(title, name, name === DEFAULT, name === DEFAULT)));
    const wanted = this.asked.get("preset");
    if (wanted && presets.some(({ name }) => name === wanted)) this.select("preset").value = wanted;
    this.stand();
    for (const key of SLIDERS) {
      const value = this.asked.get(key);
      if (value !== null && Number.isFinite(Number(value))) this.slider(key).value = value;
    }
    this.words();
  }

  /** The choice as JSON for the solver, without values that equal the preset's values. */
  get settings(): string {
    const { about } = this.preset;
    const own = { layers: about.layers, gap_mm: about.gap_mm, frames: about.frames, brightness: about.brightness };
    const changed = SLIDERS.filter((key) => Math.abs(this.value(key) - own[key]) > 1e-6);
    // A display with a single layer has no gap.
    const given = changed.filter((key) => key !== "gap_mm" || this.value("layers") > 1);
    const effort = EFFORT.filter((key) => Number(this.asked.get(key)) > 0).map((key) => [key, Number(this.asked.get(key))]);
    return JSON.stringify({
      preset: this.preset.name,
      cols: Number(this.select("cols").value),
      ...Object.fromEntries(given.map((key) => [key, this.value(key)])),
      ...Object.fromEntries(effort),
    });
  }

  /** The choice as parameters of a link. */
  get address(): URLSearchParams {
    const out = new URLSearchParams({ preset: this.preset.name, cols: this.select("cols").value });
    for (const key of SLIDERS) out.set(key, this.slider(key).value);
    // These keys have no control. The page that opens the link must also solve with them.
    for (const key of [...EFFORT, ...MACHINE]) {
      const value = this.asked.get(key);
      if (value !== null) out.set(key, value);
    }
    return out;
  }

  private get preset(): Preset {
    return this.presets.find(({ name }) => name === this.select("preset").value) ?? this.presets[0]!;
  }

  /** Sets the sliders to the preset's values. */
  private stand(): void {
    const { about } = this.preset;
    this.slider("layers").value = String(about.layers);
    this.slider("gap_mm").value = String(about.gap_mm);
    this.slider("frames").value = String(Math.min(about.frames, FRAMES));
    this.slider("brightness").value = String(about.brightness);
    this.words();
  }

  private words(): void {
    const layers = this.value("layers");
    const say = (key: Key, text: string): void => void (document.getElementById(`${key}-text`)!.textContent = text);
    say("layers", this.preset.about.directional ? `${layers} and a directional backlight` : String(layers));
    say("gap_mm", `${this.value("gap_mm")} mm`);
    say("frames", String(this.value("frames")));
    say("brightness", `${Math.round(100 * this.value("brightness"))} %`);
    this.slider("gap_mm").disabled = layers < 2;
  }

  private value(key: Key): number {
    return Number(this.slider(key).value);
  }

  private slider(key: Key): HTMLInputElement {
    return document.getElementById(key) as HTMLInputElement;
  }

  private select(id: "preset" | "cols"): HTMLSelectElement {
    return document.getElementById(id) as HTMLSelectElement;
  }
}
