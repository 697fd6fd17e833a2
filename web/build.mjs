// Bundles src/ and the WebAssembly modules in pkg/ into dist/. `cargo xtask web` builds the modules
// and runs this script.
import { build } from "esbuild";
import { execFileSync } from "node:child_process";
import { copyFileSync, existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { gzipSync } from "node:zlib";

const MODULES = ["lumistack_web_bg.wasm", "lumistack_web_solver_bg.wasm", "lumistack_web_solver_gpu_bg.wasm", "lumistack_web_pictures_bg.wasm", "lumistack_web_decoders_bg.wasm"];
/** Scripts that the viewer loads when the user chooses a headset, a lenticular panel or Looking Glass Bridge. */
const OTHERS = ["headset", "lenticular", "bridge"];
for (const name of MODULES) {
  if (existsSync(`pkg/${name}`)) continue;
  console.error(`web/pkg/${name} is missing: run \`cargo xtask web\`, which builds it and then this page`);
  process.exit(1);
}
mkdirSync("dist", { recursive: true });
const BROWSERS = { bundle: true, minify: true, target: ["es2022", "chrome111", "firefox113", "safari16.4"], charset: "utf8", legalComments: "none" };
await build({
  ...BROWSERS,
  entryPoints: { viewer: "src/viewer.ts", solve: "src/solve/main.ts" },
  outdir: "dist",
  format: "esm",
  external: OTHERS.map((name) => `./${name}.js`),
  loader: { ".css": "text" },
  plugins: [
    {
      // The script contains the code of the simulator's thread as text. So the thread needs no file
      // of its own.
      name: "worker",
      setup({ onResolve, onLoad }) {
        onResolve({ filter: /^worker:/ }, ({ path, resolveDir }) => ({ path: join(resolveDir, path.slice("worker:".length)), namespace: "worker" }));
        onLoad({ filter: /.*/, namespace: "worker" }, async ({ path }) => {
          // The page compiles the WebAssembly module and passes it to the thread. The thread has no
          // address of its own, so it could not resolve a relative address of the module.
          const { outputFiles } = await build({ ...BROWSERS, entryPoints: [path], format: "iife", define: { "import.meta.url": '""' }, write: false });
          return { contents: outputFiles[0].text.trim(), loader: "text" };
        });
      },
    },
    {
      // The script contains the element's style sheet as minified text.
      name: "sheet",
      setup({ onLoad }) {
        onLoad({ filter: /sheet\/.*\.css$/ }, async ({ path }) => {
          const { outputFiles } = await build({ entryPoints: [path], minify: true, write: false });
          return { contents: outputFiles[0].text.trim(), loader: "text" };
        });
      },
    },
  ],
});
await build({ ...BROWSERS, entryPoints: Object.fromEntries(OTHERS.map((name) => [name, `src/${name}.ts`])), outdir: "dist", format: "esm" });
// The solver's thread with the module for WebGPU. Only browsers with a graphics processor load it.
await build({
  ...BROWSERS,
  entryPoints: { "solve-gpu": "src/solve/worker.ts" },
  outdir: "dist",
  format: "iife",
  define: { "import.meta.url": '""' },
  plugins: [
    {
      name: "gpu",
      setup({ onResolve }) {
        onResolve({ filter: /\/lumistack_web_solver\.js$/ }, () => ({ path: resolve("pkg/lumistack_web_solver_gpu.js") }));
      },
    },
  ],
});
// Only pages of `lumistack live` load this script.
await build({ ...BROWSERS, entryPoints: { live: "src/live.ts" }, outdir: "dist", format: "esm" });
// Each page contains its own style sheet, so that the browser fetches nothing before it shows the
// poster.
for (const [page, sheet] of [
  ["index", "page"],
  ["solve", "solve"],
]) {
  const { outputFiles } = await build({ entryPoints: [`src/${sheet}.css`], minify: true, write: false });
  writeFileSync(`dist/${page}.html`, readFileSync(`src/${page}.html`, "utf8").replace(`/*${sheet}.css*/`, () => outputFiles[0].text.trim()));
}
for (const name of MODULES) copyFileSync(`pkg/${name}`, `dist/${name}`);
// Copy the scenes that come with the page that solves.
for (const [name, { files }] of Object.entries(JSON.parse(readFileSync("src/solve/scenes.json", "utf8")))) {
  mkdirSync(`dist/scenes/${name}`, { recursive: true });
  for (const file of files) copyFileSync(`../scenes/${name}/${file}`, `dist/scenes/${name}/${file}`);
}
// Write the types of the public modules; all other modules are private.
const all = mkdtempSync(join(tmpdir(), "lumistack-types-"));
execFileSync(process.execPath, ["node_modules/typescript/bin/tsc", "--emitDeclarationOnly", "--declaration", "--outDir", all], { stdio: "inherit" });
mkdirSync("dist/types", { recursive: true });
for (const name of ["viewer.d.ts", "element.d.ts", "state.d.ts"]) copyFileSync(join(all, name), join("dist/types", name));
rmSync(all, { recursive: true });
for (const name of ["index.html", "viewer.js", ...OTHERS.map((name) => `${name}.js`), "lumistack_web_bg.wasm", "solve.html", "solve.js", "solve-gpu.js", ...MODULES.slice(1)]) {
  const bytes = readFileSync(`dist/${name}`);
  console.log(`dist/${name}  ${(bytes.length / 1000).toFixed(1)} kB, ${(gzipSync(bytes, { level: 9 }).length / 1000).toFixed(1)} kB gzip`);
}
