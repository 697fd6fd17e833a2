// Bundles src/ and the WebAssembly module of ../crates/web (in pkg/, written by `cargo xtask web`) into dist/.
import { build } from "esbuild";
import { copyFileSync, existsSync, mkdirSync, readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const wasm = "pkg/lumistack_web_bg.wasm";
if (!existsSync(wasm)) {
  console.error(`web/${wasm} is missing: run \`cargo xtask web\`, which builds it and then this page`);
  process.exit(1);
}
mkdirSync("dist", { recursive: true });
await build({
  entryPoints: { viewer: "src/viewer.ts" },
  outdir: "dist",
  bundle: true,
  minify: true,
  format: "esm",
  target: ["es2022", "chrome111", "firefox113", "safari16.4"],
  charset: "utf8",
  legalComments: "none",
  loader: { ".css": "text" },
  plugins: [
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
await build({ entryPoints: { viewer: "src/page.css" }, outdir: "dist", minify: true });
copyFileSync(wasm, "dist/lumistack_web_bg.wasm");
copyFileSync("src/index.html", "dist/index.html");
for (const name of ["index.html", "viewer.css", "viewer.js", "lumistack_web_bg.wasm"]) {
  const bytes = readFileSync(`dist/${name}`);
  console.log(`dist/${name}  ${(bytes.length / 1000).toFixed(1)} kB, ${(gzipSync(bytes, { level: 9 }).length / 1000).toFixed(1)} kB gzip`);
}
