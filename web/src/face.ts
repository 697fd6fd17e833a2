// Shows the parts around the picture: controls, progress, messages, and a text about the viewing
// position.
import type { Problem } from "./problem.js";
import { layerName } from "./sheet.js";
import { zoneSlope, type Info } from "./info.js";
import { paintTrack } from "./sliders.js";
import type { Mode, Path, Slope, State } from "./state.js";
import { ICONS } from "./template.js";
import { inWords, isInside } from "./zone.js";

/** Milliseconds after which a message of the kind "passing" disappears. */
const PASSING_MS = 8000;

export class Face {
  private readonly frame: HTMLElement;
  private version = "";
  private passing: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly root: ShadowRoot) {
    this.frame = root.querySelector(".frame")!;
    (this.at("notice").lastElementChild as HTMLElement).addEventListener("click", () => this.silence());
  }

  at(id: string): HTMLElement {
    return this.root.getElementById(id)!;
  }

  /** Sets names and limits for a display that has just been loaded. */
  setUp(info: Info): void {
    this.at("title").textContent = info.title || "Untitled";
    this.at("facts").textContent = facts(info);
    this.at("caption").textContent = info.caption;
    // A light field from another program has no layers. So the class `foreign` hides the controls
    // for modes and for errors of the display's construction.
    this.frame.classList.toggle("foreign", info.layers.length === 0);
    (this.at("exploded-frame") as HTMLInputElement).max = String(info.frames - 1);
    this.at("exploded-frame-label").hidden = info.frames < 2;
  }

  /** Shows the error map's colours, with the error that the last colour stands for, and sets the version. */
  about(version: string, heat: string, heatTop: number): void {
    (this.root.querySelector("#legend i") as HTMLElement).style.background = `linear-gradient(90deg, ${heat})`;
    this.at("legend-most").textContent = `${Math.round(heatTop * 100)} % of white`;
    this.version = version;
  }

  /** Enables or disables a mode. */
  allow(mode: string, possible: boolean): void {
    this.radio("mode", mode).disabled = !possible;
  }

  radio(name: "mode" | "comparison", value: string): HTMLInputElement {
    return this.root.querySelector(`input[name="${name}"][value="${value}"]`)!;
  }

  /** Updates the controls for the state. */
  showState(state: State, info: Info | undefined): void {
    this.frame.dataset["mode"] = state.mode;
    this.frame.dataset["comparison"] = state.comparison;
    this.radio("mode", state.mode).checked = true;
    this.radio("comparison", state.comparison).checked = true;
    this.at("swing").setAttribute("aria-pressed", String(state.swing));
    const comparing = state.mode === "compare";
    const slider = comparing && state.comparison === "slider";
    const side = comparing && state.comparison === "side";
    for (const id of ["tag-left", "tag-right"]) this.at(id).hidden = !(slider || side);
    const divider = this.at("divider");
    divider.hidden = !slider;
    divider.style.left = `${state.split * 100}%`;
    divider.setAttribute("aria-valuenow", String(Math.round(state.split * 100)));
    this.at("legend").hidden = !(comparing && state.comparison === "error");
    const picture = this.at("picture");
    picture.classList.toggle("both", side);
    picture.classList.toggle("bare", state.mode === "exploded");
    picture.classList.toggle("grain", state.mode === "layers");
    this.at("apart").textContent = state.mode === "exploded" ? "Put it together" : "Take it apart";
    const play = this.at("play");
    play.innerHTML = state.playing ? ICONS.pause : ICONS.play;
    play.setAttribute("aria-label", state.playing ? "Pause" : "Play");
    const digits = state.rate < 1 ? 2 : state.rate < 10 ? 1 : 0;
    this.slider("rate", Math.log2(state.rate), `${state.rate.toFixed(digits)} per s`);
    this.slider("spread", state.spread, undefined);
    this.slider("exploded-frame", state.frame, info ? `${state.frame + 1} of ${info.frames}` : "");
    this.showFrame(state, info);
  }

  showFrame(state: State, info: Info | undefined): void {
    if (info) this.at("frame-count").textContent = `Frame ${state.frame + 1} of ${info.frames}`;
  }

  /** Describes the viewing position in words. If the view is `resting`, screen readers also read the text. */
  describe(info: Info, state: State, slope: Slope, resting: boolean): void {
    const inside = isInside(slope, zoneSlope(info));
    const place = this.at("place");
    const words = inWords(slope);
    const bold = document.createElement("b");
    bold.textContent = words[0]!.toUpperCase() + words.slice(1);
    place.replaceChildren(bold, whereabouts(info, state.mode, inside));
    place.classList.toggle("outside", !inside);
    const shown = state.mode === "layers" ? `${layerName(state.layer, info.layers.length)}, frame ${state.frame + 1}` : `${info.title}, seen from ${words}`;
    this.at("shown").setAttribute("aria-label", shown);
    const live = this.at("live");
    const said = `${words}${inside ? "" : ", outside the zone"}`;
    if (resting && live.textContent !== said) live.textContent = said;
  }

  /** Shows or hides the hint on how to look around. */
  nudge(visible: boolean): void {
    this.at("nudge").hidden = !visible;
  }

  /** Sets whether the poster or small views cover the canvas. */
  early(on: boolean): void {
    this.at("picture").classList.toggle("early", on);
    // The style sheet shows the poster until the element has this class.
    this.at("picture").classList.add("started");
  }

  progress(share: number, text: string): void {
    const bar = this.at("progress");
    bar.hidden = share >= 1;
    bar.setAttribute("aria-valuenow", String(Math.round(share * 100)));
    (bar.firstElementChild as HTMLElement).style.width = `${(share * 100).toFixed(1)}%`;
    bar.lastElementChild!.textContent = text;
  }

  /** Shows a card in place of the picture. */
  card(title: string, what: string, advice: string): void {
    const card = this.at("card");
    card.querySelector("h2")!.textContent = title;
    card.querySelector(".what")!.textContent = what;
    card.querySelector(".advice")!.textContent = advice;
    card.hidden = false;
  }

  refuse({ message, advice }: Problem): void {
    this.at("picture").hidden = true;
    this.card("This preview cannot be shown", message, advice);
  }

  /** Shows a message over the picture. A message of the kind "passing" disappears by itself. */
  notice(text: string, kind: "warn" | "passing" | "plain"): void {
    clearTimeout(this.passing);
    const notice = this.at("notice");
    notice.firstElementChild!.textContent = text;
    notice.classList.toggle("warn", kind === "warn");
    notice.hidden = false;
    if (kind === "passing") this.passing = setTimeout(() => this.silence(), PASSING_MS);
  }

  silence(): void {
    clearTimeout(this.passing);
    this.at("notice").hidden = true;
  }

  /** Removes messages and cards when a load begins. */
  fresh(): void {
    this.silence();
    this.at("card").hidden = true;
    this.at("picture").hidden = false;
    this.at("picture").classList.remove("started");
  }

  path(path: Path): void {
    this.frame.dataset["path"] = path;
    this.at("footer").textContent = `Lumistack ${this.version}${path === "cpu" ? " · drawn by the processor" : ""}`;
  }

  private slider(id: string, value: number, words: string | undefined): void {
    const input = this.at(id) as HTMLInputElement;
    input.value = String(value);
    paintTrack(input);
    if (words === undefined) return;
    this.at(`${id}-value`).textContent = words;
    input.setAttribute("aria-valuetext", words);
  }
}

/** Returns a text that states if the viewing position is inside the viewing zone or the views. In the mode "compare" it only mentions the nearest view. */
function whereabouts(info: Info, mode: Mode, inside: boolean): string {
  if (info.layers.length === 0) return inside ? "Within the views." : "Outside the views.";
  if (mode === "compare") return "Compared with the nearest view.";
  return inside ? "In the zone." : "Outside the zone that the solver used.";
}

function facts(info: Info): string {
  const size = `${info.field.cols} × ${info.field.rows}`;
  if (info.layers.length === 0) return `${info.views.cols} × ${info.views.rows} views of ${size}`;
  const plural = (n: number, word: string): string => `${n} ${word}${n === 1 ? "" : "s"}`;
  return [plural(info.layers.length, "layer"), plural(info.frames, "frame"), size, info.directional ? "directional backlight" : "uniform backlight"].join(" · ");
}
