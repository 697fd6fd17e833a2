// The contact sheet of the mode "layers": a thumbnail for each mask of each layer, and for each
// frame of a directional backlight.
import type { Info } from "./info.js";

const THUMB_PX = 46;

/** Draws the mask of a layer in a frame, in the mask's own size. */
export type DrawMask = (layer: number, frame: number) => Promise<ImageBitmap>;

export class Sheet {
  /** The masks whose thumbnails show the current patterns. */
  private drawn = new Set<string>();
  private cells = new Map<string, HTMLButtonElement>();
  private mask: DrawMask | undefined;
  private info: Info | undefined;
  private busy = false;
  /** The frames of the newest call of `show` whose thumbnails are not yet drawn. */
  private next: readonly number[] | undefined;

  constructor(
    private readonly box: HTMLElement,
    private readonly choose: (layer: number, frame: number) => void,
  ) {
    box.setAttribute("role", "group");
    box.setAttribute("aria-label", "Masks: rows are layers from front to rear, columns are frames; arrow keys move");
    box.addEventListener("keydown", (event) => this.key(event));
  }

  /** Makes an empty cell for every mask of a stack. */
  setUp(mask: DrawMask, info: Info): void {
    this.clear();
    this.mask = mask;
    this.info = info;
    this.forget();
    this.cells = new Map();
    this.box.style.gridTemplateColumns = "auto 1fr";
    const names = rowNames(info);
    this.box.replaceChildren(
      ...names.flatMap(({ layer, name, detail }) => {
        const label = document.createElement("div");
        label.className = "name";
        label.textContent = name;
        const small = document.createElement("small");
        small.textContent = detail;
        label.append(small);
        const strip = document.createElement("div");
        strip.className = "strip";
        for (let frame = 0; frame < info.frames; frame++) strip.append(this.cell(layer, frame, name));
        return [label, strip];
      }),
    );
  }

  clear(): void {
    this.mask = undefined;
    this.next = undefined;
    this.busy = false;
    this.box.replaceChildren();
  }

  /** Called after the patterns have changed. The next call of `show` draws all thumbnails again. */
  forget(): void {
    this.drawn = new Set();
  }

  /** Marks the selected mask, and draws the thumbnails of the frames in `ready`. */
  show(layer: number, frame: number, ready: readonly number[]): void {
    for (const [key, cell] of this.cells) {
      const chosen = key === `${layer}/${frame}`;
      cell.setAttribute("aria-pressed", String(chosen));
      cell.tabIndex = chosen ? 0 : -1;
      cell.disabled = !ready.includes(Number(key.split("/")[1]));
    }
    this.cells.get(`${layer}/${frame}`)?.scrollIntoView({ block: "nearest", inline: "nearest" });
    this.next = ready;
    if (!this.busy) void this.drawThumbs();
  }

  private cell(layer: number, frame: number, name: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-label", `${name}, frame ${frame + 1}`);
    button.title = `${name}, frame ${frame + 1}`;
    const [cols, rows] = sizeOf(this.info!, layer);
    const canvas = document.createElement("canvas");
    canvas.style.aspectRatio = `${cols} / ${rows}`;
    canvas.style.width = `${Math.round((THUMB_PX * cols) / rows)}px`;
    button.append(canvas);
    button.addEventListener("click", () => this.choose(layer, frame));
    this.cells.set(`${layer}/${frame}`, button);
    return button;
  }

  /** Draws the missing thumbnails, and repeats this if `show` is called meanwhile. */
  private async drawThumbs(): Promise<void> {
    this.busy = true;
    const { mask } = this;
    for (let ready = this.next; ready; ready = this.next) {
      this.next = undefined;
      for (const [key, cell] of this.cells) {
        const [layer, frame] = key.split("/").map(Number) as [number, number];
        const { drawn } = this;
        if (!ready.includes(frame) || drawn.has(key)) continue;
        const picture = await mask?.(layer, frame).catch(() => undefined);
        // A new stack has a loop of its own, so this loop ends.
        if (mask !== this.mask) return;
        if (!picture) break;
        const thumb = cell.firstElementChild as HTMLCanvasElement;
        thumb.height = THUMB_PX * 2;
        thumb.width = Math.max(Math.round((thumb.height * picture.width) / picture.height), 1);
        const context = thumb.getContext("2d")!;
        context.imageSmoothingQuality = "high";
        context.drawImage(picture, 0, 0, thumb.width, thumb.height);
        picture.close();
        // `forget` replaces the set, so a thumbnail of earlier patterns is drawn again.
        drawn.add(key);
      }
    }
    this.busy = false;
  }

  private key(event: KeyboardEvent): void {
    const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    const focused = [...this.cells].find(([, cell]) => cell === (this.box.getRootNode() as ShadowRoot).activeElement);
    if (!step || !focused || !this.info) return;
    event.preventDefault();
    event.stopPropagation();
    const order = rowNames(this.info).map(({ layer }) => layer);
    const [layer, frame] = focused[0].split("/").map(Number) as [number, number];
    const to = this.cells.get(`${order[order.indexOf(layer) + step[0]!]}/${frame + step[1]!}`);
    to?.focus();
    to?.click();
  }
}

/**
 * Returns the rows of the sheet from top to bottom: the layers from front to rear, then the
 * backlight.
 */
function rowNames(info: Info): { layer: number; name: string; detail: string }[] {
  const count = info.layers.length;
  const rows = info.layers.map((layer, i) => ({
    layer: i,
    name: layerName(i, count),
    detail: `${layer.d_mm > 0 ? "+" : layer.d_mm < 0 ? "−" : ""}${Math.abs(layer.d_mm).toFixed(1)} mm · ${layer.cols} × ${layer.rows}`,
  }));
  if (info.directional && info.backlight) rows.unshift({ layer: count, name: "Backlight", detail: `${info.backlight.cols} × ${info.backlight.rows}` });
  return rows.reverse();
}

export function layerName(layer: number, count: number): string {
  if (layer >= count) return "Backlight";
  const where = count > 1 && layer === 0 ? " (rear)" : count > 1 && layer === count - 1 ? " (front)" : "";
  return `Layer ${layer + 1}${where}`;
}

export function sizeOf(info: Info, layer: number): [number, number] {
  const found = info.layers[layer] ?? info.backlight ?? info.field;
  return [found.cols, found.rows];
}

/**
 * Returns the largest index of a row of masks: the index of a directional backlight, otherwise the
 * index of the front layer.
 */
export function lastMask(info: Info): number {
  return Math.max(info.layers.length - (info.directional && info.backlight ? 0 : 1), 0);
}
