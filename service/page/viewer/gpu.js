// Gaussians drawn by the graphics processor: instanced quads added up in floating point (WebGL2), and texture upon them.

import { NOISE_UNITS, SIDE, noiseOf, octavesOf } from "../sgmethod/drawing.js";
import { CELL } from "../sgmethod/header.js";

const STRIDE = 32;
const NO_LEVEL = -1;

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
// Noise and its strength as in docs/format.md, "Noise". To be enlarged by two again and again comes to a quadratic
// B-spline, which is what is drawn here from the third level on.
const SHOW_PIXEL = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D sums;
uniform highp sampler2D codes;
uniform highp isampler2D noise;
uniform vec3 background;
uniform vec2 origin;
uniform float scale, height;
uniform ivec2 levels;
uniform vec2 gains;
out vec4 pixel;

float strengthOfCell(ivec2 cell, int octave) {
  float code = round(255.0 * texelFetch(codes, cell, 0)[octave]);
  return code < 0.5 ? 0.0 : exp2(0.5 * (code - 1.0)) / (octave == 0 ? ${NOISE_UNITS.map((unit) => unit.toFixed(1)).join(" : ")});
}

float strength(vec2 place, int octave) {
  ivec2 last = textureSize(codes, 0) - 1;
  vec2 at = clamp(place / ${CELL}.0 - 0.5, vec2(0.0), vec2(last));
  ivec2 low = ivec2(at);
  ivec2 high = min(low + 1, last);
  vec2 part = at - vec2(low);
  float above = mix(strengthOfCell(low, octave), strengthOfCell(ivec2(high.x, low.y), octave), part.x);
  float below = mix(strengthOfCell(ivec2(low.x, high.y), octave), strengthOfCell(high, octave), part.x);
  return mix(above, below, part.y);
}

vec3 weights(float t, int level) {
  if (level == 0) return vec3(0.0, 1.0, 0.0);
  if (level == 1) return t < 0.0 ? vec3(0.25, 0.75, 0.0) : vec3(0.0, 0.75, 0.25);
  return vec3(0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t));
}

float grain(vec2 place, int octave) {
  int level = levels[octave];
  if (level < 0) return 0.0;
  float strong = gains[octave] * strength(place / scale, octave);
  if (strong == 0.0) return 0.0;
  vec2 at = place / float(1 << level);
  ivec2 middle = ivec2(floor(at));
  vec2 t = at - vec2(middle) - 0.5;
  vec3 across = weights(t.x, level);
  vec3 down = weights(t.y, level);
  float sum = 0.0;
  for (int j = 0; j < 3; j++) {
    if (down[j] == 0.0) continue;
    for (int i = 0; i < 3; i++) {
      ivec2 where = (middle + ivec2(i, j) - 1) & ${SIDE - 1}; // noise repeats
      sum += across[i] * down[j] * float(texelFetch(noise, where, 0)[octave]);
    }
  }
  return strong * sum;
}

void main() {
  vec3 sum = background + texelFetch(sums, ivec2(gl_FragCoord.xy), 0).rgb;
  vec2 place = vec2(gl_FragCoord.x, height - gl_FragCoord.y) + origin * scale;
  pixel = vec4(sum + grain(place, 0) + grain(place, 1), 1.0);
}`;

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
    const grain = ["codes", "noise", "origin", "scale", "height", "levels", "gains"];
    this.show = this.#program(SHOW, SHOW_PIXEL, ["sums", "background", ...grain]);
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
    this.codes = gl.createTexture();
    this.noise = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.noise);
    const noise = Int8Array.from({ length: 2 * SIDE * SIDE }, (_, i) => noiseOf(i & 1)[i >> 1]);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG8I, SIDE, SIDE, 0, gl.RG_INTEGER, gl.BYTE, noise);
    this.#unfiltered();
    this.target = gl.createFramebuffer();
  }

  #unfiltered() {
    const { gl } = this;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
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
    this.#unfiltered();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.sums, 0);
  }

  #take(file) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.gaussians);
    gl.bufferData(gl.ARRAY_BUFFER, file.values, gl.STATIC_DRAW);
    const { columns, rows, octaves } = file.texture ?? { columns: 1, rows: 1, octaves: [[0], [0]] };
    const codes = Uint8Array.from({ length: 2 * columns * rows }, (_, i) => octaves[i % 2][i >> 1]);
    gl.bindTexture(gl.TEXTURE_2D, this.codes);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG8, columns, rows, 0, gl.RG, gl.UNSIGNED_BYTE, codes);
    this.#unfiltered();
    this.#file = file;
  }

  /** The canvas with the first `count` Gaussians of a file, and its texture if it is to be drawn. Its corner is at
   * `origin`, in pixels of the picture. */
  draw(file, count, origin, scale, width, height, textured = true) {
    const { gl, add, show } = this;
    this.#resize(width, height);
    if (this.#file !== file) this.#take(file);
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
    for (const [unit, texture] of [this.sums, this.codes, this.noise].entries()) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(show.sums, 0);
    gl.uniform1i(show.codes, 1);
    gl.uniform1i(show.noise, 2);
    gl.uniform2f(show.origin, ...origin);
    gl.uniform1f(show.scale, scale);
    gl.uniform1f(show.height, height);
    const octaves = textured && file.texture ? octavesOf({ sx: scale, sy: scale }) : [];
    const of = (octave) => octaves.find((one) => one.octave === octave) ?? { level: NO_LEVEL, gain: 0 };
    gl.uniform2i(show.levels, of(0).level, of(1).level);
    gl.uniform2f(show.gains, of(0).gain, of(1).gain);
    gl.uniform3f(show.background, ...file.background.map((level) => level / 255));
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, 1);
    return this.canvas;
  }
}
