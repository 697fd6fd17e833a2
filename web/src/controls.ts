// Applies input from the buttons, sliders and keys around the picture to the state.
import { copyLink, savePicture, TurnRecorder, type Shown } from "./actions.js";
import { Address } from "./address.js";
import { listenToChooser, listenToDrops } from "./chooser.js";
import { StackContent, type Content } from "./content.js";
import type { Face } from "./face.js";
import { handleKey, listenToDivider, listenToPad, listenToPointer, type InputTarget } from "./input.js";
import type { Ticker } from "./loop.js";
import { Tilt, type Motion } from "./motion.js";
import type { Problem } from "./problem.js";
import { lastMask } from "./sheet.js";
import { zoneSlope } from "./info.js";
import type { Shot, Stage } from "./stage.js";
import type { Comparison, Mode, Slope, State } from "./state.js";
import { toggleTheme } from "./theme.js";

const FURTHEST_PITCH = 1.45;

/** The objects that the controls change. */
export interface Controlled {
  readonly element: HTMLElement;
  readonly root: ShadowRoot;
  readonly face: Face;
  readonly stage: Stage;
  readonly motion: Motion;
  readonly ticker: Ticker;
  state(): State;
  content(): Content | undefined;
  set(change: Partial<State>): void;
  look(slope: Slope): void;
  /** The current picture; undefined before the first patterns have arrived. */
  shot(): Shot | undefined;
  stepFrame(by: number): void;
  open(files: ReadonlyMap<string, File>): Promise<void>;
  report(problem: Problem): void;
}

export class Controls {
  private readonly turn: TurnRecorder;
  private readonly tilt = new Tilt();
  private readonly target: InputTarget;

  constructor(private readonly on: Controlled) {
    this.turn = new TurnRecorder(on.face, on.stage, on.motion);
    this.target = this.inputTarget();
    this.listenToPicture();
    this.listenToControls();
    this.listenToButtons();
  }

  /** Called after a picture has been drawn. */
  drawn(): void {
    this.turn.frame();
  }

  key(event: KeyboardEvent): void {
    const { on } = this;
    const from = event.composedPath()[0];
    if (!(from instanceof HTMLElement) || event.defaultPrevented || !on.content() || (on.face.at("chooser") as HTMLDialogElement).open) return;
    // If a slider, field or button has the focus, it handles these keys itself.
    const own = { INPUT: /^(Arrow|Home|End|Page| )/, BUTTON: /^( |Enter)/, TEXTAREA: /./, SELECT: /./ }[from.tagName];
    if (own?.test(event.key) || from.isContentEditable) return;
    if (handleKey(event, on.motion, this.target)) event.preventDefault();
  }

  stop(): void {
    this.tilt.stop();
    this.on.face.at("tilt").setAttribute("aria-pressed", "false");
  }

  private listenToPicture(): void {
    const { on, target } = this;
    const { face } = on;
    listenToPointer(face.at("stage"), on.motion, target);
    listenToPad(face.at("pad"), on.motion, target);
    listenToDivider(
      face.at("divider"),
      face.at("picture"),
      (share) => on.set({ split: Math.min(Math.max(share, 0), 1) }),
      () => on.state().split,
    );
    const open = (files: ReadonlyMap<string, File>): Promise<void> => on.open(files);
    listenToChooser((id) => face.at(id), open);
    listenToDrops(on.element, face.at("drop"), open, (problem) => on.report(problem));
  }

  private listenToControls(): void {
    const { on } = this;
    on.root.addEventListener("change", (event) => {
      const input = event.target as HTMLInputElement;
      if (input.name === "mode") on.set({ mode: input.value as Mode });
      if (input.name === "comparison") on.set({ comparison: input.value as Comparison });
    });
    const onInput = (id: string, change: (value: number) => Partial<State>): void =>
      on.face.at(id).addEventListener("input", (event) => on.set(change(Number((event.target as HTMLInputElement).value))));
    onInput("rate", (value) => ({ rate: 2 ** value }));
    onInput("spread", (spread) => ({ spread }));
    onInput("exploded-frame", (frame) => ({ frame }));
  }

  /** Records one turn around the zone and saves it as a video. */
  async saveTurn(): Promise<void> {
    if (this.on.content()) await this.turn.save(this.shown, () => this.on.ticker.redraw());
  }

  private get shown(): Shown {
    return { title: this.on.content()?.info.title ?? "", mode: this.on.state().mode };
  }

  private listenToButtons(): void {
    const { on, target } = this;
    const shown = (): Shown => this.shown;
    const onClick = (id: string, action: () => unknown): void => on.face.at(id).addEventListener("click", () => void action());
    onClick("step-back", () => target.stepFrame(-1));
    onClick("step-on", () => target.stepFrame(1));
    onClick("play", () => on.set({ playing: !on.state().playing }));
    onClick("apart", () => on.set({ mode: on.state().mode === "exploded" ? "perceived" : "exploded" }));
    onClick("front", () => on.set({ yaw: 0, pitch: 0 }));
    onClick("centre", () => on.look([0, 0]));
    onClick("swing", () => {
      on.motion.input();
      on.set({ swing: !on.state().swing });
      if (on.state().swing) on.motion.swingNow();
    });
    onClick("tilt", () => this.toggleTilt());
    onClick("theme", () => toggleTheme(on.element));
    onClick("full", () => (document.fullscreenElement ? document.exitFullscreen() : on.element.requestFullscreen()));
    onClick("shot", () => {
      const shot = on.shot();
      return shot && savePicture(on.stage, shot, shown(), on.motion);
    });
    onClick("record", () => this.saveTurn());
    onClick("link", () => copyLink(`${location.href.replace(/#.*$/, "")}${Address.hash(on.state(), on.motion.slope, true)}`, on.face));
  }

  private inputTarget(): InputTarget {
    const { on } = this;
    return {
      mode: () => on.state().mode,
      zone: () => {
        const content = on.content();
        return content ? zoneSlope(content.info) : [1, 1];
      },
      setMode: (mode) => {
        if (on.content() instanceof StackContent && !on.face.radio("mode", mode).disabled) on.set({ mode });
      },
      turn: (yaw, pitch) => {
        const state = on.state();
        const turned = state.yaw + yaw;
        state.yaw = Math.atan2(Math.sin(turned), Math.cos(turned));
        state.pitch = Math.min(Math.max(state.pitch + pitch, -FURTHEST_PITCH), FURTHEST_PITCH);
        on.ticker.redraw();
      },
      pause: () => {
        on.motion.input();
        const state = on.state();
        on.set(state.mode === "slow" ? { playing: !state.playing } : { swing: !state.swing });
      },
      stepFrame: (by) => {
        on.stepFrame(by);
        on.set({ playing: false });
      },
      stepLayer: (by) => {
        const content = on.content();
        if (content) on.set({ layer: Math.min(Math.max(on.state().layer + by, 0), lastMask(content.info)) });
      },
      moved: () => {
        on.motion.touched();
        on.ticker.wake();
      },
    };
  }

  private async toggleTilt(): Promise<void> {
    const { face } = this.on;
    if (this.tilt.on) this.tilt.stop();
    else if (!(await this.tilt.start((slope) => this.on.look(slope)))) {
      face.notice("This device reports no tilt. Allow motion sensors for this page in the browser’s settings, and try again.", "passing");
    }
    face.at("tilt").setAttribute("aria-pressed", String(this.tilt.on));
  }
}
