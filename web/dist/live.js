

const AGAIN_MS = 500;

async function follow(viewer) {
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
      viewer.dataset.waits = "";
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }
}

function taken(frame) {
  const length = new DataView(frame).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length)));
  let at = 4 + length;
  return [head, head.files.map((bytes) => frame.slice(at, (at += bytes)))];
}

function previewOf(json, files) {
  const preview = JSON.parse(json);
  delete preview.poster;
  delete preview.around;
  const named = preview.files.map(({ path }, i) => [path, new File([files[i]], path)]);
  const text = new File([JSON.stringify(preview)], "preview.json");
  return new Map([["stack/preview.json", text], ...named]);
}

await customElements.whenDefined("lumistack-viewer");
const viewer = document.querySelector("lumistack-viewer");
if (viewer) void follow(viewer);
