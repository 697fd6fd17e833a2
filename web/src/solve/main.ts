// The page that solves: a model becomes patterns in another thread, and the viewer shows them as
// they form.
import type { LumistackViewer } from "../element.js";
import { download, videoFormat } from "../capture.js";
import { filesByName, filesOf } from "../drop.js";
import { Problem, problemOf } from "../problem.js";
import { Choice } from "./choice.js";
import { builtIn, dropped, droppedField, nothing, SCENES, type Input } from "./input.js";
import { Solver } from "./solver.js";
import type { State, SolverMessage, SolverRequest } from "./worker.js";

/** Milliseconds without a change before a changed display is solved. */
const SETTLE_MS = 300;

const at = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
const viewer = document.querySelector<LumistackViewer>("lumistack-viewer")!;
const solver = new Solver(receive);
const choice = new Choice(displayChanged);

let input: Input | undefined;
let paused = false;
let settling: ReturnType<typeof setTimeout> | undefined;
/** The newest patterns, which wait until the previous ones are shown. */
let next: Extract<SolverMessage, { kind: "stack" }> | undefined;
let showing = false;
/** True while a quilt or a turn is made; new patterns wait for its end. */
let saving = false;
/** Number of the newest load. */
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
    // The page keeps the files in case the thread ends.
    solver.ask(request(found));
    buttons(true);
  } catch (error) {
    if (own === load) refuse(problemOf(error, ""));
  }
}

function request({ files, path, title, isField }: Input): SolverRequest {
  return { kind: "solve", files, path, title, isField, settings: choice.settings };
}

function displayChanged(): void {
  clearTimeout(settling);
  settling = setTimeout(async () => {
    if (!input) return;
    paused = false;
    const present = solver.runs;
    await solver.start();
    solver.ask(present ? { kind: "change", settings: choice.settings } : request(input));
    buttons(true);
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
      return download(new Blob([what.bytes], { type: "application/zip" }), `${input?.title ?? "patterns"}.zip`);
    case "error":
      return refuse(new Problem(what.message, "", false));
  }
}

/** Shows patterns one after another, and skips all but the newest. */
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
      // The picture is visible only after it has been drawn.
      await viewer.ready;
      if (performance.getEntriesByName("lumistack-first-patterns").length === 0) performance.mark("lumistack-first-patterns");
    }
  } catch (error) {
    refuse(problemOf(error, ""));
  }
  showing = false;
}

/** Names what is on show. */
function tell({ title, caption }: { title: string; caption: string }): void {
  const name = document.createElement("strong");
  name.textContent = title;
  at("caption").replaceChildren(name, ` ${caption}`);
  // Its own controls name it.
  at("caption").hidden = !viewer.hasAttribute("plain");
}

function showState({ stage, share, psnr, warnings }: State): void {
  at<HTMLProgressElement>("bar").value = share;
  const quality = Number.isFinite(psnr) ? ` ${psnr.toFixed(1)} dB over its views.` : "";
  const words = { scene: input?.isField ? "Reading the light field…" : "Reading the scene…", views: `Rendering views, ${Math.floor(100 * share)} %.`, patterns: `Solving, ${Math.floor(100 * share)} %.`, done: "Finished." };
  const rest = paused && stage !== "done" ? "Stopped." : words[stage];
  say(`${rest}${quality}`);
  Object.assign(document.documentElement.dataset, { stage, psnr });
  for (const id of ["save", "closer", "quilt", "turn"]) at<HTMLButtonElement>(id).disabled = Number.isNaN(psnr) || saving;
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

/** Enables the buttons for work in progress, or after it. */
function buttons(working: boolean): void {
  const pause = at<HTMLButtonElement>("pause");
  pause.disabled = !working;
  pause.textContent = paused ? "Go on" : "Stop";
  if (working && !paused) {
    at("warnings").hidden = true;
    at("warnings").textContent = "";
  }
}

/** Saves something of the patterns on show, which stay the same meanwhile. */
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
    // A finished preview needs no solver.
    at("empty").hidden = at("caption").hidden = true;
    at("drop").classList.remove("idle");
    say("Shown as it is.");
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
at("save").addEventListener("click", () => {
  solver.ask({ kind: "zip" });
  at("saved").hidden = false;
});
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
    () => (at("link").textContent = "It stands in the address"),
  );
});
const drop = at("drop");
// The whole page receives drops, before the viewer does.
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

// The display can be chosen before there is a scene.
const wanted = new URLSearchParams(location.hash.slice(1)).get("scene");
if (wanted) void solve(() => builtIn(wanted));
else solver.start().catch((error: unknown) => refuse(problemOf(error, "Load this page again.")));
