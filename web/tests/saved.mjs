// Reads the zip that the page saves.

/** Returns the files of a zip without compression: path → bytes. */
export function unpacked(zip) {
  const files = new Map();
  for (let at = 0; zip.readUInt32LE(at) === 0x04034b50; ) {
    const [size, name, extra] = [zip.readUInt32LE(at + 18), zip.readUInt16LE(at + 26), zip.readUInt16LE(at + 28)];
    const start = at + 30 + name + extra;
    files.set(zip.toString("utf8", at + 30, at + 30 + name), zip.subarray(start, start + size));
    at = start + size;
  }
  return files;
}

/** Returns the values of a float32 array file. */
export function npy(bytes) {
  const values = bytes.subarray(10 + bytes.readUInt16LE(8));
  return new Float32Array(values.buffer.slice(values.byteOffset, values.byteOffset + values.length));
}
