// The thread that solves. It works in short turns. Between two turns it handles messages, so that
// the page can stop it at any time.
import * as decoders from "../../pkg/lumistack_web_decoders.js";
import * as pictures from "../../pkg/lumistack_web_pictures.js";
// For solve-gpu.js, build.mjs replaces this module by the module with WebGPU.
import { Dropped, initSync, presets, Solver } from "../../pkg/lumistack_web_solver.js";
import type { Solver as DeviceSolver } from "../../pkg/lumistack_web_solver_gpu.js";
import { Pool, type PoolMessage, type PoolRequest } from "./pool.js";

/** Messages from the page to the thread. */
export type SolverRequest =
  | { kind: "start"; module: WebAssembly.Module; folder: string; software: boolean; threads: number | undefined }
  | { kind: "solve"; files: [path: string, content: Blob][]; path: string; title: string; isField: boolean; settings: string }
  | { kind: "change"; settings: string }
  | { kind: "pause" | "resume" }
  | { kind: "zip" };

/** Progress of the work. */
export interface State {
  stage: "scene" | "views" | "patterns" | "done";
  share: number;
  psnr: number;
  warnings: string[];
  /** True if a graphics processor solves. */
  onDevice: boolean;
  /** Number of threads that render views. */
  threads: number;
}

/** Messages from the thread to the page. */
export type SolverMessage =
  | { kind: "presets"; json: string }
  | { kind: "state"; state: State }
  | { kind: "stack"; json: string; codes: Uint8Array<ArrayBuffer> }
  | { kind: "zip"; title: string; bytes: Uint8Array<ArrayBuffer> }
  | { kind: "error"; message: string };

/** Address of the folder of the WebAssembly modules. */
let folder = "";

/**
 * Returns a function that loads a module of decoders at its first call. The request is synchronous,
 * since the solver's module waits for the answer of its call.
 */
function loaded<T extends { initSync(from: { module: WebAssembly.Module }): unknown }>(glue: T, name: string): () => T {
  let isReady = false;
  return () => {
    if (isReady) return glue;
    const request = new XMLHttpRequest();
    request.open("GET", new URL(name, folder), false);
    request.responseType = "arraybuffer";
    request.send();
    if (request.status !== 200) throw new Error(`the server answers ${request.status}`);
    glue.initSync({ module: new WebAssembly.Module(request.response) });
    isReady = true;
    return glue;
  };
}

/** Functions that load the small module, with the decoders of common pictures, and the large module, which few scenes need. */
const common = loaded(pictures, "lumistack_web_pictures_bg.wasm");
const ready = loaded(decoders, "lumistack_web_decoders_bg.wasm");

/**
 * Returns true if an error means that a module stopped. Every module stops if its memory is
 * exhausted. The modules of decoders also stop on some damaged content.
 */
function stopped(error: unknown): boolean {
  return error instanceof WebAssembly.RuntimeError || error instanceof RangeError;
}

// The solver's module calls these functions.
Object.assign(globalThis, {
  lumistack_decoders: {
    answer(request: Uint8Array, isCommon: boolean): Uint8Array | undefined {
      const { answer } = isCommon ? common() : ready();
      try {
        return answer(request);
      } catch (error) {
        if (stopped(error)) return undefined;
        throw error;
      }
    },
    field(path: string, ...wanted: [widthMm: number, fovX: number, fovY: number, cols: number]): decoders.Field {
      const { field } = ready();
      try {
        return field(path, ...wanted);
      } catch (error) {
        if (!stopped(error)) throw error;
        throw new Error(`${path}: content: expected a valid light field, found bytes at which the reader fails`);
      }
    },
    pack: (display: string, names: string[], contents: Uint8Array[]): Uint8Array => ready().pack(display, names, contents),
  },
});

/** Duration of a turn after which it begins no further piece, and shortest time between two reports of progress, ms. */
const TURN_MS = 25;
const REPORT_MS = 100;
/** Size of a page of a module's memory, bytes. */
const PAGE = 65536;

