// The map of the viewing zone. It shows the target's views and the eye's position. The user can
// move the eye on the map.
import { zoneSlope, type Info } from "./info.js";
import type { Slope } from "./state.js";
import { REACH } from "./motion.js";

const SVG = "http://www.w3.org/2000/svg";
/** Width of the drawing, and limits of its height, in units of its `viewBox`. */
const WIDTH = 240;
const LEAST_HEIGHT = 64;
const MOST_HEIGHT = 150;
/** Half width of the drawing, in half widths of the zone. It is a little more than REACH. */
const SHOWN = REACH * 1.06;

export class ZoneMap {
  private readonly svg: SVGSVGElement;
  private readonly dot: SVGElement;
  private readonly inner: SVGElement;
  private zone: Slope = [1, 1];
  private height = MOST_HEIGHT;
  /** Units of the drawing per unit of slope, the same for x and y. */
  private scale = 1;
  private inside = true;

  constructor(
    private readonly pad: HTMLElement,
    private readonly look: (slope: Slope) => void,
    private readonly hold: (down: boolean) => void,
  ) {
    this.svg = make("svg", { class: "map", "aria-hidden": "true" }) as SVGSVGElement;
    this.inner = make("g", {});
    this.dot = make("g", { class: "eye" });
    this.dot.append(make("circle", { r: "9", class: "halo" }), make("circle", { r: "4.5", class: "point" }));
    this.svg.append(this.inner, this.dot);
    pad.append(this.svg);
    this.listen();
  }

  /** Draws the viewing zone of a display or light field, and the slopes of its views. */
  show(info: Pick<Info, "views" | "zone">): void {
    this.zone = zoneSlope(info as Info);
    const [zoneX, zoneY] = this.zone;
    this.height = Math.round(Math.min(Math.max((WIDTH * zoneY) / zoneX, LEAST_HEIGHT), MOST_HEIGHT));
    this.scale = Math.min(WIDTH / zoneX, this.height / zoneY) / 2 / SHOWN;
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${this.height}`);
    const width = Math.max(2 * zoneX * this.scale, 8);
    const high = Math.max(2 * zoneY * this.scale, 8);
    const left = (WIDTH - width) / 2;
    const top = (this.height - high) / 2;
    this.inner.replaceChildren(
      make("line", { x1: "0", x2: `${WIDTH}`, y1: `${this.height / 2}`, y2: `${this.height / 2}`, class: "axis" }),
      make("line", { y1: "0", y2: `${this.height}`, x1: `${WIDTH / 2}`, x2: `${WIDTH / 2}`, class: "axis" }),
      make("rect", { x: `${left}`, y: `${top}`, width: `${width}`, height: `${high}`, rx: "3", class: "zone" }),
    );
    const crowd = Math.max(info.views.cols, info.views.rows);
    for (const [x, y] of info.views.slopes) {
      const [cx, cy] = this.toMap([x, y]);
      this.inner.append(make("circle", { cx: `${cx}`, cy: `${cy}`, r: crowd > 15 ? "0.9" : "1.5", class: "view" }));
    }
  }

  /** Marks the eye's position. */
  mark(slope: Slope): void {
    const [x, y] = this.toMap(slope);
    this.dot.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
    const inside = isInside(slope, this.zone);
    if (inside !== this.inside) this.pad.classList.toggle("outside", !inside);
    this.inside = inside;
  }

  private toMap([x, y]: Slope): [number, number] {
    const within = (value: number, extent: number): number => Math.min(Math.max(value, 5), extent - 5);
    return [within(WIDTH / 2 + x * this.scale, WIDTH), within(this.height / 2 - y * this.scale, this.height)];
  }

  private listen(): void {
    const follow = (event: PointerEvent): void => {
      const box = this.svg.getBoundingClientRect();
      const unit = Math.min(box.width / WIDTH, box.height / this.height) * this.scale;
      this.look([(event.clientX - box.left - box.width / 2) / unit, -(event.clientY - box.top - box.height / 2) / unit]);
    };
    this.pad.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.pad.setPointerCapture(event.pointerId);
      this.hold(true);
      follow(event);
    });
    this.pad.addEventListener("pointermove", (event) => {
      if (this.pad.hasPointerCapture(event.pointerId)) follow(event);
    });
    for (const end of ["pointerup", "pointercancel"] as const) {
      this.pad.addEventListener(end, (event) => {
        if (this.pad.hasPointerCapture(event.pointerId)) this.hold(false);
      });
    }
  }
}

export function isInside([x, y]: Slope, zone: Slope): boolean {
  return Math.abs(x) <= zone[0] * 1.0001 && Math.abs(y) <= zone[1] * 1.0001;
}

/** Describes a slope in words: "4.2° right, 1.0° up", or "straight ahead". */
export function inWords([x, y]: Slope): string {
  const degrees = (tangent: number): number => Math.round(((Math.atan(Math.abs(tangent)) * 180) / Math.PI) * 10) / 10;
  const parts: string[] = [];
  if (degrees(x) > 0) parts.push(`${degrees(x).toFixed(1)}° ${x > 0 ? "right" : "left"}`);
  if (degrees(y) > 0) parts.push(`${degrees(y).toFixed(1)}° ${y > 0 ? "up" : "down"}`);
  return parts.length > 0 ? parts.join(", ") : "straight ahead";
}

function make(name: string, attributes: Record<string, string>): SVGElement {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}
