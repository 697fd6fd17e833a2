// The page that solves (`solve.html`): another thread computes patterns for a scene or light field.
// Until the thread has ended its work, the viewer shows its intermediate patterns.
import type { LumistackViewer } from "../element.js";
import { download, videoFormat } from "../capture.js";
import { filesByName, filesOf } from "../drop.js";
import { Problem, problemOf } from "../problem.js";
import { Choice } from "./choice.js";
import { builtIn, dropped, droppedField, nothing, SCENES, type Input } from "./input.js";
import { Solver } from "./solver.js";
import type { State, SolverMessage, SolverRequest } from "./worker.js";

/** Time without a change of the settings after which a solve begins, milliseconds. */
const SETTLE_MS = 300;

const at = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
const viewer = document.querySelector<LumistackViewer>("lumistack-viewer")!;
const solver = new Solver(receive);
const choice = new Choice(displayChanged);

let input: Input | undefined;
let paused = false;
let settling: ReturnType<typeof setTimeout> | undefined;
/** The newest patterns that are not yet shown. They wait until the viewer shows the previous patterns. */
let next: Extract<SolverMessage, { kind: "stack" }> | undefined;
let showing = false;
let stage: State["stage"] | undefined;
/** True while a quilt or a video is saved; new patterns are shown only afterwards. */
let saving = false;
/** Number of the newest call of `solve`. An earlier call ends if it finds a higher number than its own. */
let load = 0;

async function solve(get: () => Promise<Input | undefined>): Promise<void> {
  const own = ++load;
  try {
    say("Reading the files…");
    const [found] = await Promise.all([get(), solver.start()]);
    if (own !== load || !found) return;
    input = found;
    paused = false;
    document.title = `${found.title} – Lumistack`;
    performance.mark("lumistack-solve");
    // `input` keeps the files, so that a new thread can read them if the current thread ends.
    begin(request(found));
  } catch (error) {
    if (own === load) refuse(problemOf(error, ""));
  }
}

function request({ files, path, title, isField }: Input): SolverRequest {
  return { kind: "solve", files, path, title, isField, settings: choice.settings };
}

/** Begins new work. The thread then has no patterns until it sends the first patterns of this work. */
function begin(work: SolverRequest): void {
  saveable(false);
  solver.ask(work);
  buttons(true);
}

function displayChanged(): void {
  clearTimeout(settling);
  settling = setTimeout(async () => {
    if (!input) return;
    paused = false;
    const present = solver.runs;
    await solver.start();
    begin(present ? { kind: "change", settings: choice.settings } : request(input));
  }, SETTLE_MS);
}

function receive(what: SolverMessage): void {
  switch (what.kind) {
    case "presets":
      return choice.know(JSON.parse(what.json));
    case "state":
      return showState(what.state);
    case "stack":
      next = what;
      return void show();
    case "zip":
      at("saved").hidden = false;
      return download(new Blob([what.bytes], { type: "application/zip" }), `${what.title}.zip`);
    case "error":
      // The thread has ended, and its patterns with it.
      saveable(false);
      return refuse(new Problem(what.message, "", false));
  }
}

/** Shows patterns one after another. If several arrive while patterns are loaded, only the newest are shown next. */
async function show(): Promise<void> {
  if (showing || saving) return;
  showing = true;
  try {
    for (let stack = next; stack && !saving; stack = next) {
      next = undefined;
      await customElements.whenDefined("lumistack-viewer");
      at("drop").classList.remove("idle");
      at("empty").hidden = true;
      await viewer.showStack(stack.json, stack.codes);
      tell(JSON.parse(stack.json) as { title: string; caption: string });
      saveable(solver.runs);
      // Wait until the picture is drawn, since this performance mark states when it became visible.
      await viewer.ready;
      if (performance.getEntriesByName("lumistack-first-patterns").length === 0) performance.mark("lumistack-first-patterns");
    }
  } catch (error) {
    refuse(problemOf(error, ""));
  }
  showing = false;
  markStage();
}

/** Sets the page's attribute `data-stage`, which is "done" only after the viewer shows the last patterns. */
function markStage(): void {
  if (stage && !(stage === "done" && showing)) document.documentElement.dataset.stage = stage;
}

/** Shows title and caption of the current patterns above the viewer. */
function tell({ title, caption }: { title: string; caption: string }): void {
  const name = document.createElement("strong");
  name.textContent = title;
  at("caption").replaceChildren(name, ` ${caption}`);
  // Without the attribute "plain" the viewer has its own controls, and shows title and caption
  // itself.
  at("caption").hidden = !viewer.hasAttribute("plain");
}

function showState({ stage: now, share, psnr, warnings, onDevice, threads }: State): void {
  stage = now;
  at<HTMLProgressElement>("bar").value = share;
  const quality = Number.isFinite(psnr) ? ` PSNR ${psnr.toFixed(1)} dB over the views.` : "";
  const words = { scene: input?.isField ? "Reading the light field…" : "Reading the scene…", views: `Rendering views${threads > 1 ? ` on ${threads} threads` : ""}, ${Math.floor(100 * share)} %.`, patterns: `Solving, ${Math.floor(100 * share)} %.`, done: "Finished." };
  const rest = paused && stage !== "done" ? "Stopped." : words[stage];
  const reason = solver.obstacle ? `: ${solver.obstacle}` : "";
  say(`${rest}${quality} ${onDevice ? "On the graphics processor" : `On the processor${reason}`}.`);
  document.documentElement.dataset.psnr = String(psnr);
  markStage();
  for (const id of ["closer", "quilt", "turn"]) at<HTMLButtonElement>(id).disabled = Number.isNaN(psnr) || saving;
  if (stage === "done") {
    performance.mark("lumistack-done");
    buttons(false);
  }
  if (warnings.length > 0) {
    at("warnings").hidden = false;
    at("warnings").textContent = [...new Set([...(at("warnings").textContent ?? "").split("\n"), ...warnings])].filter(Boolean).join("\n");
  }
}

