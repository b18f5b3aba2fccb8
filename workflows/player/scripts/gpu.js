// WebGL 2 as this player uses it: programs with their uniforms, and textures that hold numbers.

export const WIDTH = 4096;  // of every texture of numbers, in texels; the shaders know it

const SLOW = 45, QUICK = 18;  // ms a frame from which a moving picture gets coarser, or finer again
const STRIDE = 0.6;  // least factor by which it gets coarser at once
const COARSEST = 0.4;  // of the screen's pixels, along each side
const FAILURES = 5;  // frames in a row that may fail before the player gives up

// How many of the screen's pixels a picture gets: fewer while it moves and the device is slow, and no more than the device can draw.
export class Pixels {
  // most: px along a side. software: whether there is no graphics device; then the first picture, too, would take seconds with all pixels.
  constructor(most, software) {
    this.most = most, this.scale = software ? COARSEST : 1;
    this.area = Infinity, this.last = 0, this.failures = 0;
  }

  // [width, height] of a picture for `width` x `height` px of the screen.
  of(width, height, moving) {
    const all = Math.max(width * height, 1), scale = Math.min(moving ? this.scale : 1, this.most / Math.max(width, height, 1), Math.sqrt(this.area / all));
    this.last = all * scale ** 2;
    return [width, height].map((side) => Math.min(this.most, Math.max(1, Math.round(side * scale))));
  }

  // A frame of a moving picture took so long.
  took(milliseconds) {
    if (milliseconds > SLOW) this.scale = Math.max(COARSEST, this.scale * Math.max(STRIDE, 0.9 * Math.sqrt(SLOW / milliseconds)));
    else if (milliseconds < QUICK) this.scale = Math.min(1, 1.1 * this.scale);
  }

  // Whether to go on after a frame that failed: with half as many pixels if they were too many.
  overcome(error) {
    if (error instanceof RangeError) this.area = this.last / 2;
    return ++this.failures < FAILURES;
  }
}

export class Program {
  constructor(gl, vertex, fragment, defines) {
    const head = "#version 300 es\nprecision highp float;\nprecision highp int;\nprecision highp usampler2D;\n";
    const said = Object.entries(defines).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    this.gl = gl;
    this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, head + said + text);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(this.program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`A shader does not compile here: ${gl.getProgramInfoLog(this.program)} ${logs.join(" ")}`);
    }
    this.places = new Map();
  }

  // Starts to use the program with these uniforms: numbers, lists, or textures.
  use(uniforms) {
    const { gl } = this;
    gl.useProgram(this.program);
    let unit = 0;
    for (const [name, value] of Object.entries(uniforms)) {
      if (!this.places.has(name)) this.places.set(name, gl.getUniformLocation(this.program, name));
      const at = this.places.get(name);
      if (at === null) continue;
      if (value instanceof WebGLTexture) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, value);
        gl.uniform1i(at, unit++);
      } else if (value.int !== undefined) gl.uniform1i(at, value.int);
      else if (typeof value === "number") gl.uniform1f(at, value);
      else if (value.length === 9) gl.uniformMatrix3fv(at, false, value);
      else gl[`uniform${value.length}fv`](at, value);
    }
  }
}

// A texture with a texel for each `components` of `values`, or for `room` of them; `half` keeps 16 bits of each. Of a `texture` that is there
// already, the texels from `at` on are written.
export function numbers(gl, values, components, { half = false, texture = null, at = 0, room = values.length / components } = {}) {
  const outer = components === 3 ? gl.RGB : gl.RGBA, count = values.length / components;
  if (!texture) {
    const width = Math.max(1, Math.min(room, WIDTH)), height = Math.max(1, Math.ceil(room / WIDTH));
    if (height > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("This scene is too large for this device's graphics.");
    texture = newTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, { 3: half ? gl.RGB16F : gl.RGB32F, 4: half ? gl.RGBA16F : gl.RGBA32F }[components], width, height);
  }
  gl.bindTexture(gl.TEXTURE_2D, texture);
  for (let done = 0; done < count; ) {
    const x = (at + done) % WIDTH, y = Math.floor((at + done) / WIDTH), wide = Math.min(WIDTH - x, count - done);
    const rows = wide === WIDTH ? Math.floor((count - done) / WIDTH) : 1;
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, wide, rows, outer, gl.FLOAT, values, done * components);
    done += wide * rows;
  }
  return texture;
}

// An empty texture of `count` texels with four integers each (bits of floats), to be written by a shader.
export function written(gl, count) {
  const texture = newTexture(gl);
  texture.width = Math.max(1, Math.min(count, WIDTH)), texture.height = Math.max(1, Math.ceil(count / WIDTH));
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, texture.width, texture.height);
  return texture;
}

export function newTexture(gl) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  for (const [name, value] of [["MIN_FILTER", gl.NEAREST], ["MAG_FILTER", gl.NEAREST], ["WRAP_S", gl.CLAMP_TO_EDGE], ["WRAP_T", gl.CLAMP_TO_EDGE]])
    gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], value);
  return texture;
}

// Something to draw into: one texture, or several at once.
export function target(gl, ...textures) {
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  const places = textures.map((texture, k) => {
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, texture, 0);
    return gl.COLOR_ATTACHMENT0 + k;
  });
  gl.drawBuffers(places);
  return frame;
}

// A texture for the order of `count` primitives.
export function ordered(gl, count) {
  const texture = newTexture(gl);
  texture.width = Math.max(1, Math.min(count, WIDTH));
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, texture.width, Math.max(1, Math.ceil(count / WIDTH)));
  return texture;
}

// Two triangles for each of `count` primitives, of the vertices 4 k to 4 k + 3 for the k-th. Not instances, each of which is a draw call of its
// own on some devices.
export function quadsOf(gl, count) {
  const array = gl.createVertexArray(), corners = new Uint32Array(6 * count);
  for (let k = 0, v = 0; k < 6 * count; k += 6, v += 4) {
    corners[k] = v, corners[k + 1] = corners[k + 4] = v + 1, corners[k + 2] = corners[k + 3] = v + 2, corners[k + 5] = v + 3;
  }
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  return array;
}
