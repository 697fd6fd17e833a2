// Fetches the files of a preview in their order, several at a time, and hands them to the simulator.
import { Problem, problemOf, REWRITE } from "./problem.js";
import type { FileInfo, Viewer } from "./simulator.js";
import type { Source } from "./source.js";

/** Requests in flight; browsers open six connections to a host. */
const PARALLEL = 6;
/** Milliseconds of decoding after which the page gets to draw. */
const SLICE_MS = 12;

export interface Sink {
  /** Share of all bytes that has arrived, 0..1. */
  progress(share: number): void;
  /** A file has become part of the picture. */
  part(file: FileInfo): void;
  problem(problem: Problem, file: FileInfo): void;
}

/** Resolves when every file has arrived or failed. */
export async function stream(source: Source, viewer: Viewer, files: readonly FileInfo[], sink: Sink, signal: AbortSignal): Promise<void> {
  const weight = (file: FileInfo): number => file.bytes ?? 1;
  const total = files.reduce((sum, file) => sum + weight(file), 0);
  let loaded = 0;
  let next = 0;
  let since = performance.now();

  const worker = async (): Promise<void> => {
    for (let i = next++; i < files.length && !signal.aborted; i = next++) {
      const file = files[i]!;
      try {
        const bytes = await source.bytes(file.path, signal);
        if (signal.aborted) return;
        if (performance.now() - since > SLICE_MS) {
          await new Promise((resolve) => setTimeout(resolve));
          since = performance.now();
          if (signal.aborted) return;
        }
        put(viewer, i, bytes);
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

function put(viewer: Viewer, index: number, bytes: Uint8Array): void {
  try {
    viewer.put(index, bytes);
  } catch (error) {
    throw problemOf(error, "The file is damaged: copy it again, or write the preview again with “lumistack preview”.");
  }
}
