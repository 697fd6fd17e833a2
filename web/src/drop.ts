// Recognizes the kind of dropped or chosen files: a preview, a run folder with a preview, a quilt,
// or the views of a light field.
import { Problem } from "./problem.js";

export type Dropped =
  | { kind: "preview"; files: ReadonlyMap<string, File>; json: string }
  | { kind: "quilt"; file: File; cols: number; rows: number; aspect: number | undefined; title: string }
  | { kind: "views"; views: readonly (readonly File[])[]; title: string };

const PICTURE = /\.(png|jpe?g|webp|avif|gif|bmp)$/i;
const QUILT = /_qs(\d+)x(\d+)(?:a([0-9.]+?))?\.[a-z]+$/i;
/** Patterns of names with a view's row and column: view_03_07.png, out_00_05_-381.9_1017.5_.png, 3_7.png. */
const ROW_COL = [/^view[_-](\d+)[_-](\d+)\b/i, /^out[_-](\d+)[_-](\d+)[_-]/i, /(\d+)[_-](\d+)\.[a-z]+$/i];
/** Pattern of names that end in a number, which counts the views row by row: input_Cam004.png. */
const RUNNING = /(\d+)\.[a-z]+$/i;
const MOST_FILES = 20000;

/**
 * Returns the dropped files by path, including the files in dropped folders. The search in folders
 * ends after MOST_FILES + 1 files.
 */
export async function filesOf(transfer: DataTransfer): Promise<Map<string, File>> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  const files = new Map<string, File>();
  if (entries.every((entry) => entry === null)) return filesByName(transfer.files);
  const walk = async (entry: FileSystemEntry): Promise<void> => {
    if (files.size > MOST_FILES) return;
    if (entry.isFile) {
      const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
      files.set(entry.fullPath.replace(/^\//, ""), file);
    } else {
      const reader = (entry as FileSystemDirectoryEntry).createReader();
      const read = (): Promise<FileSystemEntry[]> => new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      for (let batch = await read(); batch.length > 0; batch = await read()) for (const inner of batch) await walk(inner);
    }
  };
  for (const entry of entries) if (entry) await walk(entry);
  return files;
}

export function filesByName(list: Iterable<File>): Map<string, File> {
  return new Map([...list].map((file) => [file.webkitRelativePath || file.name, file]));
}

/**
 * Returns the kind of the files. If the files are of no known kind, it throws a Problem that states
 * the expected and the found files.
 */
export function recognize(files: ReadonlyMap<string, File>): Dropped {
  if (files.size === 0) throw new Problem("The drop contains no files.", WANTED, false);
  const json = [...files.keys()].filter((path) => /(^|\/)preview\.json$/.test(path)).sort((a, b) => a.length - b.length)[0];
  if (json !== undefined) return { kind: "preview", files, json };
  const pictures = [...files.entries()].filter(([path]) => PICTURE.test(path));
  const quilts = pictures.filter(([path]) => QUILT.test(path));
  if (quilts.length > 0 && quilts.length === pictures.length) return quiltOf(quilts[0]![1]);
  const views = pictures.filter(([path]) => !QUILT.test(path));
  if (views.length >= 2) return { kind: "views", views: gridOf(views), title: folderOf(views[0]![0]) ?? "Light field" };
  if (quilts.length > 0) return quiltOf(quilts[0]![1]);
  throw new Problem(refusal(files), WANTED, false);
}

const WANTED =
  "Drop a preview folder, a run folder with a preview, a quilt whose name ends in _qsCOLUMNSxROWSaASPECT.png, or a folder with views as PNG or JPEG.";

function refusal(files: ReadonlyMap<string, File>): string {
  const paths = [...files.keys()];
  if (paths.some((path) => /(^|\/)layers\/stack\.json$/.test(path))) return "This run folder has no preview. “lumistack preview” with this folder writes a preview.";
  if (paths.some((path) => /\.exr$/i.test(path))) return "These views are OpenEXR files, which browsers cannot read. The plugin “images” writes views as PNG.";
  if (paths.length === 1 && PICTURE.test(paths[0]!)) return `${paths[0]} is a single picture, and the picture's name does not state the number of views.`;
  return `There is no preview.json and no picture among the dropped files (${paths.length}).`;
}

function quiltOf(file: File): Dropped {
  const found = QUILT.exec(file.name)!;
  const [cols, rows] = [Number(found[1]), Number(found[2])];
  if (!(cols >= 1 && rows >= 1 && cols * rows >= 2)) throw new Problem(`${file.name}: the name states ${cols} × ${rows} views; expected at least two views.`, WANTED, false);
  const aspect = Number(found[3]);
  return { kind: "quilt", file, cols, rows, aspect: aspect > 0 ? aspect : undefined, title: file.name.replace(QUILT, "") };
}

/**
 * Arranges views by their names in a grid: rows from the top, columns from the left. If the names
 * do not state a complete grid, the views have the order of their names. Then they form a square,
 * if every name ends in a number and the number of views is a square. Otherwise they form one row.
 * If two names state the same view, it throws a Problem that names both files.
 */
export function gridOf(pictures: readonly (readonly [string, File])[]): File[][] {
  const named = pictures.map(([path, file]) => ({ path, file, name: path.replace(/^.*\//, "") })).sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  for (const pattern of ROW_COL) {
    const found = named.map(({ name }) => pattern.exec(name));
    if (!found.every((match) => match)) continue;
    const places = found.map((match) => [Number(match![1]), Number(match![2])] as const);
    // Names with the same text before the same row and column state the same view.
    const first = new Map<string, string>();
    places.forEach(([row, col], i) => {
      const { name, path } = named[i]!;
      const view = `${name.slice(0, found[i]!.index)} ${row} ${col}`;
      const other = first.get(view);
      if (other !== undefined) throw new Problem(`${other} and ${path} are both named as the view in row ${row}, column ${col}; expected one picture per view.`, "Remove one of the two files, and try again.", false);
      first.set(view, path);
    });
    const rows = [...new Set(places.map(([row]) => row))].sort((a, b) => a - b);
    const cols = [...new Set(places.map(([, col]) => col))].sort((a, b) => a - b);
    if (rows.length * cols.length !== named.length || new Set(places.map(String)).size !== named.length) continue;
    const grid: File[][] = rows.map(() => []);
    places.forEach(([row, col], i) => (grid[rows.indexOf(row)]![cols.indexOf(col)] = named[i]!.file));
    return grid;
  }
  const running = named.every(({ name }) => RUNNING.test(name));
  const side = Math.round(Math.sqrt(named.length));
  if (running && side * side === named.length) return Array.from({ length: side }, (_, row) => named.slice(row * side, (row + 1) * side).map(({ file }) => file));
  return [named.map(({ file }) => file)];
}

function folderOf(path: string): string | undefined {
  return path.split("/").slice(-2, -1)[0];
}
