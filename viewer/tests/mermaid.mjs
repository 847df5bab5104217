// Draws state diagrams with Mermaid, in a document without a browser, and prints for each the texts that it shows, as
// JSON. Arguments: the folder of the packages `mermaid` and `jsdom`, then the files.
import fs from "node:fs";
import { createRequire } from "node:module";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [modules, ...files] = process.argv.slice(2);
const { JSDOM } = createRequire(path.join(modules, "here.js"))("jsdom");
const { window } = new JSDOM("<!DOCTYPE html><body></body>", { pretendToBeVisual: true, url: "http://localhost/" });
globalThis.window = window;
for (const name of Object.getOwnPropertyNames(window)) {
  if (!(name in globalThis)) globalThis[name] = window[name];
}
// The document has no layout: a text is as wide as its letters.
const extent = (node) => ({ x: 0, y: 0, width: 8 * node.textContent.length, height: 16 });
window.SVGElement.prototype.getBBox = function () { return extent(this); };
window.SVGElement.prototype.getComputedTextLength = function () { return extent(this).width; };

const mermaid = (await import(pathToFileURL(path.join(modules, "mermaid/dist/mermaid.core.mjs")))).default;
mermaid.initialize({ startOnLoad: false });
const shown = {};
for (const [number, file] of files.entries()) {
  const text = fs.readFileSync(file, "utf8");
  await mermaid.parse(text);
  const { svg } = await mermaid.render(`chart${number}`, text);
  const { document } = new JSDOM(svg).window;
  const texts = [...document.querySelectorAll("p")].map((p) => p.textContent.trim());
  shown[path.basename(file)] = texts.filter((text) => text !== "");
}
console.log(JSON.stringify(shown));
