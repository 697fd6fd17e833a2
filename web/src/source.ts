// Sources of a preview: a server, the page itself, or dropped files.
import { Problem, REWRITE } from "./problem.js";

export interface Source {
  /** The text of preview.json. */
  json(): Promise<string>;
  /** Reads a file that preview.json names. */
  bytes(path: string, signal: AbortSignal): Promise<Uint8Array<ArrayBuffer>>;
  /** Returns an address for a picture that preview.json names, for the attribute `src` of images. */
  address(path: string): Promise<string>;
}

declare global {
  interface Window {
    /** In a page that contains its preview: path → content in base64. The key "wasm" has the module. */
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
 * A preview on a server. Paths of its files are relative to the parent of the folder that contains
 * preview.json.
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
            "Open preview.html instead, a single file with all content, or serve the folder with “lumistack preview”.",
          )
        : new Problem(`${shortName(url)} could not be fetched: no answer from ${url.host}.`, "Check that the server is running, then load this page again.");
    }
    if (response.ok) return response;
    throw response.status === 404
      ? new Problem(`${shortName(url)} is missing: ${url.host} answers 404.`, REWRITE)
      : new Problem(`${shortName(url)} could not be fetched: ${url.host} answers ${response.status}.`, "Check the server's messages, then load this page again.");
  }
}

/** A preview that the page contains. */
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

/** Returns the source that the attribute `src` names: the page itself, or a server. */
export function sourceOf(src: string): Source {
  const inline = window.LUMISTACK_INLINE;
  return inline && src in inline ? new InlineSource(inline, src) : new ServerSource(src);
}

/** A preview among dropped files, given by path. */
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
    if (!named) throw new Problem(`${path} is missing among the dropped files.`, "Drop the whole preview folder, including the folder stack.");
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

  /**
   * Finds a file beside preview.json by its name. The user may have dropped the folder stack/
   * alone, or its files without a folder.
   */
  private beside(path: string): File | undefined {
    const folder = this.jsonPath.replace(/[^/]*$/, "");
    return this.files.get(folder + path.replace(/^.*\//, ""));
  }
}

function shortName(url: URL): string {
  return url.pathname.split("/").slice(-2).join("/");
}
