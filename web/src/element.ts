// The element <lumistack-viewer src="stack/preview.json">, which loads a preview and shows it.
//
// Attributes:
//
// * src: address of the preview
// * renderer: "cpu" never uses WebGL2; "webgl2" uses it even if it is slow
// * wasm: URL of the module, if it is not beside the script
// * theme: "dark" or "light" replaces the system's theme
// * plain: shows the picture alone, for pages that bring their own controls
// * url-state: keeps the user's options in the page's address
// * keyboard: with "page" the element receives keys of the whole page, not only of the focused
//   picture
// * hold: the view does not swing by itself
import { Address } from "./address.js";
import type { Surroundings } from "./around.js";
import { download, fileName, toPng, videoFormat } from "./capture.js";
import { readyFrame, StackContent, type Content } from "./content.js";
import { Controls } from "./controls.js";
import { recognize } from "./drop.js";
import type { Engine } from "./engine.js";
import { Face } from "./face.js";
import { nearestView, zoneSlope, type FileInfo, type Info } from "./info.js";
import { layOut } from "./layout.js";
import { Loader } from "./loader.js";
import { Ticker } from "./loop.js";
import { Motion, Tilt } from "./motion.js";
import { Others, type Views } from "./others.js";
import type { Wish } from "./painter.js";
import { Problem, problemOf } from "./problem.js";
import { quilt } from "./quilt.js";
import { lastMask, Sheet } from "./sheet.js";
import { Sliders } from "./sliders.js";
import { FilesSource, sourceOf } from "./source.js";
import { Stage, type Shot } from "./stage.js";
import { DEFAULTS, fromHash, type Comparison, type Mode, type Path, type Slope, type State } from "./state.js";
import { TEMPLATE } from "./template.js";
import { restoreTheme } from "./theme.js";
import { ZoneMap } from "./zone.js";
import sheetCss from "./sheet/viewer.css";

export interface LumistackErrorDetail {
  message: string;
  /** A possible remedy, as a sentence; empty if there is none. */
  advice: string;
  /** True if nothing can be shown. */
  fatal: boolean;
}

/** Largest width of the element at which its parts are arranged one below another, CSS pixels. */
const NARROW_PX = 860;
/** Shortest time between two updates of the text that describes the viewing position, milliseconds. */
const WORDS_MS = 90;
/** Milliseconds for which the compared view must stay the same before its PSNR is computed. */
const PSNR_MS = 60;
/**
 * Milliseconds out of sight after which a viewer releases its graphics context. Browsers allow only
 * a few contexts at a time.
 */
const REST_MS = 1500;

export class LumistackViewer extends HTMLElement {
  static readonly observedAttributes = ["src", "renderer"];

  private readonly root = this.attachShadow({ mode: "open" });
  private readonly face: Face;
  private readonly stageBox: HTMLElement;
  private readonly picture: HTMLElement;
  private readonly stage: Stage;
  private readonly motion = new Motion();
  private readonly ticker: Ticker;
  private readonly map: ZoneMap;
  private readonly sliders: Sliders;
  private readonly sheet: Sheet;
  private readonly controls: Controls;
  private readonly address = new Address();
  private readonly loader: Loader;

  private state: State = { ...DEFAULTS };
  private content: Content | undefined;
  /** Small views that the viewer shows until the patterns have arrived. */
  private around: Surroundings | undefined;
  private resting: ReturnType<typeof setTimeout> | undefined;

  private frameClockS = 0;
  private wordsTimer: ReturnType<typeof setTimeout> | undefined;
  private psnrTimer: ReturnType<typeof setTimeout> | undefined;
  private psnrKey = "";
  private life: AbortController | undefined;