/** The solver's module; its instance's memory, and its table of JavaScript objects. */
let module: WebAssembly.Module;
let memory: WebAssembly.Memory;
let objects: WebAssembly.Table;
let solver: Solver | DeviceSolver | undefined;
/** Further threads, while views are rendered. */
let pool: Pool | undefined;
/** Number of threads that may render views; undefined for the number of cores, at most five. */
let threads: number | undefined;
/** True if a graphics adapter in software may solve. */
let software = false;
let title = "";
let running = false;
let paused = false;
/** Number of the newest request to solve, and the settings of the newest request. */
let newest = 0;
let settings = "";
let shown = 0;
let reported = 0;
let warnings: string[] = [];

// A turn ends with a message that starts the next turn. Timers would be slower: after five timers
// in a row, browsers delay each further timer by four milliseconds.
const turns = new MessageChannel();
turns.port1.onmessage = () => enqueue(turn);

/**
 * The promise of the newest turn or message. Each turn or message waits for the previous one, since
 * a solver accepts no call while it waits for a graphics processor.
 */
let last = Promise.resolve();
let waiting = 0;

function enqueue(work: () => void | Promise<void>): void {
  waiting += 1;
  last = last.then(() => {
    waiting -= 1;
    return guarded(work);
  });
}

async function turn(): Promise<void> {
  if (!solver || !running) return;
  const start = performance.now();
  if (solver.stage() === "views") share(solver);
  while (waiting === 0 && performance.now() - start < TURN_MS && solver.stage() !== "done" && solver.shown() === shown) await solver.advance();
  if (solver.stage() !== "views") end();
  const done = solver.stage() === "done";
  const patterns = solver.shown() !== shown;
  if (patterns) shown = solver.shown();
  if (patterns || done || performance.now() - reported > REPORT_MS) report(patterns);
  if (done) running = false;
  else turns.port2.postMessage(undefined);
}

// The types of wasm-bindgen omit two members: the address of a solver in the module's memory, and
// the function that makes an object for such an address.
const addressOf = (solver: Solver | DeviceSolver): number => (solver as unknown as { __wbg_ptr: number }).__wbg_ptr;
const { __wrap: solverAt } = Solver as unknown as { __wrap(pointer: number): Solver };

/** Lets other threads trace views. The solver itself continues to trace, from the other end of its plan. */
function share(solver: Solver | DeviceSolver): void {
  if (!pool) {
    // A copy of the memory would delay the first picture.
    if (solver.shown() === 0) return;
    const view = solver.give();
    if (view === undefined) return;
    const own: Pool = (pool = new Pool(threads, memory, { module, slots: objects.length, pointer: addressOf(solver) }, [view], ({ view, values, warnings: found }) =>
      enqueue(() => {
        if (own !== pool) return;
        solver.take(view, values);
        warnings.push(...found);
      }),
    ));
  }
  pool.feed(() => solver.give());
}

/** Ends the other threads. */
function end(): void {
  pool?.end();
  pool = undefined;
}

function report(patterns: boolean): void {
  if (!solver) return;
  reported = performance.now();
  // Send the patterns before the state: when the page reads the last state, it already has the last
  // patterns.
  if (patterns) {
    const codes = solver.codes() as Uint8Array<ArrayBuffer>;
    send({ kind: "stack", json: solver.preview(title), codes }, [codes.buffer]);
  }
  warnings.push(...solver.warnings());
  const onDevice = "on_device" in solver && solver.on_device();
  send({ kind: "state", state: { stage: solver.stage() as State["stage"], share: solver.share(), psnr: solver.psnr(), warnings, onDevice, threads: 1 + (pool?.size ?? 0) } });
  warnings = [];
}

