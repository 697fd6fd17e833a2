// Fetches the files of a preview in their order, several at a time, and passes them to the
// simulator.
import type { Engine } from "./engine.js";
import type { FileInfo } from "./info.js";
import { problemOf, REWRITE, type Problem } from "./problem.js";
import type { Source } from "./source.js";

/** Number of requests at the same time; browsers open at most six connections to a host. */
const PARALLEL = 6;

export interface Sink {
  /** Fraction of all bytes that has arrived, 0..1. */
  progress(share: number): void;
  /** Called when the simulator has decoded a file. */
  part(file: FileInfo): void;
  problem(problem: Problem, file: FileInfo): void;
}

/** Loads all files into the simulator; resolves when every file has arrived or failed. */
export async function stream(source: Source, engine: Engine, files: readonly FileInfo[], sink: Sink, signal: AbortSignal): Promise<void> {
  const weight = (file: FileInfo): number => file.bytes ?? 1;
  const total = files.reduce((sum, file) => sum + weight(file), 0);
  let loaded = 0;
  let next = 0;

  const worker = async (): Promise<void> => {
    for (let i = next++; i < files.length && !signal.aborted; i = next++) {
      const file = files[i]!;
      try {
        const { buffer } = await source.bytes(file.path, signal);
        if (signal.aborted) return;
        await put(engine, i, buffer);
        if (signal.aborted) return;
        sink.part(file);
      } catch (error) {
        if (signal.aborted) return;
        sink.problem(problemOf(error, REWRITE), file);
      }
      loaded += weight(file);
      sink.progress(total > 0 ? loaded / total : 1);
    }
  };
  await Promise.all(Array.from({ length: PARALLEL }, worker));
}

async function put(engine: Engine, index: number, bytes: ArrayBuffer): Promise<void> {
  try {
    await engine.call("put", [index, bytes], [bytes]);
  } catch (error) {
    throw problemOf(error, "The file is damaged: copy it again, or write the preview again with “lumistack preview”.");
  }
}
