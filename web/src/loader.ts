// From a source to what is on show: one load at a time, and the newest wins.
import { FieldContent, StackContent, type Content } from "./content.js";
import { deferred } from "./deferred.js";
import type { Dropped } from "./drop.js";
import { loadForeign } from "./lightfield.js";
import { problemOf, REWRITE, type Problem } from "./problem.js";
import { startModule, type FileInfo } from "./simulator.js";
import type { Source } from "./source.js";
import type { Stage } from "./stage.js";
import { stream } from "./stream.js";

export interface LoaderEvents {
  /** What is on show goes, another is about to come. */
  clear(): void;
  shown(content: Content): void;
  /** Share of all bytes that has arrived, 0..1. */
  progress(share: number): void;
  part(content: StackContent, file: FileInfo): void;
  /** Everything has arrived or failed. */
  finished(content: StackContent, failed: readonly Problem[]): void;
  problem(problem: Problem): void;
}

export class Loader {
  private loading: AbortController | undefined;
  private decoding: AbortController | undefined;
  /** Settled with the first picture, and with the last file. */
  firstPicture = deferred();
  everything = deferred();

  constructor(
    private readonly stage: Stage,
    private readonly events: LoaderEvents,
  ) {}

  /** `module` names the WebAssembly file where it does not lie beside the script. */
  async preview(source: Source, module: string | null): Promise<void> {
    const { events } = this;
    const { signal } = this.begin();
    events.clear();
    events.progress(0);
    try {
      const [json] = await Promise.all([source.json(), startModule(module)]);
      if (signal.aborted) return;
      const content = new StackContent(json, this.stage);
      events.shown(content);
      const failed: Problem[] = [];
      const sink = {
        progress: (share: number) => events.progress(share),
        part: (file: FileInfo) => events.part(content, file),
        problem: (problem: Problem) => void failed.push(problem),
      };
      await stream(source, content.viewer, content.info.files, sink, signal);
      if (!signal.aborted) events.finished(content, failed);
    } catch (error) {
      if (!signal.aborted) events.problem(problemOf(error, REWRITE));
    }
  }

  /** What is on show stays until the pictures of the other are decoded. */
  async field(dropped: Extract<Dropped, { kind: "quilt" | "views" }>, module: string | null): Promise<void> {
    const { events } = this;
    this.decoding?.abort();
    const { signal } = (this.decoding = new AbortController());
    await startModule(module);
    const foreign = await loadForeign(dropped, (share) => events.progress(share), signal);
    if (signal.aborted) return foreign.field.free();
    this.begin();
    events.clear();
    events.shown(new FieldContent(foreign, this.stage));
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
}