/** Reads the files of a request, and starts to solve, unless a newer request has arrived. */
async function begin({ files, path, isField }: Extract<SolverRequest, { kind: "solve" }>): Promise<void> {
  const own = ++newest;
  const read = files.map(async ([name, content]): Promise<[string, ArrayBuffer]> => {
    try {
      return [name, await content.arrayBuffer()];
    } catch (error) {
      throw new Error(`${name}: expected a readable file, found an error: ${error instanceof Error ? error.message : error}`);
    }
  });
  const contents = await Promise.all(read).catch((error: Error) => enqueue(() => {
    if (own === newest) throw error;
  }));
  if (!contents) return;
  enqueue(async () => {
    if (own !== newest) return;
    if (isField) {
      ready().hold(contents.map(([name]) => name), contents.map(([, bytes]) => new Uint8Array(bytes)));
      solver = Solver.of_field(path, settings);
    } else {
      const dropped = new Dropped();
      for (const [name, bytes] of contents) dropped.add(name, new Uint8Array(bytes));
      solver = new Solver(dropped, path, settings);
    }
    await openDevice();
    run();
  });
}

/** Opens the graphics processor for a new solve, if this is the module with WebGPU. */
async function openDevice(): Promise<void> {
  if (!solver || !("open_device" in solver)) return;
  try {
    await solver.open_device(software);
  } catch (error) {
    warnings.push(`${error instanceof Error ? error.message : error}; the processor solves instead`);
  }
}

function run(): void {
  shown = solver!.shown();
  if (running || paused) return;
  running = true;
  turns.port2.postMessage(undefined);
}

function send(what: SolverMessage | PoolMessage, handed: Transferable[] = []): void {
  postMessage(what, { transfer: handed });
}

/**
 * Runs `work` and sends its errors to the page. Errors of the module are messages for the user. If
 * the module stopped, it is unusable, and the message states the likely reason.
 */
async function guarded(work: () => void | Promise<void>): Promise<void> {
  try {
    await work();
  } catch (error) {
    running = false;
    end();
    if (stopped(error)) {
      solver = undefined;
      const why = "the solver stopped, probably because it needs more memory than a page can have";
      return send({ kind: "error", message: `${title}: ${why}. Choose less detail or fewer frames, or use “lumistack run”.` });
    }
    send({ kind: "error", message: error instanceof Error ? error.message : String(error) });
  }
}

onmessage = ({ data }: MessageEvent<SolverRequest | PoolRequest>) =>
  enqueue(() => {
    switch (data.kind) {
      case "start":
        ({ module, folder, software, threads } = data);
        ({ memory, __wbindgen_externrefs: objects } = initSync({ module }));
        return send({ kind: "presets", json: presets() });
      case "solve":
        running = paused = false;
        end();
        solver?.free();
        solver = undefined;
        ({ title, settings } = data);
        return void begin(data);
      case "change":
        // While files are read there is no solver. The solver will start with the newest settings.
        ({ settings } = data);
        paused = false;
        if (!solver) return;
        end();
        solver.change(settings);
        return run();
      case "pause":
        running = false;
        paused = true;
        return report(false);
      case "resume":
        paused = false;
        return solver ? run() : undefined;
      case "zip": {
        // The request may arrive after a new solve began, which has no patterns yet.
        if (!solver || Number.isNaN(solver.psnr())) return;
        const bytes = solver.zip() as Uint8Array<ArrayBuffer>;
        return send({ kind: "zip", title, bytes }, [bytes.buffer]);
      }
      // A pool sends these messages only to its own threads, so this thread belongs to a pool.
      case "copy": {
        const { image } = data;
        ({ memory, __wbindgen_externrefs: objects } = initSync({ module: data.module }));
        // The copied memory contains indices into the table of JavaScript objects. So this table
        // must be as long as the original table.
        objects.grow(data.slots - objects.length);
        memory.grow((image.byteLength - memory.buffer.byteLength) / PAGE);
        new Uint8Array(memory.buffer).set(new Uint8Array(image));
        solver = solverAt(data.pointer);
        return send({ kind: "copied", image }, [image]);
      }
      case "trace": {
        const { view } = data;
        const values = solver!.trace(view) as Float32Array<ArrayBuffer>;
        return send({ kind: "traced", view, values, warnings: solver!.warnings() }, [values.buffer]);
      }
    }
  });