  constructor() {
    super();
    const style = document.createElement("style");
    style.textContent = sheetCss;
    const template = document.createElement("template");
    template.innerHTML = TEMPLATE;
    this.root.append(style, template.content.cloneNode(true));
    this.face = new Face(this.root);
    this.stageBox = this.face.at("stage");
    this.picture = this.face.at("picture");
    this.stage = new Stage(this.face.at("shown"), { shown: () => this.drawn(), failed: (error) => this.drawingFailed(error) });
    this.ticker = new Ticker(this.motion, {
      can: () => this.isConnected && ((this.content?.frames.length ?? 0) > 0 || this.around !== undefined),
      play: (dtS) => this.playFrames(dtS),
      draw: () => this.draw(),
    });
    this.map = new ZoneMap(
      this.face.at("pad"),
      (slope) => this.look(slope),
      (down) => (down ? this.motion.hold() : this.motion.release(false)),
    );
    this.sliders = new Sliders(
      this.root,
      () => this.state,
      () => this.stateChanged(),
    );
    this.sheet = new Sheet(this.face.at("sheet"), (layer, frame) => this.set({ layer, frame }));
    this.loader = new Loader(this.stage, {
      clear: () => this.dropContent(),
      shown: (content) => this.show(content),
      poster: (address) => this.showPoster(address),
      around: (views) => this.lookInto(views),
      opened: (content, engine) => this.opened(content, engine),
      progress: (share) => this.progress(share),
      part: (content, file) => this.arrived(content, file),
      finished: (content, failed) => this.finish(content, failed),
      problem: (problem) => this.report(problem),
    });
    this.controls = new Controls({
      element: this,
      root: this.root,
      face: this.face,
      stage: this.stage,
      motion: this.motion,
      ticker: this.ticker,
      state: () => this.state,
      content: () => this.content,
      set: (change) => this.set(change),
      look: (slope) => this.look(slope),
      shot: () => this.shot(),
      stepFrame: (by) => this.stepFrame(by),
      open: (files) => this.open(files),
      report: (problem) => this.report(problem),
    });
    new Others(this.face, () => this.views());
  }

  // --- public interface

  /** Resolves when the first picture is shown; rejects if no picture can be shown. */
  get ready(): Promise<void> {
    return this.loader.firstPicture.promise;
  }

  /** Resolves when every file has arrived or failed; rejects if no frame is complete. */
  get complete(): Promise<void> {
    return this.loader.everything.promise;
  }

  get src(): string {
    return this.getAttribute("src") ?? "";
  }
  set src(value: string) {
    this.setAttribute("src", value);
  }

  get mode(): Mode {
    return this.state.mode;
  }
  set mode(mode: Mode) {
    this.set({ mode });
  }

  /** The kind of comparison in the mode "compare". */
  get comparison(): Comparison {
    return this.state.comparison;
  }
  set comparison(comparison: Comparison) {
    this.set({ comparison });
  }

  /** The slope of the view. Setting it ends the swing and the inertia of the view. */
  get slope(): Slope {
    return this.motion.slope;
  }
  set slope(slope: Slope) {
    this.motion.standAt(slope);
    this.set({ swing: false });
    this.ticker.now();
  }

  /** The renderer: "webgl2" or "cpu". */
  get path(): Path {
    return this.stage.path;
  }

  /**
   * Returns the RGBA bytes of the current picture. Views and comparisons have the light field's
   * size. In the side-by-side comparison these are the bytes of the display's picture alone,
   * without the target. Before the first picture, the result is one transparent pixel.
   */
  async pixels(): Promise<ImageData> {
    const shot = this.shot();
    return shot ? this.stage.pixels(shot) : new ImageData(1, 1);
  }

  /** Returns the current picture as PNG. */
  async screenshot(): Promise<Blob> {
    const shot = this.shot();
    if (!shot) throw new Error("there is no picture yet");
    return toPng(await this.stage.still(shot));
  }

  /** Saves a quilt of 8 × 6 views for lenticular displays: a PNG, `TITLE_qs8x6aASPECT.png`. */
  async saveQuilt(): Promise<void> {
    const views = this.views();
    if (!views) throw new Error("there is no picture yet");
    const { blob, ending } = await quilt(views);
    download(blob, `${fileName(views.info.title)}${ending}`);
  }

  /** Records one turn around the viewing zone and saves it as a video. */
  async saveTurn(): Promise<void> {
    await this.controls.saveTurn();
  }

