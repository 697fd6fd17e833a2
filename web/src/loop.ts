// Draws the picture repeatedly while it moves, and once after each change. While the element is out
// of sight, no picture is drawn.
import type { Motion } from "./motion.js";

export interface Loop {
  /** True if there is a picture to draw. */
  can(): boolean;
  /** Advances slow motion by `dtS` seconds. `on` is true while slow motion runs, `changed` if another frame is shown. */
  play(dtS: number): { on: boolean; changed: boolean };
  draw(): void;
}

export class Ticker {
  private dirty = false;
  private request = 0;
  private last = 0;
  private visible = true;
  private idle: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly motion: Motion,
    private readonly loop: Loop,
  ) {}

  /** Requests a new picture. */
  redraw(): void {
    this.dirty = true;
    this.wake();
  }

  /** Starts the loop if it does not run. Call this method when motion may have begun. */
  wake(): void {
    if (this.request !== 0 || !this.visible) return;
    this.last = performance.now();
    this.ask();
  }

  /** Draws the next picture now, without waiting for the browser's next frame. */
  now(): void {
    this.tick(performance.now());
  }

  /** Sets whether the element is in sight. While it is out of sight, no picture is drawn. */
  show(visible: boolean): void {
    if (visible === this.visible) return;
    this.visible = visible;
    if (visible) this.redraw();
    else this.stop();
  }

  stop(): void {
    cancelAnimationFrame(this.request);
    this.request = 0;
    clearTimeout(this.idle);
  }

  private ask(): void {
    this.request = requestAnimationFrame((now) => {
      this.request = 0;
      this.tick(now);
    });
  }

  private tick(now: number): void {
    const dtS = Math.max((now - this.last) / 1000, 0);
    this.last = now;
    if (!this.visible || !this.loop.can()) return;
    const moved = this.motion.step(dtS);
    const { on, changed } = this.loop.play(dtS);
    if (this.dirty || moved || changed) {
      this.dirty = false;
      this.loop.draw();
    }
    if (this.request !== 0) return;
    if (this.motion.active || on || this.dirty) this.ask();
    else this.waitForSwing();
  }

  private waitForSwing(): void {
    clearTimeout(this.idle);
    const wait = this.motion.untilSwingS;
    if (wait === undefined) return;
    this.idle = setTimeout(() => {
      this.motion.swingNow();
      this.wake();
    }, wait * 1000);
  }
}
