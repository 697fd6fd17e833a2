// Makes the page's viewer follow `lumistack live`: requests the newest state and shows it without a
// reload of the page. A bar below the viewer reports the connection. If no tracker is used, the bar
// has a switch: if it is on, the program treats the view as a tracked head.
//
// An answer contains one state: length of the JSON as u32 | JSON | files in the order of
// preview.json. The viewer's attribute `data-state` is the number of the current state.
import type { LumistackViewer } from "./element.js";

/** The JSON at the beginning of an answer. */
interface Head {
  number: number;
  /** Identifies the content of preview.json: it changes if and only if preview.json changes. */
  edition: string;
  /** Length of every file in bytes; empty if the page has the newest state already. */
  files: number[];
  /** The text of preview.json if this page has another edition of it, otherwise null. */
  preview: string | null;
  /**
   * Number and text of the newest message: a warning or an error of the last change. The text is
   * empty if the change had no warning or error.
   */
  said: number;
  message: string;
}

/** Milliseconds before a failed request is repeated. */
const AGAIN_MS = 500;
/** Time between two checks of the view, and time after which an unchanged view is sent again, milliseconds. */
const LOOK_MS = 40;
const REST_MS = 400;
/** Smallest change of the slope that is sent: the eye moves by 0.6 mm at a distance of 600 mm. */
const STEP = 0.001;

/** The bar's style sheet. The bar has the colours of the viewer. */
const SHEET = `
  lumistack-viewer { height: calc(100dvh - 34px) }
  .live { --back: #15171a; --line: #282b30; --text: #ecebe8; --quiet: #9a9da5; --good: #7fc98f; --warn: #efb152; color-scheme: dark }
  @media (prefers-color-scheme: light) {
    lumistack-viewer:not([theme]) + .live { --back: #fbfaf8; --line: #dcdad3; --text: #1a1b1d; --quiet: #5d6067; --good: #2c7a3f; --warn: #8a5a06; color-scheme: light }
  }
  lumistack-viewer[theme="light"] + .live { --back: #fbfaf8; --line: #dcdad3; --text: #1a1b1d; --quiet: #5d6067; --good: #2c7a3f; --warn: #8a5a06; color-scheme: light }
  .live { display: flex; gap: 10px; align-items: center; box-sizing: border-box; height: 34px; padding: 0 14px; border-top: 1px solid var(--line);
    background: var(--back); color: var(--text); font: 13px/1 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif }
  .live i { flex: none; width: 8px; height: 8px; border-radius: 50%; background: var(--good) }
  .live:is(.waits, .warns) i { background: var(--warn) }
  .live p { flex: 1; margin: 0; line-height: 1.3; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; color: var(--quiet) }
  .live:is(.waits, .warns) p { color: var(--warn) }
  .live label { flex: none; display: flex; gap: 7px; align-items: center; cursor: pointer }
  .live input { margin: 0 }
`;

/** The bar below the viewer. */
class Bar {
  private readonly bar = document.createElement("div");
  private readonly text = document.createElement("p");

  constructor(private readonly viewer: LumistackViewer) {
    const style = document.createElement("style");
    style.textContent = SHEET;
    document.head.append(style);
    this.bar.className = "live waits";
    this.text.setAttribute("role", "status");
    this.text.textContent = "Waiting for the first state of the display";
    this.bar.append(document.createElement("i"), this.text);
    viewer.after(this.bar);
  }

  /** Shows that state `number` is current, with the program's message or the word "Live". */
  live(number: number, message: string): void {
    this.viewer.dataset.state = String(number);
    delete this.viewer.dataset.waits;
    this.bar.className = message ? "live warns" : "live";
    this.say(message || "Live");
  }

  waits(): void {
    this.viewer.dataset.waits = "";
    this.bar.className = "live waits";
    this.say("The program “lumistack live” does not answer; it has ended or is starting again. The picture shows the last state of the display");
  }

  /** Adds a check box to the bar, which a key of the keyboard also switches. */
  toggle(label: string, title: string, key: string, changed: (on: boolean) => void): void {
    const box = document.createElement("input");
    box.type = "checkbox";
    box.id = "follow";
    const row = document.createElement("label");
    row.title = title;
    row.append(box, `${label} (${key.toUpperCase()})`);
    this.bar.append(row);
    box.addEventListener("change", () => changed(box.checked));
    document.addEventListener("keydown", (event) => {
      if (event.key.toLowerCase() === key && !event.ctrlKey && !event.metaKey && !event.altKey && !event.repeat) box.click();
    });
  }