  /** Shows files, given by path: a preview, a quilt, or the views of a light field. */
  async open(files: ReadonlyMap<string, File>): Promise<void> {
    try {
      const dropped = recognize(files);
      if (dropped.kind === "preview") await this.loader.preview(new FilesSource(dropped.files, dropped.json), this.module);
      else await this.loader.field(dropped, this.module);
    } catch (error) {
      this.report(problemOf(error, "Open other files, or load this page again."));
    }
  }

  /**
   * Shows patterns that are being computed. `json` is the text of their preview.json. `codes`
   * contains the pictures of all files that `json` lists, in this order, [row][col][rgb] each. If
   * `json` is the current preview, only the patterns are replaced, all in one step.
   */
  async showStack(json: string, codes: Uint8Array<ArrayBuffer>): Promise<void> {
    const { content } = this;
    if (!(content instanceof StackContent) || content.json !== json) return this.loader.stack(json, codes, this.module);
    await content.exchange(codes);
    this.sheet.forget();
    this.stateChanged();
  }

  /**
   * Replaces all patterns of the current preview in one step. `files` contains a PNG for every file
   * of the preview, in the preview's order.
   */
  async renew(files: readonly ArrayBuffer[]): Promise<void> {
    if (!(this.content instanceof StackContent)) return;
    await this.content.renew(files);
    this.sheet.forget();
    this.stateChanged();
  }

  // --- life cycle

  connectedCallback(): void {
    this.life = new AbortController();
    const { signal } = this.life;
    const reduced = matchMedia("(prefers-reduced-motion: reduce)");
    const calm = (): void => {
      this.motion.calm = reduced.matches;
      if (reduced.matches) this.set({ swing: false });
    };
    reduced.addEventListener("change", calm, { signal });
    const resizer = new ResizeObserver(() => this.layOut());
    resizer.observe(this.stageBox);
    const watcher = new IntersectionObserver((seen) => this.seen(seen.at(-1)!.isIntersecting));
    watcher.observe(this);
    signal.addEventListener("abort", () => {
      resizer.disconnect();
      watcher.disconnect();
    });
    const keys: EventTarget = this.getAttribute("keyboard") === "page" ? document : this.stageBox;
    keys.addEventListener("keydown", (event) => this.controls.key(event as KeyboardEvent), { signal });
    this.face.at("tilt").hidden = !Tilt.possible;
    this.face.at("nudge").textContent = this.hint;
    this.face.at("record").hidden = videoFormat() === undefined;
    this.face.at("full").hidden = !document.fullscreenEnabled;
    restoreTheme(this);
    if (this.hasAttribute("hold")) this.state.swing = false;
    calm();
    if (this.keepsAddress) {
      addEventListener("hashchange", () => this.readAddress(), { signal });
      this.readAddress();
    }
    this.stateChanged();
    if (this.src) {
      this.watchPoster();
      void this.load();
    } else this.face.card("Open a preview", "Drop a preview folder, a quilt or a folder of views here.", "Nothing leaves this computer.");
  }

  disconnectedCallback(): void {
    this.life?.abort();
    this.loader.stop();
    this.controls.stop();
    this.ticker.stop();
    this.address.stop();
    clearTimeout(this.wordsTimer);
    clearTimeout(this.psnrTimer);
    clearTimeout(this.resting);
    this.dropContent();
  }

  attributeChangedCallback(name: string, before: string | null, now: string | null): void {
    if (!this.isConnected || before === now || !this.life) return;
    if (name === "src" && now) void this.load();
    if (name === "renderer") this.content?.attach(this.wish());
  }

  // --- loading

  /** The hint on how to look around. With the attribute `plain` there is no button for tilt. */
  private get hint(): string {
    if (matchMedia("(hover: hover)").matches) return "Move the mouse to look around";
    return Tilt.possible && !this.hasAttribute("plain") ? "Drag to look around, or press Tilt" : "Drag to look around";
  }

  private get module(): string | null {
    return this.getAttribute("wasm");
  }

  private load(): Promise<void> {
    return this.loader.preview(sourceOf(this.src), this.module);
  }

