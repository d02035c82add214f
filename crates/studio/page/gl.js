/**
 * The few things of WebGL 2 that the page uses: programs that fill a viewport, and textures of single precision.
 *
 * @typedef {Object<string, number | boolean | number[] | Float32Array | Int32Array>} Values uniforms by name
 */

const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const HEADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
`;

/** What this page needs is not there; the message says what. */
export class Unsupported extends Error {}

/**
 * A context of a canvas, with float targets.
 * @param {HTMLCanvasElement | OffscreenCanvas} canvas
 * @returns {WebGL2RenderingContext}
 */
export function contextOf(canvas) {
  const options = { antialias: false, alpha: false, depth: false, stencil: false, powerPreference: "high-performance", preserveDrawingBuffer: true };
  const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", options));
  if (!gl) throw new Unsupported("This browser has no WebGL 2. Nacre draws with it: another browser, or hardware acceleration switched on, will do.");
  prepare(gl);
  return gl;
}

/**
 * Switches on what a context needs, also after it was lost and restored.
 * @param {WebGL2RenderingContext} gl
 */
export function prepare(gl) {
  if (!gl.getExtension("EXT_color_buffer_float")) {
    throw new Unsupported("This graphics processor cannot draw into single-precision textures (EXT_color_buffer_float). Nacre needs them.");
  }
}

/** A program that fills the viewport. */
export class Program {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {string} source of the fragment shader, without version and precision
   * @param {Object<string, number>} [macros]
   */
  constructor(gl, source, macros = {}) {
    this.gl = gl;
    this.waiting = gl.getExtension("KHR_parallel_shader_compile");
    const defines = Object.entries(macros).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    this.shaders = [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, HEADER + defines + source]].map(([kind, text]) => {
      const shader = /** @type {WebGLShader} */ (gl.createShader(/** @type {number} */ (kind)));
      gl.shaderSource(shader, /** @type {string} */ (text));
      gl.compileShader(shader);
      return shader;
    });
    this.program = /** @type {WebGLProgram} */ (gl.createProgram());
    for (const shader of this.shaders) gl.attachShader(this.program, shader);
    gl.linkProgram(this.program);
    /** @type {Map<string, {at: WebGLUniformLocation, type: number, size: number}> | null} */
    this.uniforms = null;
  }

  /** Whether it can be used without waiting for the compiler. */
  get ready() {
    return !this.waiting || this.uniforms !== null || this.gl.isContextLost() || this.gl.getProgramParameter(this.program, this.waiting.COMPLETION_STATUS_KHR);
  }

  /** Its uniforms, once it is linked. */
  link() {
    if (this.uniforms) return this.uniforms;
    const { gl, program } = this;
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(this.shaders.map((shader) => gl.getShaderInfoLog(shader)).join("\n") + gl.getProgramInfoLog(program));
    }
    this.uniforms = new Map();
    const count = gl.isContextLost() ? 0 : gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const info = /** @type {WebGLActiveInfo} */ (gl.getActiveUniform(program, i));
      const at = /** @type {WebGLUniformLocation} */ (gl.getUniformLocation(program, info.name));
      this.uniforms.set(info.name.replace(/\[0\]$/, ""), { at, type: info.type, size: info.size });
    }
    return this.uniforms;
  }

  /**
   * Draws into the bound target.
   * @param {Values} values
   * @param {Object<string, WebGLTexture | null>} textures
   */
  draw(values, textures = {}) {
    const { gl } = this;
    const uniforms = this.link();
    gl.useProgram(this.program);
    for (const [name, value] of Object.entries(values)) {
      const uniform = uniforms.get(name);
      if (uniform) set(gl, uniform, typeof value === "object" ? value : [Number(value)]);
    }
    let unit = 0;
    for (const [name, texture] of Object.entries(textures)) {
      const uniform = uniforms.get(name);
      if (!uniform) continue;
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(uniform.at, unit++);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  delete() {
    for (const shader of this.shaders) this.gl.deleteShader(shader);
    this.gl.deleteProgram(this.program);
  }
}

/**
 * @param {WebGL2RenderingContext} gl
 * @param {{at: WebGLUniformLocation, type: number}} uniform
 * @param {ArrayLike<number>} value
 */
function set(gl, { at, type }, value) {
  const list = /** @type {Float32List & Int32List} */ (value);
  switch (type) {
    case gl.FLOAT: return gl.uniform1fv(at, list);
    case gl.FLOAT_VEC2: return gl.uniform2fv(at, list);
    case gl.FLOAT_VEC3: return gl.uniform3fv(at, list);
    case gl.FLOAT_VEC4: return gl.uniform4fv(at, list);
    case gl.INT: case gl.BOOL: return gl.uniform1iv(at, list);
    case gl.INT_VEC2: return gl.uniform2iv(at, list);
    case gl.INT_VEC3: return gl.uniform3iv(at, list);
    case gl.INT_VEC4: return gl.uniform4iv(at, list);
    case gl.UNSIGNED_INT: return gl.uniform1ui(at, value[0] >>> 0);
    default: throw new Error(`a uniform of type ${type} is not known`);
  }
}

/**
 * A texture that is read texel by texel.
 * @param {WebGL2RenderingContext} gl
 * @param {number} channels 1, 2 or 4
 * @param {number} width
 * @param {number} height
 * @param {Float32Array | null} data
 * @param {boolean} [bytes] whether it holds bytes instead, of four channels
 */
export function texture(gl, channels, width, height, data, bytes = false) {
  const made = /** @type {WebGLTexture} */ (gl.createTexture());
  gl.bindTexture(gl.TEXTURE_2D, made);
  const format = { 1: [gl.R32F, gl.RED], 2: [gl.RG32F, gl.RG], 4: [gl.RGBA32F, gl.RGBA] }[channels] ?? [];
  if (bytes) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
  else gl.texImage2D(gl.TEXTURE_2D, 0, format[0], width, height, 0, format[1], gl.FLOAT, data);
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  return made;
}

/**
 * Resolves once the processor has done all that it was asked so far.
 * @param {WebGL2RenderingContext} gl
 * @returns {Promise<void>}
 */
export function finished(gl) {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  return new Promise((resolve) => {
    const look = () => {
      if (!fence || gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED) {
        gl.deleteSync(fence);
        resolve();
      } else {
        // Asking at once again would take the time of a processor that renders by itself.
        setTimeout(look, 1);
      }
    };
    setTimeout(look, 0);
  });
}

/** Textures that are drawn into. */
export class Target {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {number} width
   * @param {number} height
   * @param {number} [count] of textures
   * @param {boolean} [bytes] of bytes
   */
  constructor(gl, width, height, count = 1, bytes = false) {
    this.gl = gl;
    this.width = width;
    this.height = height;
    this.textures = Array.from({ length: count }, () => texture(gl, 4, width, height, null, bytes));
    this.buffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    const attachments = this.textures.map((made, k) => {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, made, 0);
      return gl.COLOR_ATTACHMENT0 + k;
    });
    gl.drawBuffers(attachments);
  }

  bind() {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.buffer);
    this.gl.viewport(0, 0, this.width, this.height);
  }

  clear() {
    this.bind();
    this.gl.disable(this.gl.SCISSOR_TEST);
    this.gl.clearColor(0, 0, 0, 0);
    this.gl.clear(this.gl.COLOR_BUFFER_BIT);
  }

  /**
   * Numbers of a rectangle, bottom row first, once the processor has come to it: nothing waits.
   * @param {number} x
   * @param {number} y
   * @param {number} width
   * @param {number} height
   * @param {number} [which] texture
   */
  async read(x = 0, y = 0, width = this.width, height = this.height, which = 0) {
    const { gl } = this;
    const pixels = new Float32Array(4 * width * height);
    const buffer = gl.createBuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.readBuffer(gl.COLOR_ATTACHMENT0 + which);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, buffer);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, pixels.byteLength, gl.STREAM_READ);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.FLOAT, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    await finished(gl);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, buffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, pixels);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.deleteBuffer(buffer);
    return pixels;
  }

  delete() {
    for (const made of this.textures) this.gl.deleteTexture(made);
    this.gl.deleteFramebuffer(this.buffer);
  }
}
