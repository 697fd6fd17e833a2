// Makes the page's viewer follow `lumistack live`: requests the newest state and shows it without a
// reload of the page.
//
// A state is one answer: u32 length of JSON | JSON | files in the order of preview.json. The
// viewer's attribute `data-state` is the number of the current state.
import type { LumistackViewer } from "./element.js";

interface Head {
  number: number;
  /** Stays the same as long as preview.json does. */
  edition: string;
  /** Length of every file. */
  files: number[];
  /** The text of preview.json, if this page has another edition. */
  preview: string | null;
}

/** Milliseconds before a failed request is repeated. */
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
      // The program has ended, or will restart: the current content stays.
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

/** The files of a preview, in the form of dropped files. */
function previewOf(json: string, files: readonly ArrayBuffer[]): Map<string, File> {
  const preview = JSON.parse(json) as { files: { path: string }[]; poster?: string; around?: unknown };
  // Pictures for the time of loading are not needed, since all patterns are present.
  delete preview.poster;
  delete preview.around;
  const named = preview.files.map(({ path }, i) => [path, new File([files[i]!], path)] as const);
  const text = new File([JSON.stringify(preview)], "preview.json");
  return new Map([["stack/preview.json", text], ...named]);
}

await customElements.whenDefined("lumistack-viewer");
const viewer = document.querySelector("lumistack-viewer");
if (viewer) void follow(viewer);
