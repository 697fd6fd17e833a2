// Handles pointer, touch and keys on the picture.
import type { Mode, Slope } from "./state.js";
import { MODES } from "./state.js";
import { REACH, type Motion } from "./motion.js";

export interface InputTarget {
  mode(): Mode;
  zone(): Slope;
  setMode(mode: Mode): void;
  turn(yaw: number, pitch: number): void;
  pause(): void;
  stepFrame(by: number): void;
  stepLayer(by: number): void;
  moved(): void;
}

/** Rotation of the exploded stack (layers drawn apart) per pixel of a drag, and per press of an arrow key, radians. */
const TURN_PER_PX = 0.006;
const TURN_PER_KEY = 0.09;
/** Change of the slope per press of an arrow key, as a fraction of the zone's half width. */
const STEP = 0.08;
/** Length of a drag that moves the view across half the viewing zone, as a fraction of the width of the box around the picture. */
const TRAVEL = 0.32;

export function listenToPointer(stage: HTMLElement, motion: Motion, target: InputTarget): void {
  let last: { x: number; y: number } | undefined;
  const ours = (event: PointerEvent): boolean => !(event.target as Element).closest("button, .card, .notice");

  // Press: a finger or a pen begins a drag in every mode, a mouse only in the mode "exploded".
  stage.addEventListener("pointerdown", (event) => {
    if (!ours(event) || event.button !== 0) return;
    if (event.pointerType !== "mouse" || target.mode() === "exploded") {
      stage.setPointerCapture(event.pointerId);
      last = { x: event.clientX, y: event.clientY };
      motion.hold();
      stage.classList.add("down");
      target.moved();
    }
  });
  // Move: a drag turns the stack or the view; a mouse without a pressed button sets the view.
  stage.addEventListener("pointermove", (event) => {
    const [zoneX, zoneY] = target.zone();
    const box = stage.getBoundingClientRect();
    if (last) {
      const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
      last = { x: event.clientX, y: event.clientY };
      if (target.mode() === "exploded") target.turn(dx * TURN_PER_PX, dy * TURN_PER_PX);
      // The user drags the display, not the eye: a drag to the left shows it from farther right.
      else motion.lookBy([(-dx / (box.width * TRAVEL)) * zoneX, (dy / (box.width * TRAVEL)) * zoneY]);
      target.moved();
    } else if (event.pointerType === "mouse" && ours(event) && target.mode() !== "exploded" && target.mode() !== "layers") {
      const x = ((event.clientX - box.left) / box.width - 0.5) * 2;
      const y = ((event.clientY - box.top) / box.height - 0.5) * 2;
      motion.lookTo([x * REACH * zoneX, -y * REACH * zoneY]);
      target.moved();
    }
  });
  // Release: the drag ends, and the view moves on with inertia.
  const end = (event: PointerEvent): void => {
    if (!last) return;
    last = undefined;
    stage.classList.remove("down");
    motion.release(event.type === "pointerup" && target.mode() !== "exploded");
    target.moved();
  };
  stage.addEventListener("pointerup", end);
  stage.addEventListener("pointercancel", end);
}

/** Handles a key; returns true if the key has a function. */
export function handleKey(event: KeyboardEvent, motion: Motion, target: InputTarget): boolean {
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  const arrow = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] } as Record<string, [number, number]>)[event.key];
  const mode = target.mode();
  if (arrow) {
    const [x, y] = arrow;
    const [zoneX, zoneY] = target.zone();
    const by = event.shiftKey ? 4 : 1;
    if (mode === "exploded") target.turn(x * by * TURN_PER_KEY, -y * by * TURN_PER_KEY);
    else if (mode === "layers") {
      if (x !== 0) target.stepFrame(x);
      else target.stepLayer(y);
    } else motion.lookBy([x * by * STEP * zoneX, y * by * STEP * zoneY]);
  } else if (event.key === "Home" || event.key === "0") motion.lookTo([0, 0]);
  else if (event.key === " ") target.pause();
  else if (event.key === "," || event.key === ".") target.stepFrame(event.key === "." ? 1 : -1);
  else if (/^[1-5]$/.test(event.key)) target.setMode(MODES[Number(event.key) - 1]!);
  else return false;
  target.moved();
  return true;
}

/** Handles input on the boundary between display and target. `share` is its position, 0..1 from the left. */
export function listenToDivider(divider: HTMLElement, picture: HTMLElement, move: (share: number) => void, current: () => number): void {
  divider.addEventListener("pointerdown", (event) => {
    divider.setPointerCapture(event.pointerId);
    event.stopPropagation();
  });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    event.stopPropagation();
    const box = picture.getBoundingClientRect();
    move((event.clientX - box.left) / box.width);
  });
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1 }[event.key];
    const end = { Home: 0, End: 1 }[event.key];
    if (step === undefined && end === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    move(end ?? current() + step! * (event.shiftKey ? 4 : 1));
  });
}

/** Handles keys on the map of the viewing zone. On this map the arrow keys move the eye in every mode. */
export function listenToPad(pad: HTMLElement, motion: Motion, target: InputTarget): void {
  const eye: InputTarget = { ...target, mode: () => "perceived" };
  pad.addEventListener("keydown", (event) => {
    if (!/^(Arrow|Home)/.test(event.key) || !handleKey(event, motion, eye)) return;
    event.preventDefault();
    event.stopPropagation();
  });
}
