// Makes the page's viewer follow `lumistack live`: asks for the newest state and shows it, without loading the page again.
//
// A state comes whole, in one answer: u32 length of JSON | JSON | files, one after another, in the order of preview.json. The viewer's attribute
// `data-state` has the number of the state on show.
import type { LumistackViewer } from "./element.js";

interface Head {
  number: number;
  /** Lasts as long as preview.json stays the same. */
  edition: string;
  /** Length of every file. */
  files: number[];
  /** The text of preview.json, where this page has another edition. */
  preview: string | null;
}

/** Milliseconds before somebody who does not answer is asked again. */
const AGAIN_MS = 500;

async function follow(viewer: LumistackViewer): Promise<never> {
  let [number, edition] = [0, ""];
  for (;;) {
    try {
      const response = await fetch(`.live?after=${number}&edition=${edition}`, { cache: "no-store" });
      if (response.status === 204) continue;
      if (!response.ok) throw new Error(response.statusText);
      const [head, files] = taken(await response.arrayBuffer());
      if (head.preview === null) await viewer.renew(files);
      else await viewer.open(previewOf(head.preview, files));
      ({ number, edition } = head);
      viewer.dataset.state = String(number);
      delete viewer.dataset.waits;
    } catch {
      // The program has ended, or is about to start again: what is on show stays.
      viewer.dataset.waits = "";
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }
}

function taken(frame: ArrayBuffer): [Head, ArrayBuffer[]] {
  const length = new DataView(frame).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length))) as Head;
  let at = 4 + length;
  return [head, head.files.map((bytes) => frame.slice(at, (at += bytes)))];
}

/** The files of a preview, as if they had been dropped on the page. */
function previewOf(json: string, files: readonly ArrayBuffer[]): Map<string, File> {
  const preview = JSON.parse(json) as { files: { path: string }[]; poster?: string; around?: unknown };
  // Pictures that stand in for patterns that load are of no use where all are there.
  delete preview.poster;
  delete preview.around;
  const named = preview.files.map(({ path }, i) => [path, new File([files[i]!], path)] as const);
  const text = new File([JSON.stringify(preview)], "preview.json");
  return new Map([["stack/preview.json", text], ...named]);
}

await customElements.whenDefined("lumistack-viewer");
const viewer = document.querySelector("lumistack-viewer");
if (viewer) void follow(viewer);
