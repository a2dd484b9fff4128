// Gaussians drawn by the graphics processor: instanced quads added up in floating point (WebGL2).

const STRIDE = 32;

const ADD = `#version 300 es
layout(location = 0) in vec2 corner;
layout(location = 1) in vec2 place;
layout(location = 2) in vec3 lower;
layout(location = 3) in vec3 colour;
uniform vec2 origin, canvas;
uniform float scale;
out vec2 z;
out vec3 light;
void main() {
  // The low-pass filter of docs/format.md, "Views".
  vec3 s = scale * lower;
  float v = max(1.0 - scale * scale, 0.0) / (12.0 * 0.7202);
  float wide = sqrt(s.x * s.x + v);
  float slant = s.x * (s.y / wide);
  float high = sqrt(s.z * s.z + v + (s.y / wide) * (s.y / wide) * v);
  light = colour * (s.x * s.z) / (wide * high);
  z = corner * 2.4494897;
  vec2 at = (place - origin) * scale + vec2(wide * z.x, slant * z.x + high * z.y);
  gl_Position = vec4(at.x / canvas.x * 2.0 - 1.0, 1.0 - at.y / canvas.y * 2.0, 0.0, 1.0);
}`;
const ADD_PIXEL = `#version 300 es
precision highp float;
in vec2 z;
in vec3 light;
out vec4 sum;
void main() {
  float w = exp(-0.5 * dot(z, z)) - 0.049787068;
  if (w <= 0.0) discard;
  sum = vec4(light * w, 0.0);
}`;
const SHOW = `#version 300 es
layout(location = 0) in vec2 corner;
void main() { gl_Position = vec4(corner, 0.0, 1.0); }`;
const SHOW_PIXEL = `#version 300 es
precision highp float;
uniform sampler2D sums;
uniform vec3 background;
out vec4 pixel;
void main() { pixel = vec4(background + texelFetch(sums, ivec2(gl_FragCoord.xy), 0).rgb, 1.0); }`;

/** Null where the browser has no WebGL2 that can add in floating point. */
export function openGpu() {
  const canvas = document.createElement("canvas");
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) return null;
  const format = gl.getExtension("EXT_float_blend") ? gl.RGBA32F : gl.RGBA16F;
  try {
    return new Gpu(canvas, gl, format);
  } catch {
    return null;
  }
}

class Gpu {
  #sizes = [0, 0];
  #file = null;

  constructor(canvas, gl, format) {
    this.canvas = canvas;
    this.gl = gl;
    this.format = format;
    this.lost = false;
    canvas.addEventListener("webglcontextlost", () => (this.lost = true));
    this.add = this.#program(ADD, ADD_PIXEL, ["origin", "canvas", "scale"]);
    this.show = this.#program(SHOW, SHOW_PIXEL, ["sums", "background"]);
    const corners = gl.createBuffer();
    this.gaussians = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.gaussians);
    for (const [where, size, offset] of [[1, 2, 0], [2, 3, 8], [3, 3, 20]]) {
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, size, gl.FLOAT, false, STRIDE, offset);
      gl.vertexAttribDivisor(where, 1);
    }
    this.sums = gl.createTexture();
    this.target = gl.createFramebuffer();
  }

  #program(vertex, fragment, names) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return { program, ...Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)])) };
  }

  #resize(width, height) {
    const { gl, canvas } = this;
    if (this.#sizes[0] === width && this.#sizes[1] === height) return;
    this.#sizes = [canvas.width, canvas.height] = [width, height];
    gl.bindTexture(gl.TEXTURE_2D, this.sums);
    const kind = this.format === gl.RGBA32F ? gl.FLOAT : gl.HALF_FLOAT;
    gl.texImage2D(gl.TEXTURE_2D, 0, this.format, width, height, 0, gl.RGBA, kind, null);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.sums, 0);
  }

  /** The canvas with the first `count` Gaussians of a file; its corner is at `origin`, in pixels of the picture. */
  draw(file, count, origin, scale, width, height) {
    const { gl, add, show } = this;
    this.#resize(width, height);
    if (this.#file !== file) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.gaussians);
      gl.bufferData(gl.ARRAY_BUFFER, file.values, gl.STATIC_DRAW);
      this.#file = file;
    }
    gl.viewport(0, 0, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(add.program);
    gl.uniform2f(add.origin, ...origin);
    gl.uniform2f(add.canvas, width, height);
    gl.uniform1f(add.scale, scale);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(show.program);
    gl.uniform1i(show.sums, 0);
    gl.uniform3f(show.background, ...file.background.map((level) => level / 255));
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, 1);
    return this.canvas;
  }
}