  private dropContent(): void {
    this.face.fresh();
    this.face.nudge(false);
    this.stage.release();
    this.sheet.clear();
    this.around?.free();
    this.around = undefined;
    this.content?.free();
    this.content = undefined;
  }

  private show(content: Content): void {
    this.content = content;
    const { info } = content;
    this.face.setUp(info);
    this.motion.setZone(zoneSlope(info));
    this.map.show(info);
    if (this.keepsAddress) document.title = `${info.title || "Preview"} – Lumistack`;
    if (content instanceof StackContent) this.sliders.setUp(info);
    else this.state.mode = "perceived";
    this.fit(info);
    this.stateChanged();
  }

  /** Called when the simulator of the new content has started. */
  private opened(content: Content, engine: Engine): void {
    engine.onPath = ({ path, why }) => this.pathChanged(path, why);
    if (content instanceof StackContent) {
      const { version, heat, heatTop } = content.about!;
      this.face.about(version, heat, heatTop);
      this.sheet.setUp(async (layer, frame) => (await this.stage.pictures(content.mask(layer, frame)))[0]!, content.info);
    }
    content.attach(this.wish());
    this.stateChanged();
  }

  /** The poster that the page puts into the element, or else the image element for the preview's poster. */
  private get poster(): HTMLImageElement {
    return this.querySelector<HTMLImageElement>('img[slot="poster"]') ?? (this.face.at("poster") as HTMLImageElement);
  }

  private showPoster(address: string): void {
    const { poster } = this;
    if (poster.src === address) return;
    // The page's poster belongs to an earlier preview, so replace it by the poster of the new
    // preview.
    if (poster.slot) poster.remove();
    const ours = this.face.at("poster") as HTMLImageElement;
    ours.src = address;
    this.watchPoster();
  }

  private watchPoster(): void {
    const { poster } = this;
    if (!poster.src) return;
    poster.hidden = false;
    const there = (): void => {
      performance.mark("lumistack-poster");
      this.layOut();
    };
    poster.decode().then(there, () => (poster.hidden = true));
  }

  private get hasPoster(): boolean {
    const { poster } = this;
    return !poster.hidden && poster.complete && poster.naturalWidth > 0;
  }

  private lookInto(views: Surroundings): void {
    this.around = views;
    performance.mark("lumistack-interactive");
    this.ticker.redraw();
  }

  /** Limits the state to the display's layers and frames. */
  private fit(info: Info): void {
    const { state } = this;
    state.frame = Math.min(state.frame, info.frames - 1);
    state.layer = Math.min(state.layer, lastMask(info));
    const targets = info.files.some(({ kind }) => kind === "target");
    for (const [mode, possible] of [
      ["compare", targets],
      ["slow", info.frames > 1],
    ] as const) {
      this.face.allow(mode, possible);
      if (!possible && state.mode === mode) state.mode = "perceived";
    }
  }

  private arrived(content: StackContent, file: FileInfo): void {
    // If the file completes its frame, update all parts: the frame may be the selected one.
    if (content.arrived(file)) this.stateChanged();
    this.ticker.redraw();
  }

  private finish(content: StackContent, failed: readonly Problem[]): void {
    const { info } = content;
    const ready = content.frames.length;
    content.whole = true;
    this.progress(1);
    this.stateChanged();
    const first = failed[0];
    if (first) {
      const rest = failed.length > 1 ? ` (and ${failed.length - 1} more)` : "";
      const mean = ready > 0 && ready < info.frames ? ` ${ready} of ${info.frames} frames are complete; the picture is their mean.` : "";
      this.report(new Problem(`${first.message}${rest}${mean}`, first.advice, ready === 0));
    }
    if (ready > 0) this.loader.everything.resolve();
    this.ticker.redraw();
  }

  private progress(share: number): void {
    const { content } = this;
    // While a poster is shown, the progress bar has no text.
    let text = content?.whole || this.hasPoster ? "" : "Loading…";
    if (text && content instanceof StackContent) {
      const { frames } = content.info;
      if (content.frames.length < frames) text = `Frame ${content.frames.length + 1} of ${frames}`;
    }
    this.face.progress(share, text);
  }

