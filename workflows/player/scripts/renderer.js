// Draws a scene with WebGL 2. Every primitive is projected once a frame into textures; then all are blended front to back in one call, in the
// order in which the sorter has put them.
import { eyeOf } from "./camera.js";
import { Program, WIDTH, newTexture, numbers, ordered, quadsOf, target, written } from "./gpu.js";
import { laterRows } from "./layout.js";
import { keyAt, posesAt, rowAt } from "./motion.js";
import { shaders } from "./shaders.js";
import { convexTextures, gaussianTextures, keyTextures } from "./textures.js";

const PARTS = 8;  // of the primitives; after each, tiles that show nothing behind it are closed
const TILE = 8;  // px
const FEW = 2000;  // primitives, of which there is no use in parts
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;
const DILATION = "0.3", PIXEL_VARIANCE = "0.1";  // px^2, added to the covariance of Gaussians; the second in the antialiased mode

export class Renderer {
  constructor(canvas) {
    const wanted = { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true, powerPreference: "high-performance" };
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", wanted);
    if (!this.gl) throw new Error("This browser has no WebGL 2, which the scene needs. Try another browser, or allow graphics acceleration.");
    this.uploads = { order: 0, poses: 0, keys: 0 };
    const { gl } = this, limits = [gl.MAX_TEXTURE_SIZE, gl.MAX_RENDERBUFFER_SIZE].map((name) => gl.getParameter(name));
    this.most = Math.min(...limits, ...gl.getParameter(gl.MAX_VIEWPORT_DIMS));  // px along a side of a picture
  }

  // Everything on the graphics device is made from `scene`, again after its context was lost.
  load(scene) {
    const { gl } = this, { header } = scene;
    this.scene = scene;
    this.gaussians = header.gaussians[0] + header.gaussians[1], this.convexes = header.convexes[0] + header.convexes[1];
    this.corners = Math.max(3, header.corners);
    const defines = { TILE, CORNERS: this.corners, COEFFICIENTS: (header.sh_degree + 1) ** 2, DILATION: header.antialiased ? PIXEL_VARIANCE : DILATION };
    const flags = { [header.motion.toUpperCase()]: true, ANTIALIASED: header.antialiased, LIGHT: header.light, CONVEXES: this.convexes > 0 };
    for (const [name, on] of Object.entries(flags)) if (on) defines[name] = "1";
    const project = (name, more = {}) => new Program(gl, shaders.full_vert, shaders.common + shaders[name], { ...defines, ...more });
    const total = this.gaussians + this.convexes;
    this.place = written(gl, total), this.look = written(gl, total);
    this.projected = target(gl, this.place, this.look);
    this.ofGaussians = project("gaussians");
    this.gaussianTextures = gaussianTextures(gl, scene);
    if (this.convexes) {
      this.ofConvexes = project("convexes"), this.ofEdges = project("convexes", { EDGES: "1" });
      this.convexTextures = convexTextures(gl, scene);
      this.edges = written(gl, this.convexes * this.corners);
      this.edgeTarget = target(gl, this.edges);
    }
    this.blend = new Program(gl, shaders.draw_vert, shaders.draw_frag, defines);
    this.finish = new Program(gl, shaders.full_vert, shaders.finish_frag, defines);
    this.opaque = new Program(gl, shaders.full_vert, shaders.opaque_frag, defines);
    this.software = drawsInSoftware(gl);
    this.format = pictureFormat(gl, this.software);
    this.empty = gl.createVertexArray();
    this.quads = quadsOf(gl, total);
    this.order = ordered(gl, total);
    this.count = 0;
    this.picture = this.size = this.poses = this.posesTime = this.keys = null;
    scene.parts.forEach((part, k) => this.add(part, k));
  }

  // Draws the primitives of window k, too, from now on.
  add(part, k) {
    const { header } = this.scene, from = (name, all) => all - laterRows(header, k, name);
    const [g, c] = [from("gaussians", this.gaussians), from("convexes", this.convexes)];
    gaussianTextures(this.gl, part, this.gaussianTextures, g, g - header.gaussians[0]);
    if (this.convexes) convexTextures(this.gl, part, this.convexTextures, c, c - header.convexes[0]);
  }

