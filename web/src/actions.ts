// Actions of the buttons in the top bar: save a picture, record a turn, copy a link.
import { download, fileName, record, toPng, videoFormat, type Recording } from "./capture.js";
import type { Face } from "./face.js";
import type { Motion } from "./motion.js";
import { problemOf } from "./problem.js";
import type { Shot, Stage } from "./stage.js";

/** Duration of a recorded turn around the viewing zone, seconds. */
const TURN_S = 6;

export interface Shown {
  title: string;
  mode: string;
}

export async function savePicture(stage: Stage, shot: Shot, shown: Shown, motion: Motion): Promise<void> {
  const [x, y] = motion.slope.map((value) => ((Math.atan(value) * 180) / Math.PI).toFixed(1));
  download(await toPng(await stage.still(shot)), `${fileName(shown.title)}_${shown.mode}_${x}_${y}.png`);
}

export class TurnRecorder {
  private recording: Recording | undefined;

  constructor(
    private readonly face: Face,
    private readonly stage: Stage,
    private readonly motion: Motion,
  ) {}

  /** Adds the canvas's current picture to the recording, if a recording is in progress. */
  frame(): void {
    this.recording?.frame(this.stage.main);
  }

  /** Records one turn around the viewing zone and saves it as a video; `wake` starts the drawing loop. */
  async save(shown: Shown, wake: () => void): Promise<void> {
    const format = videoFormat();
    if (this.recording || format === undefined) return;
    const button = this.face.at("record");
    button.classList.add("busy");
    this.face.notice(`Recording a turn of ${TURN_S} seconds…`, "plain");
    const { width, height } = this.stage.main;
    this.motion.startTurn(TURN_S);
    try {
      this.recording = record(width, height, format);
      wake();
      await new Promise((resolve) => setTimeout(resolve, TURN_S * 1000));
      const { blob, extension } = await this.recording.stop();
      download(blob, `${fileName(shown.title)}_turn.${extension}`);
      this.face.silence();
    } catch (error) {
      this.face.notice(`No video was made: ${problemOf(error, "").message}`, "warn");
    } finally {
      this.recording = undefined;
      button.classList.remove("busy");
    }
  }
}

export async function copyLink(url: string, face: Face): Promise<void> {
  try {
    await navigator.clipboard.writeText(url);
    face.notice("The link to this view is copied.", "passing");
  } catch {
    face.notice(url, "plain");
  }
}
