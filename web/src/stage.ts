// The canvases of the viewer. They show the pictures that the simulator's thread draws.
import type { Engine } from "./engine.js";
import type { Scene, Size } from "./painter.js";
import type { Path } from "./state.js";

/**
 * A picture to show: of a stack of patterns, or of a light field. The picture of a light field is
 * at a position (u, v) between the views: u from the left, v from the top, both 0..1.
 */
export type Shot = Scene | { kind: "between"; u: number; v: number };

export interface StageEvents {
  /** Called when a picture is on the canvas. */
  shown(): void;
  failed(error: unknown): void;
}

/** Largest width or height of the exploded stack's picture, pixels. A larger picture costs time. */
const MOST_PX = 2400;

export class Stage {
  readonly main = canvas("main");
  /** The canvas that shows the target in the side-by-side comparison. */
  readonly aside = canvas("aside");
  path: Path = "cpu";
  private engine: Engine | undefined;
  private size: Size = [1, 1];
  private busy = false;
  /** The picture to draw after the current one; a newer request replaces it. */
  private next: Shot | undefined;

  constructor(
    box: HTMLElement,
    private readonly events: StageEvents,
  ) {
    box.prepend(this.main, this.aside);
  }

  use(engine: Engine): void {
    this.engine = engine;
  }

  /** Disconnects the simulator; the canvas keeps its content. */
  release(): void {
    this.engine = undefined;
    this.next = undefined;
    this.busy = false;
  }

  /** Sets the size of one picture on the page, CSS pixels. The exploded stack is drawn in this size. */
  resize(width: number, height: number): void {
    const scale = Math.min(devicePixelRatio || 1, 2, MOST_PX / Math.max(width, height, 1));
    this.size = [Math.max(Math.round(width * scale), 1), Math.max(Math.round(height * scale), 1)];
  }

  /** Draws and shows a picture, unless a newer request arrives before the drawing begins. */
  draw(shot: Shot): void {
    if (this.busy) this.next = shot;
    else void this.drawNow(shot);
  }

  private async drawNow(shot: Shot): Promise<void> {
    const { engine } = this;
    this.busy = true;
    for (let now: Shot | undefined = shot; now && engine; now = this.next) {
      this.next = undefined;
      try {
        const [main, aside] = await paint(engine, now, this.size);
        if (engine !== this.engine) return;
        put(this.main, main!);
        this.aside.hidden = !aside;
        if (aside) put(this.aside, aside);
        this.events.shown();
      } catch (error) {
        if (engine !== this.engine) return;
        this.events.failed(error);
      }
    }
    this.busy = false;
  }

  /** Returns the RGBA bytes of a picture, in its own size. */
  async pixels(shot: Shot): Promise<ImageData> {
    if (!this.engine) return new ImageData(1, 1);
    return shot.kind === "between" ? this.engine.call("between", [shot.u, shot.v]) : this.engine.call("pixels", [shot, this.size]);
  }

  /** Draws a picture. For the side-by-side comparison it draws two pictures, of the display and of the target. */
  async pictures(shot: Shot): Promise<ImageBitmap[]> {
    return this.engine ? paint(this.engine, shot, this.size) : [];
  }

  /** Draws a picture on a new canvas. For the side-by-side comparison the canvas contains both pictures. */
  async still(shot: Shot): Promise<HTMLCanvasElement> {
    const out = document.createElement("canvas");
    const pictures = await this.pictures(shot);
    out.width = pictures.reduce((sum, { width }) => sum + width, 0) || 1;
    out.height = pictures[0]?.height ?? 1;
    const context = out.getContext("2d")!;
    pictures.forEach((picture, i) => context.drawImage(picture, i * picture.width, 0));
    return out;
  }
}

async function paint(engine: Engine, shot: Shot, size: Size): Promise<ImageBitmap[]> {
  if (shot.kind !== "between") return engine.call("paint", [shot, size]);
  return [await createImageBitmap(await engine.call("between", [shot.u, shot.v]))];
}

function canvas(name: string): HTMLCanvasElement {
  const made = document.createElement("canvas");
  made.className = name;
  made.hidden = true;
  made.setAttribute("aria-hidden", "true");
  return made;
}

/** Shows a picture in its own size. */
function put(on: HTMLCanvasElement, picture: ImageBitmap): void {
  on.hidden = false;
  on.width = picture.width;
  on.height = picture.height;
  on.getContext("bitmaprenderer")!.transferFromImageBitmap(picture);
}
