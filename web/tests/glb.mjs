// Packs a glTF file and its files into a single .glb file.
import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";

const TYPES = { png: "image/png", jpg: "image/jpeg", jpeg: "image/jpeg" };
const padded = (bytes, fill) => Buffer.concat([bytes, Buffer.alloc(-bytes.length & 3, fill)]);

function chunk(type, bytes) {
  const head = Buffer.alloc(8);
  head.writeUInt32LE(bytes.length, 0);
  head.write(type, 4, "latin1");
  return Buffer.concat([head, bytes]);
}

/** Returns the bytes of a .glb with the geometry and pictures of the glTF file `path`. `edit` may change its JSON. */
export function glb(path, edit = () => undefined) {
  const gltf = JSON.parse(readFileSync(path, "utf8"));
  edit(gltf);
  const read = (uri) => readFileSync(join(dirname(path), decodeURIComponent(uri)));
  const parts = [];
  let length = 0;
  const append = (bytes) => {
    const start = length;
    parts.push(padded(bytes, 0));
    length += parts.at(-1).length;
    return start;
  };
  if (gltf.buffers.length !== 1) throw new Error(`${path}: expected one buffer, found ${gltf.buffers.length}`);
  append(read(gltf.buffers[0].uri));
  for (const image of gltf.images ?? []) {
    const bytes = read(image.uri);
    gltf.bufferViews.push({ buffer: 0, byteOffset: append(bytes), byteLength: bytes.length });
    image.mimeType = TYPES[image.uri.split(".").at(-1)];
    image.bufferView = gltf.bufferViews.length - 1;
    delete image.uri;
  }
  gltf.buffers = [{ byteLength: length }];
  const body = Buffer.concat([chunk("JSON", padded(Buffer.from(JSON.stringify(gltf)), 0x20)), chunk("BIN\0", Buffer.concat(parts))]);
  const head = Buffer.alloc(12);
  head.write("glTF", 0, "latin1");
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + body.length, 8);
  return Buffer.concat([head, body]);
}
