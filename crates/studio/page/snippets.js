/**
 * Text that takes a look over to other programs.
 *
 * @import {Side} from "nacre/state.js"
 */

/** @param {number} x */
const short = (x) => String(Number(x.toFixed(4)));

/**
 * @param {Side} side
 * @param {string} file name of the table
 */
export function mitsubaSnippet(side, file) {
  const rgb = (/** @type {number[]} */ values) => values.map(short).join(", ");
  return `<bsdf type="pearl">
    <string name="filename" value="${file}"/>
    <float name="depth" value="${short(side.depth)}"/>
    <float name="brightness" value="${short(side.brightness)}"/>
    <float name="coherence" value="${short(side.coherence)}"/>
    <rgb name="body_color" value="${rgb(side.body_rgb)}"/>
    <rgb name="tint" value="${rgb(side.tint_rgb)}"/>${side.thickness === 1 ? "" : `
    <float name="thickness" value="${short(side.thickness)}"/>`}
</bsdf>`;
}

/**
 * @param {Side} side
 * @param {string} file
 */
export function pythonSnippet(side, file) {
  const list = (/** @type {number[]} */ values) => `[${values.map(short).join(", ")}]`;
  return `import nacre

table = nacre.Table("${file}")
pearl = nacre.Pearl(table, depth=${short(side.depth)}, brightness=${short(side.brightness)}, coherence=${short(side.coherence)},
                    body_color=${list(side.body_rgb)}, tint=${list(side.tint_rgb)}${side.thickness === 1 ? "" : `, thickness=${short(side.thickness)}`})`;
}

/** @param {string} file */
export function blenderSnippet(file) {
  return `lut export ${file} --to blender -o ${file.replace(/\.exr$/, "")}-blender.py`;
}
