// The thread that solves. It works for short turns and handles messages in between, so that it can
// be stopped at any time.
import { Dropped, initSync, presets, Solver } from "../../pkg/lumistack_web_solver.js";

/** Requests of the page. */
export type SolverRequest =
  | { kind: "start"; module: WebAssembly.Module }
  | { kind: "solve"; files: [path: string, bytes: ArrayBuffer][]; path: string; title: string; settings: string }
  | { kind: "change"; settings: string }
  | { kind: "pause" | "resume" }
  | { kind: "zip" };

/** Progress of the work. */
export interface State {
  stage: "scene" | "views" | "patterns" | "done";
  share: number;
  psnr: number;
  warnings: string[];
}

/** Messages to the page. */
export type SolverMessage =
  | { kind: "presets"; json: string }
  | { kind: "state"; state: State }
  | { kind: "stack"; json: string; codes: Uint8Array<ArrayBuffer> }
  | { kind: "zip"; bytes: Uint8Array<ArrayBuffer> }
  | { kind: "error"; message: string };

/** Milliseconds of a turn, and between two reports of progress. */
const TURN_MS = 25;
const REPORT_MS = 100;

let solver: Solver | undefined;
let title = "";
let running = false;
let shown = 0;
let reported = 0;
let warnings: string[] = [];

// Timers wait four milliseconds after the fifth in a row; messages do not.
const turns = new MessageChannel();
turns.port1.onmessage = () => guarded(turn);

function turn(): void {
  if (!solver || !running) return;
  const start = performance.now();
  while (performance.now() - start < TURN_MS && solver.stage() !== "done" && solver.shown() === shown) solver.advance();
  const done = solver.stage() === "done";
  const patterns = solver.shown() !== shown;
  if (patterns) shown = solver.shown();
  if (patterns || done || performance.now() - reported > REPORT_MS) report(patterns);
  if (done) running = false;
  else turns.port2.postMessage(undefined);
}

function report(patterns: boolean): void {
  if (!solver) return;
  reported = performance.now();
  warnings.push(...solver.warnings());
  send({ kind: "state", state: { stage: solver.stage() as State["stage"], share: solver.share(), psnr: solver.psnr(), warnings } });
  warnings = [];
  if (!patterns) return;
  const codes = solver.codes() as Uint8Array<ArrayBuffer>;
  send({ kind: "stack", json: solver.preview(title), codes }, [codes.buffer]);
}

function run(): void {
  shown = solver!.shown();
  if (running) return;
  running = true;
  turns.port2.postMessage(undefined);
}

function send(what: SolverMessage, handed: Transferable[] = []): void {
  postMessage(what, { transfer: handed });
}

/** Errors of the module are sentences; a trap leaves it unusable. */
function guarded(work: () => void): void {
  try {
    work();
  } catch (error) {
    running = false;
    if (error instanceof WebAssembly.RuntimeError || error instanceof RangeError) {
      solver = undefined;
      const why = "the solver stopped: most likely this takes more memory than a page can have";
      return send({ kind: "error", message: `${title}: ${why}. Take less detail or fewer frames, or solve it with “lumistack run”.` });
    }
    send({ kind: "error", message: error instanceof Error ? error.message : String(error) });
  }
}

onmessage = ({ data }: MessageEvent<SolverRequest>) =>
  guarded(() => {
    switch (data.kind) {
      case "start":
        initSync({ module: data.module });
        return send({ kind: "presets", json: presets() });
      case "solve": {
        running = false;
        solver?.free();
        solver = undefined;
        title = data.title;
        const files = new Dropped();
        for (const [path, bytes] of data.files) files.add(path, new Uint8Array(bytes));
        solver = new Solver(files, data.path, data.settings);
        return run();
      }
      case "change":
        if (!solver) return;
        solver.change(data.settings);
        return run();
      case "pause":
        running = false;
        return report(false);
      case "resume":
        return solver && run();
      case "zip": {
        const bytes = solver!.zip() as Uint8Array<ArrayBuffer>;
        return send({ kind: "zip", bytes }, [bytes.buffer]);
      }
    }
  });
