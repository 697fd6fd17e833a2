// The viewing position. It follows a goal like a mass on a spring. Pointer, touch, keys, tilt and
// the swing of an idle view set the goal.
import type { Slope } from "./state.js";

/** Stiffness of the spring divided by the mass, s⁻², and damping of the spring as a fraction of critical damping. */
const STIFFNESS = 130;
const DAMPING = 0.92;
/** Largest slope to which input moves the view, in half widths of the zone. */
export const REACH = 1.4;
/** Time without input after which the view swings, and duration of one swing to and fro, seconds. */
const IDLE_S = 4;
const PERIOD_S = 8;
/** Amplitudes of the swing along x and y, in half widths of the zone. */
const SWING: Slope = [0.78, 0.3];
/** At the end of a drag, the goal is where the eye would be after this time at its speed, s. */
const FLING_S = 0.22;

export class Motion {
  /** The eye's position as a slope. */
  private at: [number, number] = [0, 0];
  private speed: [number, number] = [0, 0];
  private last: Slope = [0, 0];
  /** The slope towards which the spring pulls the eye. */
  private goal: [number, number] = [0, 0];
  private zone: Slope = [1, 1];
  /** Seconds since the last input. It starts at `IDLE_S`, so that the view swings immediately. */
  private quietS = IDLE_S;
  private phaseS = 0;
  private held = false;
  private swinging = false;
  /** True if the view swings when idle. */
  swing = true;
  /** True if the user prefers less motion: the eye then jumps to its goal without the spring. */
  calm = false;
  /** True until the first input of the user, or until a slope is set. */
  fresh = true;
  /** Seconds since the start of a recorded turn around the viewing zone; undefined without a turn. */
  private turnS: number | undefined;
  private turnLengthS = 0;
  /** The goal before a recorded turn, to which the eye returns after the turn. */
  private home: [number, number] = [0, 0];

  setZone(zone: Slope): void {
    this.zone = zone;
  }

  get slope(): Slope {
    return [this.at[0], this.at[1]];
  }

  /** True while the spring, a swing or a turn moves the eye. */
  get active(): boolean {
    const restless = [0, 1].some((i) => Math.abs(this.goal[i]! - this.at[i]!) > 2e-5 || Math.abs(this.speed[i]!) > 2e-5);
    return restless || this.swinging || this.turnS !== undefined;
  }

  /** Seconds until the swing begins; undefined if the view already swings or may not swing. */
  get untilSwingS(): number | undefined {
    return this.swing && !this.held && !this.swinging ? Math.max(IDLE_S - this.quietS, 0) : undefined;
  }

  /** Moves the eye to a slope, limited to REACH half widths of the zone. */
  lookTo(slope: Slope): void {
    this.input();
    for (const i of [0, 1] as const) {
      const most = this.zone[i] * REACH;
      this.goal[i] = Math.min(Math.max(slope[i], -most), most);
    }
    if (this.calm) this.settle();
  }

  lookBy(step: Slope): void {
    this.lookTo([this.goal[0] + step[0], this.goal[1] + step[1]]);
  }

  /** Moves the eye to a slope immediately, and ends the swing. */
  standAt(slope: Slope): void {
    this.swing = false;
    this.input();
    this.goal = [slope[0], slope[1]];
    this.settle();
  }

  /** Called when a finger or a mouse button is pressed. The view does not swing until the release. */
  hold(): void {
    this.held = true;
    this.input();
  }

  release(fling: boolean): void {
    this.held = false;
    if (fling && !this.calm) this.lookTo([this.at[0] + this.speed[0] * FLING_S, this.at[1] + this.speed[1] * FLING_S]);
  }

  /** Called after input that moves the view. Ends a swing or a turn, and restarts the idle time. */
  input(): void {
    this.fresh = false;
    this.quietS = 0;
    this.swinging = false;
    this.turnS = undefined;
  }

  /** Called after input that does not move the view. Ends a swing, and restarts the idle time. */
  touched(): void {
    this.fresh = false;
    this.quietS = 0;
    this.swinging = false;
  }

  /** Makes the swing begin at the next step, without waiting for the idle time. */
  swingNow(): void {
    this.quietS = IDLE_S;
  }

  /**
   * Starts one turn of `lengthS` seconds around the viewing zone, which begins and ends at the
   * zone's left. After the turn the eye returns to its previous goal.
   */
  startTurn(lengthS: number): void {
    this.input();
    this.home = [this.goal[0], this.goal[1]];
    this.turnS = 0;
    this.turnLengthS = lengthS;
    this.goal = this.turnAt(0);
    this.settle();
  }

