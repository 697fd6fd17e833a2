// Finds the input of the solver: a scene or light field among dropped files, or one of the scenes
// that come with the page.
import { Problem } from "../problem.js";
import scenes from "./scenes.json";

export interface Input {
  /** Path and content of each file. The solver's thread, not the page, reads the content. */
  files: [path: string, content: Blob][];
  /** Path of the scene, or of the light field's file or folder. */
  path: string;
  title: string;
  isField: boolean;
  /** Name of the scene, if it comes with the page. */
  builtIn?: string;
}

/** The scenes that come with the page. Their files are in `scenes/NAME/`; the first file is the scene's main file. */
export const SCENES: Readonly<Record<string, { title: string; files: readonly string[] }>> = scenes;

/** Largest size of the input. The solver's module has at most 4 GiB of memory for all its data. */
const MOST_BYTES = 600e6;
const MODEL = /\.(glb|gltf|ply|spz|sog)$/i;
/** Pattern of files of light fields. `lightfield.json` is the index of a folder that the command wrote. */
const FIELD = /\.(png|jpe?g|webp|hdr|exr|npy)$|(^|\/)lightfield\.json$/i;
const WANTED = "Drop a .glb, a .gltf with its files, a capture (.ply, .spz, .sog), a quilt, an .npy, or a folder of views.";

export async function builtIn(name: string): Promise<Input> {
  const scene = SCENES[name];
  if (!scene) throw new Problem(`There is no scene “${name}” in this page.`, `The scenes are ${Object.keys(SCENES).join(", ")}.`, false);
  const files = scene.files.map(async (file): Promise<[string, Blob]> => {
    const response = await fetch(new URL(`scenes/${name}/${file}`, import.meta.url));
    if (!response.ok) throw new Problem(`scenes/${name}/${file} could not be fetched: the server answers ${response.status}.`, "Check that the folder scenes is in the folder of this page.", false);
    return [file, await response.blob()];
  });
  return { files: await Promise.all(files), path: scene.files[0]!, title: scene.title, isField: false, builtIn: name };
}

/** Finds a scene among dropped files; returns undefined if there is none. */
export function dropped(files: ReadonlyMap<string, File>): Input | undefined {
  const paths = [...files.keys()];
  const models = paths.filter((path) => MODEL.test(path) || /(^|\/)meta\.json$/.test(path)).sort((a, b) => depth(a) - depth(b) || a.localeCompare(b));
  const path = models[0];
  if (path === undefined) return undefined;
  const base = path.replace(/[^/]*$/, "");
  const beside = paths.filter((other) => other.startsWith(base));
  // Only .gltf and meta.json refer to other files; all other scenes are single files.
  const needed = /\.(gltf|json)$/i.test(path) ? beside : [path];
  return { ...held(files, needed, base, path), isField: false };
}

/**
 * Finds a light field among dropped files. A light field is a single file, a folder with an index
 * file, or a folder of pictures. The solver determines its kind. Returns undefined if no file has
 * the extension of a light field.
 */
export function droppedField(files: ReadonlyMap<string, File>): Input | undefined {
  const paths = [...files.keys()].filter((path) => FIELD.test(path)).sort((a, b) => depth(a) - depth(b) || a.localeCompare(b));
  if (paths.length === 0) return undefined;
  if (files.size === 1) return { ...held(files, paths, paths[0]!.replace(/[^/]*$/, ""), paths[0]!), isField: true };
  const index = paths.find((path) => path.endsWith("lightfield.json"));
  const folder = (index === undefined ? paths : [index]).map((path) => path.split("/").slice(0, -1)).reduce(common);
  const within = [...folder, ""].join("/").replace(/^\/$/, "");
  const inside = [...files.keys()].filter((path) => path.startsWith(within));
  const base = [...folder.slice(0, -1), ""].join("/").replace(/^\/$/, "");
  return { ...held(files, inside, base, folder.length > 0 ? folder.join("/") : "."), isField: true };
}

function common(a: string[], b: string[]): string[] {
  const end = a.findIndex((part, i) => part !== b[i]);
  return end < 0 ? a : a.slice(0, end);
}

/** Returns the needed files, without the folder `base` in their paths. Throws a Problem if they are too large. */
function held(files: ReadonlyMap<string, File>, needed: readonly string[], base: string, path: string): Pick<Input, "files" | "path" | "title"> {
  const bytes = needed.reduce((sum, name) => sum + files.get(name)!.size, 0);
  if (bytes > MOST_BYTES) {
    throw new Problem(`${path}: expected at most ${MOST_BYTES / 1e6} MB, found ${Math.round(bytes / 1e6)} MB.`, "The command “lumistack run” accepts larger files.", false);
  }
  const name = path.slice(base.length);
  const title = name === "." ? "Light field" : name.replace(/(_qs\d+x\d+[^.]*(\.\d+)?)?\.[^.]*$/, "");
  return { files: needed.map((name) => [name.slice(base.length), files.get(name)!]), path: name, title };
}

export function nothing(files: ReadonlyMap<string, File>): Problem {
  return new Problem(files.size === 0 ? "The drop contains no files." : `There is nothing to solve in ${files.size === 1 ? "this file" : `these ${files.size} files`}.`, WANTED, false);
}

function depth(path: string): number {
  return path.split("/").length;
}
