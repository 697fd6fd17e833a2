// The dialog for other displays: headset, lenticular panel, Looking Glass Bridge. The code for a
// display is loaded when the user chooses the display.
import { download, fileName, toPng } from "./capture.js";
import type { Face } from "./face.js";
import type { Info } from "./info.js";
import { Problem, problemOf } from "./problem.js";
import { quilt } from "./quilt.js";
import type { Slope } from "./state.js";

/** Computes pictures that an eye sees on the simulated display, in every mode of the viewer. */
export interface Views {
  readonly info: Info;
  /**
   * Returns the picture for an eye, in the light field's size. Without `eyeMm` the eye's distance
   * is the distance that the viewer's options set.
   */
  picture(slope: Slope, eyeMm?: number): Promise<ImageBitmap>;
  /** Called after the last picture. */
  done(): void;
}

/** Time that a browser may need to store a saved quilt, milliseconds. */
const STORE_MS = 800;
/** Key in the browser's storage. Its value is the folder in which the browser saves files. */
const FOLDER = "lumistack-folder";

export class Others {
  private woven: { canvas: HTMLCanvasElement; name: string } | undefined;

  constructor(
    private readonly face: Face,
    private readonly views: () => Views | undefined,
  ) {
    const dialog = face.at("others") as HTMLDialogElement;
    face.at("elsewhere").addEventListener("click", () => {
      void this.refresh();
      dialog.showModal();
    });
    this.on("headset", async (views) => {
      const { enter } = await code(import("./headset.js"));
      dialog.close();
      await enter(views);
    });
    face.at("lenticular").addEventListener("click", () => face.at("calibration").click());
    face.at("calibration").addEventListener("change", ({ target }) => {
      const field = target as HTMLInputElement;
      const file = field.files?.[0];
      field.value = "";
      if (file) void this.run((views) => this.weave(views, file));
    });
    this.on("fill", async () => (await code(import("./lenticular.js"))).fill(this.woven!.canvas));
    this.on("woven", async () => download(await toPng(this.woven!.canvas), this.woven!.name));
    this.on("bridge", (views) => this.handOver(views));
    (face.at("stored") as HTMLInputElement).value = stored() ?? "";
  }

  private on(id: string, action: (views: Views) => Promise<void>): void {
    this.face.at(id).addEventListener("click", () => void this.run(action));
  }

  private async run(action: (views: Views) => Promise<void>): Promise<void> {
    const views = this.views();
    if (!views) return this.say("There is no picture yet.");
    this.say("");
    try {
      await action(views);
    } catch (error) {
      const { message, advice } = problemOf(error, "");
      this.say(`${message} ${advice}`);
    }
  }

  private say(text: string): void {
    this.face.at("others-status").textContent = text;
  }

  /** Enables the button of the headset only if this browser and this content support a headset. */
  private async refresh(): Promise<void> {
    this.say("");
    const headset = this.face.at("headset") as HTMLButtonElement;
    const possible = async (mode: XRSessionMode): Promise<boolean> => (await navigator.xr?.isSessionSupported(mode).catch(() => false)) ?? false;
    // Light fields of other programs have no size in millimetres, which the headset needs.
    const sized = (this.views()?.info.layers.length ?? 0) > 0;
    headset.disabled = !sized || !((await possible("immersive-ar")) || (await possible("immersive-vr")));
  }

  private async weave(views: Views, file: File): Promise<void> {
    const { calibrationOf, weave } = await code(import("./lenticular.js"));
    const panel = calibrationOf(await file.text(), file.name);
    this.say("Weaving…");
    const canvas = await weave(views, panel);
    this.woven?.canvas.remove();
    // The style sheet shows this canvas only in full-screen mode.
    canvas.className = "woven";
    this.face.at("others").append(canvas);
    this.woven = { canvas, name: `${fileName(views.info.title)}_${panel.cols}x${panel.rows}.png` };
    this.face.at("woven-row").hidden = false;
    this.say(`The picture is woven for ${panel.serial || "the panel"}, ${panel.cols} × ${panel.rows} pixels. Move this window to the panel, then press Fill the screen. Escape leaves the full screen.`);
  }

  private async handOver(views: Views): Promise<void> {
    const folder = (this.face.at("stored") as HTMLInputElement).value.trim();
    if (folder === "") throw new Problem("Bridge reads the quilt from a file.", "Enter the folder in which this browser saves files.", false);
    store(folder);
    const { Bridge } = await code(import("./bridge.js"));
    const bridge = await Bridge.connect();
    const panel = bridge.panels[0]!;
    this.say("Making a quilt…");
    const { blob, ending, aspect } = await quilt(views, panel);
    // The time makes the name unique, since the folder may contain older quilts.
    const name = `${fileName(views.info.title)}-${Date.now()}${ending}`;
    download(blob, name);
    await new Promise((resolve) => setTimeout(resolve, STORE_MS));
    await bridge.play(`${folder}${/[\\/]$/.test(folder) ? "" : folder.includes("\\") ? "\\" : "/"}${name}`, panel, aspect);
    this.say(`${panel.name} shows ${name}.`);
  }
}

/** Waits for code that is loaded on demand. A page in a single file does not contain this code, so the load fails. */
async function code<T>(loading: Promise<T>): Promise<T> {
  try {
    return await loading;
  } catch {
    throw new Problem("The code for this display could not be loaded.", "Open the preview's folder with “lumistack preview”: a page in a single file does not contain this code.", false);
  }
}

function stored(): string | null {
  try {
    return localStorage.getItem(FOLDER);
  } catch {
    return null;
  }
}

function store(folder: string): void {
  try {
    localStorage.setItem(FOLDER, folder);
  } catch {
    // Some pages have no storage, for example pages from a file; the input field keeps the text.
  }
}