  setOrder(order, count) {
    const { gl } = this, width = this.order.width, rows = Math.floor(count / width), left = count - rows * width;
    gl.bindTexture(gl.TEXTURE_2D, this.order);
    if (rows) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    if (left) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, rows, left, 1, gl.RED_INTEGER, gl.UNSIGNED_INT, order, rows * width);
    this.count = count;
    this.uploads.order += 1;
  }

  // Draws the primitives in the order that was set. view: { time, cam_from_world, K, width, height }, as `e4dgs.show` takes it. place: where
  // the picture goes; without it, it is the canvas.
  draw(view, place = null) {
    const { gl } = this, { width, height } = view, { frame, x, y } = place ?? { frame: null, x: 0, y: 0 };
    if (gl.isContextLost()) return;
    if (!place) this.#frame(width, height);
    this.#fit(width, height);
    this.#project(view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.blended);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 1]);
    gl.blendFuncSeparate(gl.DST_ALPHA, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA);
    const edges = this.convexes ? { uEdges: this.edges } : {}, own = { uSize: [width, height], uGaussians: { int: this.gaussians } };
    this.#blend({ uPlace: this.place, uLook: this.look, uOrder: this.order, ...edges, ...own }, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(x, y, width, height);
    this.finish.use({ uBlended: this.picture, uBackground: this.scene.header.background, uCorner: [x, y] });
    this.#fill();
  }

  // In parts, front to back: after each, tiles that no longer show what lies behind are closed, and the vertex stage leaves out what lies
  // in closed tiles alone.
  #blend(uniforms, width, height) {
    const { gl, count } = this, parts = count < FEW ? 1 : PARTS, end = (part) => Math.floor((count * part) / parts);
    for (let part = 0; part < parts; ++part) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.closing);
      if (part) {
        gl.viewport(0, 0, Math.ceil(width / TILE), Math.ceil(height / TILE));
        this.opaque.use({ uBlended: this.picture });
        this.#fill();
      } else gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.blended);
      gl.viewport(0, 0, width, height);
      gl.enable(gl.BLEND);
      this.blend.use({ ...uniforms, uClosed: this.closed });
      gl.bindVertexArray(this.quads);
      gl.drawElements(gl.TRIANGLES, 6 * (end(part + 1) - end(part)), gl.UNSIGNED_INT, 24 * end(part));
      gl.disable(gl.BLEND);
    }
  }

  #fill() {
    this.gl.bindVertexArray(this.empty);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  // Makes the canvas `width` x `height` px.
  #frame(width, height) {
    const { gl, canvas } = this;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    if (gl.drawingBufferWidth !== width || gl.drawingBufferHeight !== height)
      throw new RangeError(`This device draws no pictures of ${width}x${height} px.`);
  }

  // Makes what is drawn before a picture `width` x `height` px.
  #fit(width, height) {
    const { gl } = this, size = `${width}x${height}`;
    if (size === this.size) return;
    this.size = null;  // what fails below shall not be taken for a picture of the size before
    if (this.picture) {
      for (const texture of [this.picture, this.closed]) gl.deleteTexture(texture);
      for (const frame of [this.blended, this.closing]) gl.deleteFramebuffer(frame);
    }
    this.picture = newTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.format, width, height);
    this.blended = target(gl, this.picture);
    this.closed = newTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R8, Math.ceil(width / TILE), Math.ceil(height / TILE));
    this.closing = target(gl, this.closed);
    if (gl.getError() === gl.OUT_OF_MEMORY) throw new RangeError(`This device has no memory for pictures of ${size} px.`);
    this.size = size;
  }

  #project({ time, cam_from_world: m, K, width, height }) {
    const { gl } = this, { header, arrays } = this.scene, t = Math.min(Math.max(time, 0), 1);
    const camera = {
      uRotation: [m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]],
      uEye: eyeOf(m),
      uLens: [K[0], K[4], K[2], K[5]],
      uSize: [width, height],
      uNear: header.near,
      uFrame: t * (header.frames - 1),
      uLight: header.light ? Array.from(rowAt(arrays.light, t)) : [0, 0, 0],
    };
    if (header.motion === "nodes") camera.uPoses = this.#nodes(t);
    const keys = header.motion === "paths" ? this.#keys(t) : null;
    camera.uBetween = keys ? keys.between : 0;
    const own = (kind) => (keys ? { uKey: keys.low[kind], uNextKey: keys.high[kind] } : {});
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.projected);
    this.#rows(0, this.gaussians);
    const counts = (first, count, still) => ({ uFirst: { int: first }, uCount: { int: count }, uStill: { int: still } });
    this.ofGaussians.use({ ...camera, ...this.gaussianTextures, ...own("g"), ...counts(0, this.gaussians, header.gaussians[0]) });
    this.#fill();
    if (!this.convexes) return;
    const convexes = { ...camera, ...this.convexTextures, ...own("c"), ...counts(this.gaussians, this.convexes, header.convexes[0]) };
    this.#rows(this.gaussians, this.gaussians + this.convexes);
    this.ofConvexes.use(convexes);
    this.#fill();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.edgeTarget);
    gl.viewport(0, 0, this.edges.width, this.edges.height);
    this.ofEdges.use({ ...convexes, uPlace: this.place });
    this.#fill();
  }

  // Only rows of texels with primitives `from` to `to` are drawn: without a graphics device the others would take as long.
  #rows(from, to) {
    const first = Math.floor(from / WIDTH);
    this.gl.viewport(0, first, this.place.width, Math.ceil(to / WIDTH) - first);
  }

  #nodes(t) {
    if (this.poses === null || this.posesTime !== t) {
      this.poses = numbers(this.gl, posesAt(this.scene, t), 4, { texture: this.poses });
      this.posesTime = t;
      this.uploads.poses += 1;
    }
    return this.poses;
  }

  // The textures of the keys around time t. Those of two keys are kept, and one is written again when time goes on to the next.
  #keys(t) {
    const { low, high, between } = keyAt(t, this.scene.header.keys);
    this.keys ??= [];
    const of = (key, other) => {
      let found = this.keys.find((one) => one.key === key);
      if (!found) {
        found = this.keys.length < 2 ? null : this.keys.find((one) => one.key !== other);
        if (!found) this.keys.push((found = {}));
        Object.assign(found, keyTextures(this.gl, this.scene, key, found), { key });
        this.uploads.keys += 1;
      }
      return found;
    };
    return { low: of(low, high), high: of(high, low), between };
  }
}

// The format in which colours add up: 16 bits a channel where there are floats; 32 without a graphics device, where they take half the time.
function pictureFormat(gl, software) {
  if (!gl.getExtension("EXT_color_buffer_float")) return gl.getExtension("EXT_color_buffer_half_float") ? gl.RGBA16F : gl.RGBA8;
  return software && gl.getExtension("EXT_float_blend") ? gl.RGBA32F : gl.RGBA16F;
}

// Whether the browser draws without a graphics device.
function drawsInSoftware(gl) {
  const known = gl.getExtension("WEBGL_debug_renderer_info");
  return SOFTWARE.test(gl.getParameter(known ? known.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}