  /** Shows a text. An unchanged text is not set again, so that screen readers do not repeat it. */
  private say(text: string): void {
    if (this.text.textContent !== text) this.text.textContent = this.text.title = text;
  }
}

/** Sends the viewing position to the program, which treats it as the position of a tracked head. */
class Guest {
  private on = false;
  private running = false;

  constructor(
    private readonly viewer: LumistackViewer,
    private readonly word: string,
  ) {
    addEventListener("pagehide", () => this.on && void this.send(""));
  }

  follow(on: boolean): void {
    this.on = on;
    if (on && !this.running) void this.run();
  }

  private async run(): Promise<void> {
    this.running = true;
    // End the swing of an idle view, since a head does not swing by itself. An assignment to the
    // slope ends the swing, even if the value stays the same.
    this.viewer.slope = this.viewer.slope;
    let sent: { x: number; y: number; at: number } | undefined;
    for (; this.on; await rest(LOOK_MS)) {
      const [x, y] = this.viewer.slope;
      const at = performance.now();
      // No user sees a hidden page. A message without a position reports this to the program.
      if (document.hidden) {
        if (sent) await this.send("");
        sent = undefined;
      } else if (!sent || Math.hypot(x - sent.x, y - sent.y) >= STEP || at - sent.at >= REST_MS) {
        sent = { x, y, at };
        await this.send(`&x=${x.toFixed(5)}&y=${y.toFixed(5)}`);
      }
    }
    await this.send("");
    this.running = false;
    if (this.on) void this.run();
  }

  private async send(view: string): Promise<void> {
    // Ignore a failure: the next request of a state will also fail, and the bar then shows it.
    await fetch(`.look?viewer=${this.word}${view}`, { cache: "no-store", keepalive: true }).catch(() => undefined);
  }
}

const rest = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

async function follow(viewer: LumistackViewer, bar: Bar): Promise<never> {
  let [number, edition, said] = [0, "", 0];
  let message = "";
  for (;;) {
    try {
      const response = await fetch(`.live?after=${number}&edition=${edition}&said=${said}`, { cache: "no-store" });
      if (response.status !== 204) {
        if (!response.ok) throw new Error(response.statusText);
        const [head, files] = taken(await response.arrayBuffer());
        if (head.preview !== null) await viewer.open(previewOf(head.preview, files));
        else if (files.length > 0) await viewer.renew(files);
        ({ number, edition, said, message } = head);
      }
      if (number > 0) bar.live(number, message);
    } catch {
      // The program has ended or restarts. The viewer keeps its content until the program answers.
      bar.waits();
      await rest(AGAIN_MS);
    }
  }
}

function taken(frame: ArrayBuffer): [Head, ArrayBuffer[]] {
  const length = new DataView(frame).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length))) as Head;
  let at = 4 + length;
  return [head, head.files.map((bytes) => frame.slice(at, (at += bytes)))];
}

/** Converts preview.json and its files to the form of dropped files: path → file. */
function previewOf(json: string, files: readonly ArrayBuffer[]): Map<string, File> {
  const preview = JSON.parse(json) as { files: { path: string }[]; poster?: string; around?: unknown };
  // Remove the poster and the small views. They would be shown while patterns load, but all
  // patterns are already present.
  delete preview.poster;
  delete preview.around;
  const named = preview.files.map(({ path }, i) => [path, new File([files[i]!], path)] as const);
  const text = new File([JSON.stringify(preview)], "preview.json");
  return new Map([["stack/preview.json", text], ...named]);
}

await customElements.whenDefined("lumistack-viewer");
const viewer = document.querySelector("lumistack-viewer");
if (viewer) {
  const bar = new Bar(viewer);
  // The program omits this parameter if a tracker sends the head's position; then the page may
  // not send a position.
  const word = new URL(import.meta.url).searchParams.get("viewer");
  if (word !== null) {
    const guest = new Guest(viewer, word);
    bar.toggle("The display follows my view", "Rays near this view count most, as for a tracked viewer", "f", (on) => guest.follow(on));
  }
  void follow(viewer, bar);
}
