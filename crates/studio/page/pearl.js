/**
 * A pearl on the graphics processor: the textures and uniforms of one table and one look.
 *
 * @import {Look, Table} from "nacre/table.js"
 * @import {Shown} from "nacre/look.js"
 * @import {Values} from "nacre/gl.js"
 */

import { texture } from "nacre/gl.js";
import { ALL_SHOWN, COMPONENTS, paint } from "nacre/look.js";
import { PACKED_WIDTH, pack } from "nacre/table.js";

/** A table with its look. */
export class Pearl {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Table} table
   */
  constructor(gl, table) {
    this.gl = gl;
    this.table = table;
    /** @type {Values} */
    this.values = {};
    /** @type {Object<string, WebGLTexture | null>} */
    this.textures = {};
    /** @type {Look} */
    this.look = table.look;
    /** @type {Shown} */
    this.shown = ALL_SHOWN;
    /** Whether its textures are gone. */
    this.deleted = false;
    this.upload();
  }

  /** What the shaders are compiled for. */
  get macros() {
    const { space, reciprocal, visible, bands } = this.table;
    return { SPACE: Number(space), RECIPROCAL: Number(reciprocal), VISIBLE: Number(visible), BANDS: bands };
  }

  /** Writes the table into textures; again when a context was lost. */
  upload() {
    const { gl, table } = this;
    const { records, pairs, offsets } = pack(table);
    this.textures = {
      uRecords: texture(gl, 4, PACKED_WIDTH, records.length / 4 / PACKED_WIDTH, records),
      uPairs: texture(gl, 2, PACKED_WIDTH, pairs.length / 2 / PACKED_WIDTH, pairs),
      uCurves: null,
    };
    const { slope_sd, index_ratio } = table.arrays;
    const facets = [...slope_sd.data].flatMap((sigma, band) => [sigma, index_ratio.data[band]]);
    this.values = {
      uRecordStart: [offsets.spans, offsets.widths, offsets.along, offsets.cells],
      uPairStart: [offsets.rowCumulative, offsets.rowTotal, offsets.total, 0],
      uGrid: [table.incidences, table.rows, table.columns, table.spans],
      uSteps: table.steps, uNodes: table.nodes, uAxis: [table.cellWidth, table.capRadius],
      uFacets: facets,
    };
    this.paint(this.look, this.shown);
  }

  /**
   * Takes another look.
   * @param {Look} look
   * @param {Shown} [shown]
   */
  paint(look, shown = ALL_SHOWN) {
    const { gl } = this;
    this.look = look;
    this.shown = shown;
    const { curves, base, body } = paint(this.table, look, shown);
    const { nodes } = this.table;
    const height = curves.length / 4 / nodes;
    if (this.textures.uCurves) {
      gl.bindTexture(gl.TEXTURE_2D, this.textures.uCurves);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, nodes, height, gl.RGBA, gl.FLOAT, curves);
    } else {
      this.textures.uCurves = texture(gl, 4, nodes, height, curves);
    }
    Object.assign(this.values, { uBase: base, uBody: body, uDepth: look.depth, uShown: COMPONENTS.map((name) => Number(shown[name])) });
  }

  delete() {
    this.deleted = true;
    for (const made of Object.values(this.textures)) this.gl.deleteTexture(made);
  }
}
