// The state in the page's address, so that a link shows the same view.
import { toHash, type Slope, type State } from "./state.js";

/** Milliseconds between two changes of the address, since browsers limit the rate of such changes. */
const REST_MS = 400;

export class Address {
  private timer: ReturnType<typeof setTimeout> | undefined;

  /**
   * Returns `#` and the text that describes a state; an empty text if all values are defaults. The
   * text includes the viewing position, unless `state.swing` is true or the view looks straight
   * ahead. With `always` the text always includes the position.
   */
  static hash(state: State, slope: Slope, always: boolean): string {
    const still = always || (!state.swing && slope.some((value) => value !== 0));
    const text = toHash(state, still ? slope : undefined);
    return text ? `#${text}` : "";
  }

  write(state: () => State, slope: () => Slope): void {
    this.timer ??= setTimeout(() => {
      this.timer = undefined;
      try {
        history.replaceState(history.state, "", `${location.pathname}${location.search}${Address.hash(state(), slope(), false)}`);
      } catch {
        // A page that was opened from a file may not change its address.
      }
    }, REST_MS);
  }

  stop(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
  }
}
