// Bundles the viewer into ../viewer.min.js, with the sources' digest in its first line, by which a test tells it is new.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const sources = readdirSync(".").filter((name) => name.endsWith(".js") || name === "package.json").sort();
const digest = createHash("sha256");
for (const name of sources) digest.update(readFileSync(name));
const { version } = JSON.parse(readFileSync("node_modules/three/package.json", "utf8"));
await build({
  entryPoints: ["main.js"],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "ascii",
  legalComments: "none",
  outfile: "../viewer.min.js",
  banner: {
    js: `/* sira_assets viewer, sources ${digest.digest("hex")}. `
      + `Holds three.js ${version}, (c) 2010-2026 three.js authors, MIT licence. */`,
  },
});
