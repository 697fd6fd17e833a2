// The solver's thread as the page sees it. It starts when something is to be solved, and anew after it ran out of memory.
import type { Ask, Tell } from "./worker.js";
import WORKER from "worker:./worker.ts";

let compiling: Promise<WebAssembly.Module> | undefined;

function compile(): Promise<WebAssembly.Module> {
  const get = async (): Promise<WebAssembly.Module> => {
    const response = await fetch(new URL("lumistack_web_solver_bg.wasm", import.meta.url));
    if (!response.ok) throw new Error(`the server answers ${response.status} for lumistack_web_solver_bg.wasm`);
    return WebAssembly.compile(await response.arrayBuffer());
  };
  compiling ??= get();
  compiling.catch(() => (compiling = undefined));
  return compiling;
}

export class Solver {
  private worker: Worker | undefined;
  /** Settled when the thread has told what it knows. */
  private ready: Promise<void> = Promise.resolve();

  constructor(private readonly told: (what: Tell) => void) {}

  /** Whether there is a thread: one that knows what it works on, once it was told. */
  get runs(): boolean {
    return this.worker !== undefined;
  }

  /** Starts the thread where there is none, and waits until it has told its presets. */
  async start(): Promise<void> {
    const module = await compile();
    if (this.worker) return this.ready;
    const script = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
    const worker = (this.worker = new Worker(script));
    this.ready = new Promise((resolve, reject) => {
      worker.onmessage = ({ data }: MessageEvent<Tell>) => {
        URL.revokeObjectURL(script);
        // Whatever is wrong may have left its memory full.
        if (data.kind === "error") this.end();
        this.told(data);
        if (data.kind === "presets") resolve();
      };
      worker.onerror = ({ message }) => {
        this.end();
        reject(new Error(message || "a worker does not start: the page may not start any (worker-src blob:)"));
        this.told({ kind: "error", message: message || "The solver’s thread does not start." });
      };
    });
    this.ask({ kind: "start", module });
    return this.ready;
  }

  ask(what: Ask, handed: Transferable[] = []): void {
    this.worker?.postMessage(what, handed);
  }

  private end(): void {
    this.worker?.terminate();
    this.worker = undefined;
  }
}