function say(text: string): void {
  at("status").textContent = text;
  at("problem").hidden = true;
}

function refuse({ message, advice }: Problem): void {
  say("");
  at("problem").hidden = false;
  at("problem").textContent = [message, advice].filter(Boolean).join(" ");
  buttons(false);
}

/** Enables or disables the button that saves patterns. It is enabled while the viewer shows the thread's patterns. */
function saveable(is: boolean): void {
  at<HTMLButtonElement>("save").disabled = !is;
}

/** Sets the button that stops and continues the work. `working` is false after the end of the work. */
function buttons(working: boolean): void {
  const pause = at<HTMLButtonElement>("pause");
  pause.disabled = !working;
  pause.textContent = paused ? "Go on" : "Stop";
  if (working && !paused) {
    at("warnings").hidden = true;
    at("warnings").textContent = "";
  }
}

/** Saves a quilt or a video of the current patterns by `make`. New patterns are shown only afterwards. */
async function save(id: "quilt" | "turn", make: () => Promise<void>): Promise<void> {
  const button = at<HTMLButtonElement>(id);
  const { textContent: text } = button;
  saving = true;
  for (const other of ["quilt", "turn"]) at<HTMLButtonElement>(other).disabled = true;
  button.textContent = "Saving…";
  try {
    await make();
  } catch (error) {
    refuse(problemOf(error, ""));
  }
  saving = false;
  button.textContent = text;
  for (const other of ["quilt", "turn"]) at<HTMLButtonElement>(other).disabled = false;
  void show();
}

async function open(files: ReadonlyMap<string, File>): Promise<void> {
  await solve(async () => {
    const isPreview = [...files.keys()].some((path) => /(^|\/)preview\.json$/.test(path));
    const found = dropped(files) ?? (isPreview ? undefined : droppedField(files));
    if (found) return found;
    if (!isPreview) throw nothing(files);
    // A preview already contains patterns, so the viewer shows it without the solver.
    saveable(false);
    at("empty").hidden = at("caption").hidden = true;
    at("drop").classList.remove("idle");
    say("The dropped folder is a preview, which already contains patterns.");
    await viewer.open(files);
    return undefined;
  });
}

at("scenes").append(
  ...Object.entries(SCENES).map(([name, { title }]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = title;
    button.addEventListener("click", () => void solve(() => builtIn(name)));
    return button;
  }),
);
at("choose").addEventListener("click", () => at("files").click());
at("choose-folder").addEventListener("click", () => at("folder").click());
for (const id of ["files", "folder"]) {
  at<HTMLInputElement>(id).addEventListener("change", ({ target }) => {
    const field = target as HTMLInputElement;
    if (field.files?.length) void open(filesByName(field.files));
    field.value = "";
  });
}
at("pause").addEventListener("click", () => {
  paused = !paused;
  solver.ask({ kind: paused ? "pause" : "resume" });
  buttons(true);
});
at("save").addEventListener("click", () => solver.ask({ kind: "zip" }));
at("quilt").addEventListener("click", () => void save("quilt", () => viewer.saveQuilt()));
at("turn").addEventListener("click", () => void save("turn", () => viewer.saveTurn()));
at("turn").hidden = videoFormat() === undefined;
at("closer").addEventListener("click", () => {
  const closer = viewer.toggleAttribute("plain") === false;
  at("closer").setAttribute("aria-pressed", String(closer));
  at("caption").hidden = closer;
});
at("link").addEventListener("click", async () => {
  const address = choice.address;
  if (input?.builtIn) address.set("scene", input.builtIn);
  history.replaceState(undefined, "", `#${address}`);
  await navigator.clipboard?.writeText(location.href).then(
    () => (at("link").textContent = "Link copied"),
    () => (at("link").textContent = "The link is in the address bar"),
  );
});
const drop = at("drop");
// The whole page handles drops, and stops them before they reach the viewer.
for (const kind of ["dragenter", "dragover", "dragleave", "drop"] as const) {
  addEventListener(
    kind,
    (event) => {
      event.preventDefault();
      event.stopPropagation();
      drop.classList.toggle("over", kind === "dragover" || kind === "dragenter");
      if (kind === "drop" && event.dataTransfer) void filesOf(event.dataTransfer).then(open, (error: unknown) => refuse(problemOf(error, "")));
    },
    { capture: true },
  );
}

// Solve the scene that the address names. Otherwise only start the thread: it sends the presets, so
// that the user can choose a display.
const wanted = new URLSearchParams(location.hash.slice(1)).get("scene");
if (wanted) void solve(() => builtIn(wanted));
else solver.start().catch((error: unknown) => refuse(problemOf(error, "Load this page again.")));
