// The input of the solver: a scene among dropped files, or one of the page's own.
import { Problem } from "../problem.js";
import scenes from "./scenes.json";

export interface Input {
  /** Content by path; the solver's thread reads it, so that the page copies none. */
  files: [path: string, content: Blob][];
  /** Path of the scene. */
  path: string;
  title: string;
  /** Name of a scene of the page. */
  builtIn?: string;
}

/** Scenes of the page: files below `scenes/NAME/`, the scene first. */
export const SCENES: Readonly<Record<string, { title: string; files: readonly string[] }>> = scenes;

/** Limit for the input: the module has 4 GiB for everything. */
const MOST_BYTES = 600e6;
const MODEL = /\.(glb|gltf|ply|spz|sog)$/i;
const WANTED = "Drop a .glb, a .gltf with its files, or a capture (.ply, .spz, .sog).";

export async function builtIn(name: string): Promise<Input> {
  const scene = SCENES[name];
  if (!scene) throw new Problem(`There is no scene “${name}” in this page.`, `There are ${Object.keys(SCENES).join(", ")}.`, false);
  const files = scene.files.map(async (file): Promise<[string, Blob]> => {
    const response = await fetch(new URL(`scenes/${name}/${file}`, import.meta.url));
    if (!response.ok) throw new Problem(`scenes/${name}/${file} could not be fetched: the server answers ${response.status}.`, "See that the folder scenes lies beside this page.", false);
    return [file, await response.blob()];
  });
  return { files: await Promise.all(files), path: scene.files[0]!, title: scene.title, builtIn: name };
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
  const bytes = needed.reduce((sum, name) => sum + files.get(name)!.size, 0);
  if (bytes > MOST_BYTES) {
    throw new Problem(`${path}: expected at most ${MOST_BYTES / 1e6} MB, found ${Math.round(bytes / 1e6)} MB.`, "The command takes more: lumistack run.", false);
  }
  const name = path.slice(base.length);
  return { files: needed.map((name) => [name.slice(base.length), files.get(name)!]), path: name, title: name.replace(/\.[^.]*$/, "") };
}

export function nothing(files: ReadonlyMap<string, File>): Problem {
  return new Problem(files.size === 0 ? "Nothing arrived: no files in what was dropped." : `There is no model among the ${files.size === 1 ? "one file" : `${files.size} files`}.`, WANTED, false);
}

function depth(path: string): number {
  return path.split("/").length;
}
