// Loads content from a source. There is one load at a time; a new load ends the previous load.
import { Surroundings } from "./around.js";
import { FieldContent, openPreview, StackContent, type Content } from "./content.js";
import { deferred } from "./deferred.js";
import type { Dropped } from "./drop.js";
import { Engine } from "./engine.js";
import type { FileInfo } from "./info.js";
import { loadForeign } from "./lightfield.js";
import { problemOf, REWRITE, type Problem } from "./problem.js";
import type { Source } from "./source.js";
import type { Stage } from "./stage.js";
import { stream } from "./stream.js";

export interface LoaderEvents {
  /** Called before new content is shown, so that the current content is removed. */
  clear(): void;
  /** Called with the new content. If it is a stack of patterns, its simulator and files are not yet loaded. */
  shown(content: Content): void;
  /** Called with the address of the poster, which is shown until the patterns have arrived. */
  poster(address: string): void;
  /** Called with the small views, in which the user can look around until the patterns have arrived. */
  around(views: Surroundings): void;
  /** Called when the simulator has started. */
  opened(content: Content, engine: Engine): void;
  /** Called with the fraction of all bytes that has arrived, 0..1. */
  progress(share: number): void;
  part(content: StackContent, file: FileInfo): void;
  /** Called when every file has arrived or failed. `failed` has the errors of the failed files. */
  finished(content: StackContent, failed: readonly Problem[]): void;
  problem(problem: Problem): void;
}

export class Loader {
  private loading: AbortController | undefined;
  private decoding: AbortController | undefined;
  /** `firstPicture` resolves when the first picture is shown, `everything` when every file has arrived or failed. */
  firstPicture = deferred();
  everything = deferred();

  constructor(
    private readonly stage: Stage,
    private readonly events: LoaderEvents,
  ) {}

  /**
   * Loads a preview. `module` is the URL of the WebAssembly file; null if the file is beside the
   * script.
   */
  async preview(source: Source, module: string | null): Promise<void> {
    const { events } = this;
    const { signal } = this.begin();
    events.clear();
    events.progress(0);
    // Start the module now, so that it loads at the same time as preview.json.
    const starting = Engine.start(module);
    const stop = (): void => void starting.then((engine) => engine.stop()).catch(() => undefined);
    starting.catch(() => undefined);
    try {
      const json = await source.json();
      if (signal.aborted) return stop();
      const content = read(json);
      if (!content) {
        // The text is no preview. The simulator checks it again, and throws an error that states
        // the reason.
        const engine = await starting;
        await openPreview(engine, json).finally(() => engine.stop());
        throw new Error("preview.json: expected a preview, found other content");
      }
      events.shown(content);
      const early = this.early(source, content, signal);
      const engine = await starting;
      if (signal.aborted) return stop();
      await content.open(engine, this.stage);
      // Wait for the poster and the small views, so that they load before the large patterns.
      await early;
      if (signal.aborted) return stop();
      events.opened(content, engine);
      const failed: Problem[] = [];
      const sink = {
        progress: (share: number) => events.progress(share),
        part: (file: FileInfo) => events.part(content, file),
        problem: (problem: Problem) => void failed.push(problem),
      };
      await stream(source, engine, content.info.files, sink, signal);
      if (!signal.aborted) events.finished(content, failed);
    } catch (error) {
      if (signal.aborted) return stop();
      stop();
      events.problem(problemOf(error, REWRITE));
    }
  }

  /**
   * Shows a stack of patterns whose pictures are all in `codes`. The current content is removed
   * only after the simulator has started.
   */
  async stack(json: string, codes: Uint8Array<ArrayBuffer>, module: string | null): Promise<void> {
    const { events } = this;
    const { signal } = this.begin();
    const engine = await Engine.start(module);
    if (signal.aborted) return engine.stop();
    const content = new StackContent(json);
    events.clear();
    events.shown(content);
    await content.open(engine, this.stage);
    await content.exchange(codes);
    if (signal.aborted) return engine.stop();
    events.opened(content, engine);
    events.finished(content, []);
  }

  /** Shows a light field. The current content stays until the new pictures are decoded. */
  async field(dropped: Extract<Dropped, { kind: "quilt" | "views" }>, module: string | null): Promise<void> {
    const { events } = this;
    this.decoding?.abort();
    const { signal } = (this.decoding = new AbortController());
    const engine = await Engine.start(module);
    const info = await loadForeign(dropped, engine, (share) => events.progress(share), signal).catch((error: unknown) => {
      engine.stop();
      throw error;
    });
    if (signal.aborted) return engine.stop();
    this.begin();
    events.clear();
    const content = new FieldContent(info, engine, this.stage);
    events.shown(content);
    events.opened(content, engine);
    events.progress(1);
    this.firstPicture.resolve();
    this.everything.resolve();
  }

  stop(): void {
    this.loading?.abort();
    this.decoding?.abort();
  }

  private begin(): AbortController {
    this.loading?.abort();
    this.loading = new AbortController();
    this.firstPicture = deferred();
    this.everything = deferred();
    return this.loading;
  }

  /**
   * Loads the poster and the small views, which are shown until the patterns have arrived. A
   * failure is ignored.
   */
  private async early(source: Source, { info }: StackContent, signal: AbortSignal): Promise<void> {
    const { events } = this;
    const bytes = (path: string): Promise<Uint8Array<ArrayBuffer>> => source.bytes(path, signal);
    const poster = async (path: string): Promise<void> => {
      const address = await source.address(path);
      if (!signal.aborted) events.poster(address);
    };
    const around = async (wanted: NonNullable<typeof info.around>): Promise<void> => {
      const views = await Surroundings.of(wanted, await bytes(wanted.path));
      if (signal.aborted) views.free();
      else events.around(views);
    };
    await Promise.allSettled([info.poster && poster(info.poster), info.around && around(info.around)]);
  }
}

/** Reads a preview; returns undefined if the text is no preview. */
function read(json: string): StackContent | undefined {
  try {
    return new StackContent(json);
  } catch {
    return undefined;
  }
}
