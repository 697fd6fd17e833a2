// Threads that trace views for the thread that solves. Each is a copy of that thread. The memory of
// the solver's module contains the placed scene, so a module with a copy of this memory can trace
// the scene's views. Threads with common memory would need less memory, but browsers allow them
// only to pages whose server sends special headers.

/** Messages to a thread of the pool. */
export type PoolRequest =
  | { kind: "copy"; module: WebAssembly.Module; image: ArrayBuffer; slots: number; pointer: number }
  | { kind: "trace"; view: number };

/** A traced view and the warnings about it. */
export interface Traced {
  view: number;
  values: Float32Array<ArrayBuffer>;
  warnings: string[];
}

/** Messages of a thread of the pool. */
export type PoolMessage = { kind: "copied"; image: ArrayBuffer } | ({ kind: "traced" } & Traced) | { kind: "error" };

/** Largest number of threads that render, unless the page's address sets it. */
const MOST_THREADS = 5;
/**
 * Largest number of views that a thread has and has not yet traced. While the solver's thread is
 * busy and reads no messages, the thread of the pool traces its second view.
 */
const VIEWS = 2;

/**
 * Returns the largest memory of all copies, bytes: a quarter of the device's memory, or 512 MiB if
 * the browser does not report it.
 */
function mostBytes(): number {
  return ((navigator as { deviceMemory?: number }).deviceMemory ?? 2) * 2 ** 28;
}

export class Pool {
  /** The threads, each with the views that it has. */
  private readonly threads = new Map<Worker, number[]>();

  /**
   * Starts threads one after another, until `wanted` threads render, the solver's thread included.
   * Fewer threads are started if memory is short. `waiting` contains the views that the solver gave
   * and that no thread has.
   */
  constructor(
    wanted: number | undefined,
    memory: WebAssembly.Memory,
    private readonly copy: Omit<Extract<PoolRequest, { kind: "copy" }>, "kind" | "image">,
    private readonly waiting: number[],
    private readonly receive: (traced: Traced) => void,
  ) {
    const threads = wanted ?? Math.min(navigator.hardwareConcurrency, MOST_THREADS);
    const count = Math.min(threads - 1, Math.floor(mostBytes() / memory.buffer.byteLength));
    if (!(count >= 1)) return;
    try {
      this.start(memory.buffer.slice(0) as ArrayBuffer, count);
    } catch {
      // There is no memory for a copy. The solver then works alone.
    }
  }

  /** Number of threads. */
  get size(): number {
    return this.threads.size;
  }

  /** Starts a thread with a copy of the memory `image`. The thread returns `image`, for the next of `count` threads. */
  private start(image: ArrayBuffer, count: number): void {
    const thread = new Worker(location.href);
    const views: number[] = [];
    this.threads.set(thread, views);
    thread.onmessage = ({ data }: MessageEvent<PoolMessage>) => {
      if (!this.threads.has(thread)) return;
      if (data.kind === "error") return this.drop(thread);
      if (data.kind === "copied") return count > 1 ? this.start(data.image, count - 1) : undefined;
      views.splice(views.indexOf(data.view), 1);
      this.receive(data);
    };
    thread.onerror = (event) => {
      event.preventDefault();
      this.drop(thread);
    };
    this.ask(thread, { kind: "copy", ...this.copy, image }, [image]);
  }

  /** Gives views to the threads, until each has enough. `give` returns undefined if no view is left. */
  feed(give: () => number | undefined): void {
    for (let count = 1; count <= VIEWS; count++) {
      for (const [thread, views] of this.threads) {
        if (views.length >= count) continue;
        const view = this.waiting.pop() ?? give();
        if (view === undefined) return;
        views.push(view);
        this.ask(thread, { kind: "trace", view });
      }
    }
  }

  /** Ends all threads, which frees their memory. */
  end(): void {
    for (const thread of this.threads.keys()) this.drop(thread);
  }

  /** Ends a thread. Other threads, or the solver, trace its views. */
  private drop(thread: Worker): void {
    thread.terminate();
    this.waiting.push(...(this.threads.get(thread) ?? []));
    this.threads.delete(thread);
  }

  private ask(thread: Worker, what: PoolRequest, handed: Transferable[] = []): void {
    thread.postMessage(what, handed);
  }
}