  private report(problem: Problem): void {
    const { message, advice, fatal } = problem;
    this.face.progress(1, "");
    if (fatal || !this.content) {
      this.face.refuse(problem);
      this.loader.firstPicture.reject(problem);
      this.loader.everything.reject(problem);
    } else this.face.notice(`${message} ${advice}`, "warn");
    const detail: LumistackErrorDetail = { message, advice, fatal };
    this.dispatchEvent(new CustomEvent("lumistack-error", { detail, bubbles: true, composed: true }));
  }

  private pathChanged(path: Path, why: string | undefined): void {
    this.stage.path = path;
    this.face.path(path);
    if (why) this.face.notice(why, "warn");
    else this.face.silence();
    this.ticker.redraw();
  }

  private seen(visible: boolean): void {
    this.ticker.show(visible);
    clearTimeout(this.resting);
    if (!visible) {
      this.resting = setTimeout(() => {
        this.resting = undefined;
        this.content?.attach("rest");
      }, REST_MS);
    } else if (this.resting === undefined) this.content?.attach(this.wish());
    else this.resting = undefined;
  }

  // --- state

  private get keepsAddress(): boolean {
    return this.hasAttribute("url-state");
  }

  private wish(): Wish {
    const asked = this.keepsAddress && new URLSearchParams(location.search).get("renderer");
    const wish = asked || this.getAttribute("renderer");
    return wish === "cpu" || wish === "webgl2" ? wish : "auto";
  }

  private readAddress(): void {
    if (location.hash.length < 2) return;
    const { state, slope } = fromHash(location.hash);
    if (this.motion.calm || slope) state.swing = false;
    this.state = state;
    if (slope) this.motion.standAt(slope);
    if (this.content) this.fit(this.content.info);
    this.sliders.show();
    this.stateChanged();
  }

  private set(change: Partial<State>): void {
    Object.assign(this.state, change);
    this.stateChanged();
  }

  /** Updates all parts for the state and requests a picture. */
  private stateChanged(): void {
    const { state, content } = this;
    const info = content?.info;
    this.motion.swing = state.swing && state.mode !== "layers" && (content?.whole ?? false);
    this.face.showState(state, info);
    if (content) {
      content.apply(state);
      if (state.mode === "layers" && content.frames.length > 0) this.sheet.show(state.layer, readyFrame(content.frames, state.frame), content.frames);
    }
    this.psnrKey = "";
    this.layOut();
    if (this.keepsAddress && content instanceof StackContent) this.writeAddress();
  }

  private writeAddress(): void {
    if (!this.keepsAddress || !(this.content instanceof StackContent)) return;
    this.address.write(
      () => this.state,
      () => this.slope,
    );
  }

  // --- drawing

  private layOut(): void {
    const { content, state } = this;
    const { poster } = this;
    if (this.stageBox.clientWidth === 0 || !(content || this.hasPoster)) return;
    const room: [number, number] = [this.stageBox.clientWidth, this.stageBox.clientHeight];
    const shape = content?.info ?? { field: { cols: poster.naturalWidth, rows: poster.naturalHeight } };
    const { box, one, tall, aspect } = layOut(shape, state, room, this.clientWidth <= NARROW_PX);
    // On a narrow page the box around the picture is only as high as the picture.
    this.stageBox.style.setProperty("--aspect", String(aspect));
    this.picture.classList.toggle("tall", tall);
    [this.picture.style.width, this.picture.style.height] = [`${box[0]}px`, `${box[1]}px`];
    this.stage.resize(...one);
    this.ticker.redraw();
  }

  /** Returns the picture to show; undefined while no frame is complete. */
  private shot(): Shot | undefined {
    const { content } = this;
    return content && content.frames.length > 0 ? content.shot(this.state, this.motion.slope) : undefined;
  }

