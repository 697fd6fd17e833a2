// Sends a quilt to Looking Glass Bridge, the program that drives the panels of Looking Glass.
// Bridge accepts requests from this computer, and reads quilts from files or web addresses only.
import { Problem, problemOf } from "./problem.js";

const ADDRESS = "http://localhost:33334/";
/** Name of the list that Bridge plays. */
const LIST = "Lumistack";
/** Longest time to wait for an answer, milliseconds. */
const PATIENCE_MS = 5000;

/** A panel that Bridge drives, with the layout of its quilts. */
export interface Panel {
  name: string;
  columns: number;
  rows: number;
}

/** A value in an answer. Values are nested: each has a name, a type, and a value that may contain further values. */
interface Value {
  value?: unknown;
}
interface Answer {
  payload?: Value;
  status?: Value;
}

export class Bridge {
  private constructor(
    private readonly session: string,
    readonly panels: readonly Panel[],
  ) {}

  /** Starts a session, and lists the panels. */
  static async connect(): Promise<Bridge> {
    const { payload } = await ask("enter_orchestration", { name: "default" });
    const session = payload?.value;
    if (typeof session !== "string" || session === "") throw strange("enter_orchestration", "a session");
    const devices = await ask("available_output_devices", { orchestration: session });
    const panels = Object.values((devices.payload?.value ?? {}) as Record<string, Value>).flatMap(panelOf);
    if (panels.length === 0) throw new Problem("Looking Glass Bridge runs, but has no panel.", "Connect both cables of the panel and try again.", false);
    return new Bridge(session, panels);
  }

  /** Plays the quilt in a file; `aspect` is the width of a view over its height. */
  async play(path: string, { columns, rows }: Panel, aspect: number): Promise<void> {
    const list = { orchestration: this.session, name: LIST, loop: true };
    await ask("delete_playlist", list, true);
    await ask("show_window", { orchestration: this.session, show_window: true, head_index: -1 });
    await ask("instance_playlist", list);
    await ask("insert_playlist_entry", {
      orchestration: this.session,
      name: LIST,
      id: 0,
      index: 0,
      uri: path,
      rows,
      cols: columns,
      focus: 0,
      aspect,
      view_count: rows * columns,
      crop_pos_x: 0,
      crop_pos_y: 0,
      zoom: 1,
      isRGBD: 0,
      tag: "",
    });
    await ask("play_playlist", { orchestration: this.session, name: LIST, head_index: -1 });
  }
}

/** Returns a list with the panel that a device of Bridge describes; an empty list for an ordinary monitor. */
function panelOf({ value }: Value): Panel[] {
  const device = value as Record<string, Value> | undefined;
  const kind = device?.["hardwareVersion"]?.value;
  if (!device || typeof kind !== "string" || kind === "thirdparty") return [];
  const { tileX, tileY } = JSON.parse(String(device["defaultQuilt"]?.value || "{}")) as { tileX?: number; tileY?: number };
  const right = (count: number | undefined): count is number => Number.isInteger(count) && count! >= 1 && count! <= 64;
  if (!right(tileX) || !right(tileY)) throw strange("available_output_devices", "the columns and rows of a quilt");
  return [{ name: String(device["hwid"]?.value ?? kind), columns: tileX, rows: tileY }];
}

/** Sends a request. With `refusable`, Bridge may refuse the request, for example if the named list does not exist. */
async function ask(what: string, content: object, refusable = false): Promise<Answer> {
  let answer: Answer;
  try {
    const response = await fetch(`${ADDRESS}${what}`, {
      method: "PUT",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(content),
      signal: AbortSignal.timeout(PATIENCE_MS),
    });
    answer = (await response.json()) as Answer;
  } catch (error) {
    throw new Problem(
      `Looking Glass Bridge does not answer on this computer: ${problemOf(error, "").message}.`,
      "Start Looking Glass Bridge, allow this page to reach programs on this computer, and try again.",
      false,
    );
  }
  const status = answer.status?.value;
  if (status !== "Completion" && status !== "Pending" && !refusable) throw strange(what, "“Completion” or “Pending”", status);
  return answer;
}

function strange(what: string, expected: string, found?: unknown): Problem {
  const end = found === undefined ? "" : `, found “${String(found)}”`;
  return new Problem(`Looking Glass Bridge: expected ${expected} in the answer to ${what}${end}.`, "See the messages of Bridge. The page speaks the protocol of Bridge 2.2.", false);
}
