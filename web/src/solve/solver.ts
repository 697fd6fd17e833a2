// The page's access to the solver's thread. The thread is started at the first use, and again after
// an error ended it.
import type { SolverRequest, SolverMessage } from "./worker.js";
import WORKER from "worker:./worker.ts";

/** The thread's program: a script and a WebAssembly module. */
interface Program {
  module: WebAssembly.Module;
  script: string;
  /** The reason why this is the program without WebGPU; undefined for the program with WebGPU. */
  obstacle: string | undefined;
}

const ASKED = new URLSearchParams(location.hash.slice(1));
/** `device` in the page's address: `cpu`, or `gpu`, which also accepts an adapter in software. */
const DEVICE = ASKED.get("device");
/** `threads` in the page's address: number of threads that render views. */
const THREADS = ASKED.has("threads") ? Number(ASKED.get("threads")) : undefined;
/** The part of WebGPU that the page uses. TypeScript's own types do not yet contain WebGPU. */
type Gpu = { requestAdapter(): Promise<{ info: { isFallbackAdapter: boolean } } | null> };

/** Returns the reason why no graphics processor can solve; undefined if a graphics processor can solve. */
async function obstacleOf(): Promise<string | undefined> {
  if (DEVICE === "cpu") return "the address of this page chooses the processor";
  const { gpu } = navigator as { gpu?: Gpu };
  if (!gpu) return "this browser has no WebGPU";
  // The browser must be able to suspend the module while it waits for the graphics processor.
  if (!("Suspending" in WebAssembly && "JSTag" in WebAssembly)) return "this browser cannot suspend WebAssembly";
  const adapter = await gpu.requestAdapter().catch(() => null);
  if (!adapter) return "this browser offers no graphics processor";
  return adapter.info.isFallbackAdapter && DEVICE !== "gpu" ? "this browser offers only a graphics processor in software" : undefined;
}

async function fetched(name: string): Promise<Response> {
  const response = await fetch(new URL(name, import.meta.url));
  if (!response.ok) throw new Error(`the server answers ${response.status} for ${name}`);
  return response;
}

async function compiled(name: string): Promise<WebAssembly.Module> {
  return WebAssembly.compile(await (await fetched(name)).arrayBuffer());
}

async function load(): Promise<Program> {
  let obstacle = await obstacleOf();
  if (obstacle === undefined) {
    try {
      const [module, script] = await Promise.all([compiled("lumistack_web_solver_gpu_bg.wasm"), fetched("solve-gpu.js").then((response) => response.text())]);
      return { module, script, obstacle };
    } catch (error) {
      obstacle = error instanceof Error ? error.message : String(error);
    }
  }
  return { module: await compiled("lumistack_web_solver_bg.wasm"), script: WORKER, obstacle };
}

let loading: Promise<Program> | undefined;

function program(): Promise<Program> {
  loading ??= load();
  loading.catch(() => (loading = undefined));
  return loading;
}

export class Solver {
  private worker: Worker | undefined;
  /** Address of the thread's script. The thread starts further threads from it. */
  private script = "";
  /** Resolves when the thread has sent its presets. */
  private ready: Promise<void> = Promise.resolve();
  /**
   * The reason why the thread runs the program without WebGPU; undefined with WebGPU, or before the
   * start.
   */
  obstacle: string | undefined;

  constructor(private readonly receive: (what: SolverMessage) => void) {}

  /** True while the thread runs. */
  get runs(): boolean {
    return this.worker !== undefined;
  }

  /** Starts the thread if there is none, and waits for its presets. */
  async start(): Promise<void> {
    const { module, script: text, obstacle } = await program();
    if (this.worker) return this.ready;
    this.obstacle = obstacle;
    this.script = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    const worker = (this.worker = new Worker(this.script));
    this.ready = new Promise((resolve, reject) => {
      worker.onmessage = ({ data }: MessageEvent<SolverMessage>) => {
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
    this.ask({ kind: "start", module, folder: new URL(".", import.meta.url).href, software: DEVICE === "gpu", threads: THREADS });
    return this.ready;
  }

  ask(what: SolverRequest, handed: Transferable[] = []): void {
    this.worker?.postMessage(what, handed);
  }

  private end(): void {
    this.worker?.terminate();
    URL.revokeObjectURL(this.script);
    this.worker = undefined;
  }
}
