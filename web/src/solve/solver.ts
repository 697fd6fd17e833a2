// The page's access to the solver's thread. The thread is started at the first use, and again after
// an error ended it.
import type { SolverRequest, SolverMessage } from "./worker.js";
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
  /** Resolves when the thread has sent its presets. */
  private ready: Promise<void> = Promise.resolve();

  constructor(private readonly receive: (what: SolverMessage) => void) {}

  /** True if the thread has been started and has not ended. */
  get runs(): boolean {
    return this.worker !== undefined;
  }

  /** Starts the thread if there is none, and waits for its presets. */
  async start(): Promise<void> {
    const module = await compile();
    if (this.worker) return this.ready;
    const script = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
    const worker = (this.worker = new Worker(script));
    this.ready = new Promise((resolve, reject) => {
      worker.onmessage = ({ data }: MessageEvent<SolverMessage>) => {
        URL.revokeObjectURL(script);
        // After an error the thread's memory may be full, so the next solve gets a new thread.
        if (data.kind === "error") this.end();
        this.receive(data);
        if (data.kind === "presets") resolve();
      };
      worker.onerror = ({ message }) => {
        this.end();
        reject(new Error(message || "a worker does not start, since the page's policy forbids workers (worker-src blob:)"));
        this.receive({ kind: "error", message: message || "The solver’s thread does not start." });
      };
    });
    this.ask({ kind: "start", module, decoders: new URL("lumistack_web_decoders_bg.wasm", import.meta.url).href });
    return this.ready;
  }

  ask(what: SolverRequest, handed: Transferable[] = []): void {
    this.worker?.postMessage(what, handed);
  }

  private end(): void {
    this.worker?.terminate();
    this.worker = undefined;
  }
}
