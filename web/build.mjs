// Bundles src/ and the WebAssembly module of ../crates/web (in pkg/, written by `cargo xtask web`) into dist/.
import { build } from "esbuild";
import { execFileSync } from "node:child_process";
import { copyFileSync, existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

const wasm = "pkg/lumistack_web_bg.wasm";
if (!existsSync(wasm)) {
  console.error(`web/${wasm} is missing: run \`cargo xtask web\`, which builds it and then this page`);
  process.exit(1);
}
mkdirSync("dist", { recursive: true });
const BROWSERS = { bundle: true, minify: true, target: ["es2022", "chrome111", "firefox113", "safari16.4"], charset: "utf8", legalComments: "none" };
await build({
  ...BROWSERS,
  entryPoints: { viewer: "src/viewer.ts" },
  outdir: "dist",
  format: "esm",
  loader: { ".css": "text" },
  plugins: [
    {
      // The simulator's thread travels inside the script, and is started from there: wherever the script comes from.
      name: "worker",
      setup({ onResolve, onLoad }) {
        onResolve({ filter: /^worker:/ }, ({ path, resolveDir }) => ({ path: join(resolveDir, path.slice("worker:".length)), namespace: "worker" }));
        onLoad({ filter: /.*/, namespace: "worker" }, async ({ path }) => {
          // The page compiles the module: the thread has no address from which one could be fetched.
          const { outputFiles } = await build({ ...BROWSERS, entryPoints: [path], format: "iife", define: { "import.meta.url": '""' }, write: false });
          return { contents: outputFiles[0].text.trim(), loader: "text" };
        });
      },
    },
    {
      // The sheet travels inside the script, in the shadow root of the element: minified like the script.
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
// Asked for by pages of `lumistack live` alone.
await build({ ...BROWSERS, entryPoints: { live: "src/live.ts" }, outdir: "dist", format: "esm" });
// The page's own few rules stand in it: nothing is fetched before its poster shows.
const { outputFiles } = await build({ entryPoints: ["src/page.css"], minify: true, write: false });
writeFileSync("dist/index.html", readFileSync("src/index.html", "utf8").replace("/*page.css*/", () => outputFiles[0].text.trim()));
copyFileSync(wasm, "dist/lumistack_web_bg.wasm");
// What a program that imports the package sees of it; everything else is private.
const all = mkdtempSync(join(tmpdir(), "lumistack-types-"));
execFileSync(process.execPath, ["node_modules/typescript/bin/tsc", "--emitDeclarationOnly", "--declaration", "--outDir", all], { stdio: "inherit" });
mkdirSync("dist/types", { recursive: true });
for (const name of ["viewer.d.ts", "element.d.ts", "state.d.ts"]) copyFileSync(join(all, name), join("dist/types", name));
rmSync(all, { recursive: true });
for (const name of ["index.html", "viewer.js", "lumistack_web_bg.wasm"]) {
  const bytes = readFileSync(`dist/${name}`);
  console.log(`dist/${name}  ${(bytes.length / 1000).toFixed(1)} kB, ${(gzipSync(bytes, { level: 9 }).length / 1000).toFixed(1)} kB gzip`);
}
