// The package's entry point: defines <lumistack-viewer>.
import { LumistackViewer } from "./element.js";

export { LumistackViewer };
export type { LumistackErrorDetail } from "./element.js";
export type { Comparison, Mode, Path, Slope } from "./state.js";

if (!customElements.get("lumistack-viewer")) customElements.define("lumistack-viewer", LumistackViewer);

declare global {
  interface HTMLElementTagNameMap {
    "lumistack-viewer": LumistackViewer;
  }
}
