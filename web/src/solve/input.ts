// The input of the solver: a scene or a light field among dropped files, or a scene of the page.
import { Problem } from "../problem.js";
import scenes from "./scenes.json";

export interface Input {
  /** Content by path; the solver's thread reads it, so that the page copies none. */
  files: [path: string, content: Blob][];
  /** Path of the scene, or of the light field's file or folder. */
  path: string;
  title: string;
  isField: boolean;
  /** Name of a scene of the page. */
  builtIn?: string;
}

/** Scenes of the page: files below `scenes/NAME/`, the scene first. */
export const SCENES: Readonly<Record<string, { title: string; files: readonly string[] }>> = scenes;

/** Limit for the input: the module has 4 GiB for everything. */
const MOST_BYTES = 600e6;
const MODEL = /\.(glb|gltf|ply|spz|sog)$/i;
/** Files of light fields; `lightfield.json` is the index of a folder of ours. */
const FIELD = /\.(png|jpe?g|webp|hdr|exr|npy)$|(^|\/)lightfield\.json$/i;
const WANTED = "Drop a .glb, a .gltf with its files, a capture (.ply, .spz, .sog), a quilt, an .npy, or a folder of views.";

export async function builtIn(name: string): Promise<Input> {
  const scene = SCENES[name];
  if (!scene) throw new Problem(`There is no scene “${name}” in this page.`, `There are ${Object.keys(SCENES).join(", ")}.`, false);
  const files = scene.files.map(async (file): Promise<[string, Blob]> => {
    const response = await fetch(new URL(`scenes/${name}/${file}`, import.meta.url));
    if (!response.ok) throw new Problem(`scenes/${name}/${file} could not be fetched: the server answers ${response.status}.`, "See that the folder scenes lies beside this page.", false);
    return [file, await response.blob()];
  });
  return { files: await Promise.all(files), path: scene.files[0]!, title: scene.title, isField: false, builtIn: name };
}

/** The scene among dropped files; undefined for content that is shown unchanged. */
export function dropped(files: ReadonlyMap<string, File>): Input | undefined {
  const paths = [...files.keys()];
  const models = paths.filter((path) => MODEL.test(path) || /(^|\/)meta\.json$/.test(path)).sort((a, b) => depth(a) - depth(b) || a.localeCompare(b));
  const path = models[0];
  if (path === undefined) return undefined;
  const base = path.replace(/[^/]*$/, "");
  const beside = paths.filter((other) => other.startsWith(base));
  // A model in one file needs no other file.
  const needed = /\.(gltf|json)$/i.test(path) ? beside : [path];
  return { ...held(files, needed, base, path), isField: false };
}

/**
 * The light field among dropped files: the one file, or the folder of its index or of all its
 * pictures. Its readers find out its kind. Undefined if there is nothing to read.
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

/** The needed files with paths from `base` on. */
function held(files: ReadonlyMap<string, File>, needed: readonly string[], base: string, path: string): Pick<Input, "files" | "path" | "title"> {
  const bytes = needed.reduce((sum, name) => sum + files.get(name)!.size, 0);
  if (bytes > MOST_BYTES) {
    throw new Problem(`${path}: expected at most ${MOST_BYTES / 1e6} MB, found ${Math.round(bytes / 1e6)} MB.`, "The command takes more: lumistack run.", false);
  }
  const name = path.slice(base.length);
  const title = name === "." ? "Light field" : name.replace(/(_qs\d+x\d+[^.]*(\.\d+)?)?\.[^.]*$/, "");
  return { files: needed.map((name) => [name.slice(base.length), files.get(name)!]), path: name, title };
}

export function nothing(files: ReadonlyMap<string, File>): Problem {
  return new Problem(files.size === 0 ? "Nothing arrived: no files in what was dropped." : `There is nothing to solve among the ${files.size === 1 ? "one file" : `${files.size} files`}.`, WANTED, false);
}

function depth(path: string): number {
  return path.split("/").length;
}
