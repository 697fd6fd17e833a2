// Sources of a preview: a server, the page itself, or dropped files.
import { Problem, REWRITE } from "./problem.js";

export interface Source {
  /** The text of preview.json. */
  json(): Promise<string>;
  /** Reads a file that preview.json names. */
  bytes(path: string, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>>;
  /** An address for a picture that preview.json names. */
  address(path: string): Promise<string>;
}

declare global {
  interface Window {
    /** Path → base64, for a preview in a single file; "wasm" is the module. */
    LUMISTACK_INLINE?: Record<string, string>;
  }
}

export function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/**
 * A preview beside its preview.json on a server; paths are relative to the parent of that file's
 * folder.
 */
export class ServerSource implements Source {
  private readonly url: URL;

  constructor(src: string) {
    this.url = new URL(src, document.baseURI);
  }

  async json(): Promise<string> {
    return (await this.fetch(this.url, undefined)).text();
  }

  async bytes(path: string, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    const response = await this.fetch(new URL(path, new URL("..", this.url)), signal);
    return new Uint8Array(await response.arrayBuffer());
  }

  async address(path: string): Promise<string> {
    return new URL(path, new URL("..", this.url)).href;
  }

  private async fetch(url: URL, signal: AbortSignal | undefined): Promise<Response> {
    let response: Response;
    try {
      response = await fetch(url, signal ? { signal } : {});
    } catch (error) {
      if (signal?.aborted) throw error;
      throw url.protocol === "file:"
        ? new Problem(
            `The browser does not load ${shortName(url)} from disk.`,
            "Open preview.html instead, which holds everything in one file, or serve the folder with “lumistack preview”.",
          )
        : new Problem(`${shortName(url)} could not be fetched: no answer from ${url.host}.`, "See that the server still runs, then load this page again.");
    }
    if (response.ok) return response;
    throw response.status === 404
      ? new Problem(`${shortName(url)} is missing: ${url.host} answers 404.`, REWRITE)
      : new Problem(`${shortName(url)} could not be fetched: ${url.host} answers ${response.status}.`, "See what the server says, then load this page again.");
  }
}

/** A preview inside the page. */
export class InlineSource implements Source {
  constructor(
    private readonly files: Record<string, string>,
    private readonly src: string,
  ) {}

  async json(): Promise<string> {
    return new TextDecoder().decode(await this.bytes(this.src));
  }

  async bytes(path: string): Promise<Uint8Array<ArrayBuffer>> {
    const text = this.files[path];
    if (text === undefined) throw new Problem(`${path} is missing in this page.`, REWRITE);
    return fromBase64(text);
  }

  async address(path: string): Promise<string> {
    return `data:image/jpeg;base64,${this.files[path]}`;
  }
}

/** The source for the attribute `src`. */
export function sourceOf(src: string): Source {
  const inline = window.LUMISTACK_INLINE;
  return inline && src in inline ? new InlineSource(inline, src) : new ServerSource(src);
}

/** A preview among dropped files: path → file, with preview.json at `json_path`. */
export class FilesSource implements Source {
  private readonly base: string;

  constructor(
    private readonly files: ReadonlyMap<string, File>,
    private readonly jsonPath: string,
  ) {
    const folders = jsonPath.split("/").slice(0, -2);
    this.base = folders.map((name) => `${name}/`).join("");
  }

  async json(): Promise<string> {
    return (await this.file(this.jsonPath)).text();
  }

  async bytes(path: string): Promise<Uint8Array<ArrayBuffer>> {
    const named = this.files.get(this.base + path) ?? this.beside(path);
    if (!named) throw new Problem(`${path} is missing among the dropped files.`, "Drop the whole preview folder, with stack/ in it.");
    return new Uint8Array(await named.arrayBuffer());
  }

  async address(path: string): Promise<string> {
    return URL.createObjectURL(new Blob([await this.bytes(path)]));
  }

  private async file(path: string): Promise<File> {
    const file = this.files.get(path);
    if (!file) throw new Problem(`${path} is missing among the dropped files.`, "Drop the whole preview folder.");
    return file;
  }

  /** The folder stack/ may have been dropped alone, or its files without a folder. */
  private beside(path: string): File | undefined {
    const folder = this.jsonPath.replace(/[^/]*$/, "");
    return this.files.get(folder + path.replace(/^.*\//, ""));
  }
}

function shortName(url: URL): string {
  return url.pathname.split("/").slice(-2).join("/");
}
