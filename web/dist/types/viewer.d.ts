import { LumistackViewer } from "./element.js";
export { LumistackViewer };
export type { LumistackErrorDetail } from "./element.js";
export type { Comparison, Mode, Path, Slope } from "./state.js";
declare global {
    interface HTMLElementTagNameMap {
        "lumistack-viewer": LumistackViewer;
    }
}