  /**
   * Returns an object that computes seen pictures for other displays (headset, lenticular panel);
   * undefined while no frame is complete.
   */
  private views(): Views | undefined {
    const info = this.content?.info;
    if (!info || this.content?.frames.length === 0) return undefined;
    return {
      info,
      picture: async (slope, eyeMm) => {
        const seen: State = { ...this.state, mode: "perceived", eyeMm: eyeMm ?? this.state.eyeMm };
        const { content } = this;
        // The page that solves (`solve.html`) may have replaced the patterns. The new patterns can
        // be used if they have the same size.
        const same = content?.info.field.cols === info.field.cols && content.info.field.rows === info.field.rows;
        // The simulator executes these two calls in this order, and no other call between them.
        content?.apply(seen);
        const [picture] = same ? await this.stage.pictures(content.shot(seen, slope)) : [];
        if (!picture) throw new Error("the viewer shows other content now");
        return picture;
      },
      done: () => this.content?.apply(this.state),
    };
  }

  /**
   * True while the poster or small views replace the picture. The mean of only a few frames is
   * noisy, so the picture appears when all frames are complete.
   */
  private get isEarly(): boolean {
    const { content, state } = this;
    return state.mode === "perceived" && !content?.whole && (this.hasPoster || this.around !== undefined);
  }

  private draw(): void {
    const { isEarly } = this;
    if (isEarly) {
      this.face.early(true);
      // The poster is sharper than the small views. So the small views are drawn only after the
      // user has moved the view.
      if (this.around && !this.motion.fresh) this.around.draw(this.face.at("early") as HTMLCanvasElement, this.motion.slope);
    } else {
      const shot = this.shot();
      if (shot) this.stage.draw(shot);
    }
    this.map.mark(this.motion.slope);
    this.face.nudge(this.motion.fresh && this.state.mode === "perceived" && (!isEarly || this.around !== undefined));
    this.writeAddress();
    this.wordsTimer ??= setTimeout(() => {
      this.wordsTimer = undefined;
      this.describe();
    }, WORDS_MS);
  }

  /** Called when a picture is on the canvas. */
  private drawn(): void {
    this.controls.drawn();
    this.face.early(this.isEarly);
    if (!this.content?.whole && this.hasPoster) return;
    if (this.loader.firstPicture.settled) return;
    this.loader.firstPicture.resolve();
    performance.mark("lumistack-first-picture");
    this.dispatchEvent(new CustomEvent("lumistack-ready"));
  }

  private drawingFailed(error: unknown): void {
    this.report(new Problem(problemOf(error, "").message, "Load this page again; if the problem remains, add ?renderer=cpu to the page's address."));
  }

  private describe(): void {
    const { content, state, motion } = this;
    if (!content) return;
    this.face.describe(content.info, state, motion.slope, !motion.active);
    if (state.mode !== "compare" || !(content instanceof StackContent)) return;
    const { slope } = motion;
    const key = `${nearestView(content.info, slope).join()},${content.targetsReady}`;
    if (key === this.psnrKey) return;
    this.psnrKey = key;
    clearTimeout(this.psnrTimer);
    this.psnrTimer = setTimeout(async () => {
      const words = await content.psnr(slope);
      if (content === this.content && key === this.psnrKey) this.face.at("psnr").textContent = words;
    }, PSNR_MS);
  }

  private playFrames(dtS: number): { on: boolean; changed: boolean } {
    const { state } = this;
    const on = state.mode === "slow" && state.playing && (this.content?.frames.length ?? 0) > 1;
    this.frameClockS = on ? this.frameClockS + dtS : 0;
    const changed = this.frameClockS * state.rate >= 1;
    if (changed) {
      this.frameClockS = 0;
      this.stepFrame(1);
    }
    return { on, changed };
  }

  private stepFrame(by: number): void {
    const { content, state } = this;
    if (!content || content.frames.length === 0) return;
    const { frames } = content;
    const at = frames.indexOf(readyFrame(frames, state.frame)) + by;
    state.frame = frames[(at + frames.length) % frames.length]!;
    this.face.showFrame(state, content.info);
    content.apply(state);
  }

  // --- input

  private look(slope: Slope): void {
    this.motion.lookTo(slope);
    this.ticker.wake();
  }
}