  /** Advances by `dtS` seconds; returns true if the slope has changed. */
  step(dtS: number): boolean {
    const dt = Math.min(dtS, 0.1);
    if (this.turnS !== undefined) {
      this.turnS += dtS;
      this.goal = this.turnAt(Math.min(this.turnS / this.turnLengthS, 1));
      this.settle();
      if (this.turnS >= this.turnLengthS) {
        this.turnS = undefined;
        this.goal = this.home;
        if (this.calm) this.settle();
      }
    } else {
      this.idle(dtS);
      this.spring(dt);
    }
    const changed = this.last[0] !== this.at[0] || this.last[1] !== this.at[1];
    this.last = this.slope;
    return changed;
  }

  private idle(dtS: number): void {
    this.quietS += dtS;
    if (!this.swing || this.held || this.quietS < IDLE_S) return;
    if (!this.swinging) {
      this.swinging = true;
      const side = this.at[0] / (this.zone[0] * SWING[0]);
      this.phaseS = (Math.asin(Math.min(Math.max(side, -1), 1)) / (2 * Math.PI)) * PERIOD_S;
    }
    this.phaseS += dtS;
    this.goal = this.turnAt(this.phaseS / PERIOD_S - 0.25);
  }

  /** Returns the slope on the path of a turn, a flat ellipse around the zone's middle. `turn` is 0 at the ellipse's left end and 1 after a round. */
  private turnAt(turn: number): [number, number] {
    const angle = 2 * Math.PI * turn;
    return [-Math.cos(angle) * SWING[0] * this.zone[0], Math.sin(angle) * SWING[1] * this.zone[1]];
  }

  private spring(dt: number): void {
    const steps = Math.ceil(dt / 0.008);
    const h = dt / Math.max(steps, 1);
    const damping = 2 * DAMPING * Math.sqrt(STIFFNESS);
    for (let n = 0; n < steps; n++) {
      for (const i of [0, 1] as const) {
        this.speed[i] += (STIFFNESS * (this.goal[i] - this.at[i]) - damping * this.speed[i]) * h;
        this.at[i] += this.speed[i] * h;
      }
    }
    if (!this.swinging && !this.restless()) this.settle();
  }

  private restless(): boolean {
    return [0, 1].some((i) => Math.abs(this.goal[i]! - this.at[i]!) > 1e-5 || Math.abs(this.speed[i]!) > 1e-5);
  }

  private settle(): void {
    this.at = [this.goal[0], this.goal[1]];
    this.speed = [0, 0];
  }
}

/** Converts the tilt of a phone to a slope. The phone's pose at the start gives the slope 0. */
export class Tilt {
  private rest: { beta: number; gamma: number } | undefined;
  private listener: ((event: DeviceOrientationEvent) => void) | undefined;

  /** True if this device may report its orientation. */
  static get possible(): boolean {
    return typeof DeviceOrientationEvent !== "undefined" && matchMedia("(pointer: coarse)").matches && isSecureContext;
  }

  get on(): boolean {
    return this.listener !== undefined;
  }

  /**
   * Starts to report slopes; returns false if the user or the device refuses. The call must come
   * from a click, since some browsers then request the user's permission.
   */
  async start(report: (slope: Slope) => void): Promise<boolean> {
    const asks = DeviceOrientationEvent as unknown as { requestPermission?: () => Promise<string> };
    if (asks.requestPermission && (await asks.requestPermission()) !== "granted") return false;
    this.rest = undefined;
    return new Promise((resolve) => {
      const timer = setTimeout(() => {
        this.stop();
        resolve(false);
      }, 1500);
      this.listener = (event) => {
        if (event.beta === null || event.gamma === null) return;
        clearTimeout(timer);
        resolve(true);
        report(this.slopeOf(event.beta, event.gamma));
      };
      addEventListener("deviceorientation", this.listener);
    });
  }

  stop(): void {
    if (this.listener) removeEventListener("deviceorientation", this.listener);
    this.listener = undefined;
  }

  private slopeOf(beta: number, gamma: number): Slope {
    this.rest ??= { beta, gamma };
    // The pose that stands for slope 0 slowly follows the current pose. So the user may change
    // position.
    this.rest.beta += (beta - this.rest.beta) * 0.004;
    this.rest.gamma += (gamma - this.rest.gamma) * 0.004;
    const tan = (degrees: number): number => Math.tan((Math.min(Math.max(degrees, -60), 60) * Math.PI) / 180);
    const side = -tan(gamma - this.rest.gamma);
    const tip = tan(beta - this.rest.beta);
    const turned = ((screen.orientation?.angle ?? 0) * Math.PI) / 180;
    // Rotate the slope from the device's axes to the screen's axes. If the device is turned by 90°
    // anticlockwise, its right edge points up and its top points to the left.
    return [side * Math.cos(turned) - tip * Math.sin(turned), tip * Math.cos(turned) + side * Math.sin(turned)];
  }
}
