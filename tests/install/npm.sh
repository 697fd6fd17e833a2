#!/bin/sh
# The npm package: unpacked as npm does, and imported by Node.js where a page would import it.
. "$(dirname "$0")/common.sh"
packages nodejs
mkdir -p node_modules/lumistack-viewer
tar xzf "$(one "lumistack-viewer-*.tgz")" -C node_modules/lumistack-viewer --strip-components=1
cat > page.mjs <<'NODE'
import { readFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";

const script = fileURLToPath(import.meta.resolve("lumistack-viewer"));
const module = fileURLToPath(import.meta.resolve("lumistack-viewer/lumistack_web_bg.wasm"));
if (!(await readFile(script, "utf8")).includes("lumistack-viewer")) throw new Error("the script names no element");
const compiled = await WebAssembly.compile(await readFile(module));
console.log(`${WebAssembly.Module.exports(compiled).length} functions and memories in the module`);
NODE
node page.mjs
[ -s node_modules/lumistack-viewer/dist/types/viewer.d.ts ]
