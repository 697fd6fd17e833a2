// Runs the simulator in a worker thread, so that it never blocks the page.
import type { PathChange } from "./painter.js";
import { Problem, problemOf } from "./problem.js";
import { fromBase64 } from "./source.js";
import type { Methods } from "./worker.js";
import WORKER from "worker:./worker.ts";

let compiling: Promise<WebAssembly.Module> | undefined;

/**
 * Compiles the WebAssembly module, at most once per page; after a failure a later call tries again.
 * The module is part of the page, or it is loaded from `url`, or from the script's folder.
 */
function compile(url: string | null): Promise<WebAssembly.Module> {
  const get = async (): Promise<WebAssembly.Module> => {
    const inline = window.LUMISTACK_INLINE?.["wasm"];
    if (inline !== undefined) return WebAssembly.compile(fromBase64(inline));
    const response = await fetch(url ?? new URL("lumistack_web_bg.wasm", import.meta.url));
    if (!response.ok) throw new Error(`the server answers ${response.status}`);
    return WebAssembly.compile(await response.arrayBuffer());
  };
  compiling ??= get();
  compiling.catch(() => (compiling = undefined));
  return compiling;
}

export class Engine {
  private readonly waiting = new Map<number, { resolve: (value: never) => void; reject: (error: Error) => void }>();
  private last = 0;
  /** Called when the painter changes between WebGL2 and the processor. */
  onPath: ((change: PathChange) => void) | undefined;

  private constructor(private readonly worker: Worker) {
    worker.onmessage = ({ data: [id, value, error] }: MessageEvent<[number, unknown, string | undefined]>) => {
      if (id === 0) return this.onPath?.(value as PathChange);
      const { resolve, reject } = this.waiting.get(id)!;
      this.waiting.delete(id);
      if (error === undefined) resolve(value as never);
      else reject(new Error(error));
    };
    worker.onerror = ({ message }) => {
      for (const { reject } of this.waiting.values()) reject(new Error(message || "a worker does not start"));
      this.waiting.clear();
    };
  }

  /** Starts the thread. `url` is the address of the module; null if the module is in the script's folder. */
  static async start(url: string | null): Promise<Engine> {
    try {
      const module = await compile(url);
      const script = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
      const engine = new Engine(new Worker(script));
      await engine.call("start", [module]).finally(() => URL.revokeObjectURL(script));
      return engine;
    } catch (error) {
      const advice = "Check that lumistack_web_bg.wasm is in the folder of viewer.js, that the server sends this file, and that the page may start workers (worker-src blob:). Then load this page again.";
      throw new Problem(
        `The simulator could not start: ${problemOf(error, "").message}`,
        typeof WebAssembly === "undefined" ? "This browser has no WebAssembly, or WebAssembly is switched off. Use another browser." : advice,
      );
    }
  }

  /**
   * Calls a method of the thread. The thread answers calls in their order. The objects in `handed`
   * are transferred to the thread, without a copy.
   */
  call<K extends keyof Methods>(name: K, args: Parameters<Methods[K]>, handed: Transferable[] = []): Promise<ReturnType<Methods[K]>> {
    return new Promise((resolve, reject) => {
      const id = ++this.last;
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage([id, name, args], handed);
    });
  }

  /** Ends the thread, which releases its memory and its graphics context. */
  stop(): void {
    this.worker.terminate();
  }
}
