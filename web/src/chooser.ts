// Opens files that the user drops on the element or chooses in its dialog.
import { filesByName, filesOf } from "./drop.js";
import { Problem, problemOf } from "./problem.js";

type Open = (files: ReadonlyMap<string, File>) => Promise<void>;

export function listenToDrops(element: HTMLElement, overlay: HTMLElement, open: Open, refuse: (problem: Problem) => void): void {
  const holdsFiles = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
  let depth = 0;
  const show = (to: number): void => {
    depth = Math.max(to, 0);
    overlay.hidden = depth === 0;
  };
  element.addEventListener("dragenter", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    show(depth + 1);
  });
  element.addEventListener("dragover", (event) => {
    if (holdsFiles(event)) event.preventDefault();
  });
  element.addEventListener("dragleave", () => show(depth - 1));
  element.addEventListener("drop", (event) => {
    if (!event.dataTransfer) return;
    event.preventDefault();
    show(0);
    void filesOf(event.dataTransfer).then(open, (error: unknown) =>
      refuse(new Problem(`The dropped files could not be read: ${problemOf(error, "").message}`, "Try again, or choose the files with the folder button.", false)),
    );
  });
}

export function listenToChooser(at: (id: string) => HTMLElement, open: Open): void {
  const dialog = at("chooser") as HTMLDialogElement;
  for (const id of ["open", "card-open"]) at(id).addEventListener("click", () => dialog.showModal());
  for (const [id, from] of [
    ["files", "choose-files"],
    ["folder", "choose-folder"],
  ] as const) {
    const input = at(id) as HTMLInputElement;
    at(from).addEventListener("click", () => input.click());
    input.addEventListener("change", () => {
      dialog.close();
      if (input.files?.length) void open(filesByName(input.files));
      input.value = "";
    });
  }
}
