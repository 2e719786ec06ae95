// Bundles the page into ../loop/studio/page/, with the licence of every package that ends up in it.

import { cp, mkdir, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const page = join(here, "..", "loop", "studio", "page");

const result = await build({
  absWorkingDir: here,
  entryPoints: { studio: "src/main.ts", style: "src/style.css" },
  outdir: page,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["chrome111", "firefox113", "safari16.4"],
  legalComments: "none",
  metafile: true,
  write: false,
  logLevel: "warning",
});

const packages = new Set();
for (const input of Object.keys(result.metafile.inputs)) {
  const found = /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(input);
  if (found) packages.add(found[1]);
}

async function licence(name) {
  const folder = join(here, "node_modules", name);
  const file = (await readdir(folder)).find((each) => /^licen[cs]e/i.test(each));
  if (!file) throw new Error(`${name}: no licence file in ${folder}, so it may not be bundled`);
  const { version } = JSON.parse(await readFile(join(folder, "package.json"), "utf8"));
  return `${name} ${version}\n\n${(await readFile(join(folder, file), "utf8")).trim()}\n`;
}

const licences = await Promise.all([...packages].sort().map(licence));

await rm(page, { recursive: true, force: true });
await mkdir(page, { recursive: true });
for (const file of result.outputFiles) await writeFile(file.path, file.contents);
await cp(join(here, "src", "index.html"), join(page, "index.html"));
await writeFile(join(page, "LICENSES.txt"), licences.join(`\n${"-".repeat(72)}\n\n`));
for (const file of result.outputFiles) console.log(`${file.path.slice(page.length + 1)}: ${(file.contents.length / 1024).toFixed(0)} KiB`);
