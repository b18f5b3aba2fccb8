// A scene's arrays as textures: one set for Gaussians and one for convexes, named as the shaders' uniforms. With an `old` set, the primitives of
// `scene` are written into it: from number `at` of its kind on, and from number `moving` of those that move.
import { numbers } from "./gpu.js";
import { reachOf } from "./motion.js";

export function gaussianTextures(gl, { header, arrays }, old = {}, at = 0, moving = 0) {
  const put = putter(gl, old, at, header.gaussians[0] + header.gaussians[1]);
  const count = arrays.g_means.shape[0], means = arrays.g_means.values, opacity = arrays.g_opacity.values, three = arrays.g_turns.values;
  const first = new Float32Array(4 * count), turns = new Float32Array(4 * count), scales = new Float32Array(4 * count);
  for (let i = 0, a = 0, b = 0; i < count; ++i, a += 4, b += 3) {
    const x = three[b], y = three[b + 1], z = three[b + 2];
    turns[a] = Math.sqrt(Math.max(0, 1 - x * x - y * y - z * z)), turns[a + 1] = x, turns[a + 2] = y, turns[a + 3] = z;
    for (let j = 0; j < 3; ++j) first[a + j] = means[b + j], scales[a + j] = Math.exp(arrays.g_scales.values[b + j]);
    first[a + 3] = Math.min(Math.max(opacity[i], 0), 1);
  }
  const found = { uMeans: put("uMeans", first, 4), uTurns: put("uTurns", turns, 4), uScales: put("uScales", scales, 4) };
  return Object.assign(found, shared(gl, header, arrays, "g", count, put, putter(gl, old, moving, header.gaussians[1])));
}

export function convexTextures(gl, { header, arrays }, old = {}, at = 0, moving = 0) {
  const put = putter(gl, old, at, header.convexes[0] + header.convexes[1]);
  const count = arrays.c_points.shape[0], shapes = new Float32Array(4 * count);
  for (let i = 0; i < count; ++i) {
    shapes[4 * i] = Math.exp(arrays.c_shape.values[2 * i]), shapes[4 * i + 1] = Math.exp(arrays.c_shape.values[2 * i + 1]);
    shapes[4 * i + 2] = Math.min(Math.max(arrays.c_opacity.values[i], 0), 1);
  }
  const found = { uPoints: put("uPoints", widened(arrays.c_points.values, 3), 4, header.corners), uShapes: put("uShapes", shapes, 4) };
  return Object.assign(found, shared(gl, header, arrays, "c", count, put, putter(gl, old, moving, header.convexes[1])));
}

// Writes the texture of a name, which has `each` texels for a primitive, from primitive `at` on; a new one has room for `room` of them.
function putter(gl, old, at, room) {
  return (name, values, components, each = 1, half = false) =>
    numbers(gl, values, components, { half, texture: old[name], at: at * each, room: room * each });
}

// SH, shades, and what the motion knows of each. put: for all of a kind; putMoving: for those that move.
function shared(gl, header, arrays, kind, count, put, putMoving) {
  const found = { uSh: put("uSh", harmonics(header, arrays, kind, count), 3, (header.sh_degree + 1) ** 2, true) };
  if (header.light) found.uShades = put("uShades", widened(arrays[`${kind}_shades`].values, 3), 4);
  if (header.motion === "lives") {
    const [life, drift, spin] = ["life", "drift", "spin"].map((name) => arrays[`${kind}_${name}`].values);
    const lives = new Float32Array(4 * life.length);
    for (let i = 0, a = 0; i < life.length / 2; ++i, a += 8) {
      const reach = reachOf(life[2 * i + 1], header.frames);
      lives[a] = life[2 * i], lives[a + 1] = Math.exp(-life[2 * i + 1]);
      for (let j = 0; j < 3; ++j) lives[a + 2 + j] = drift[3 * i + j] / reach, lives[a + 5 + j] = spin[3 * i + j] / reach;
    }
    found.uLives = putMoving("uLives", lives, 4, 2);
  }
  if (header.motion === "nodes") {
    const weights = widened(arrays[`${kind}_weights`].values, 3);
    for (let a = 0; a < weights.length; a += 4) weights[a + 3] = 1 - weights[a] - weights[a + 1] - weights[a + 2];
    Object.assign(found, { uLinks: numbers(gl, arrays[`${kind}_links`].values, 4), uWeights: numbers(gl, weights, 4) });
  }
  return found;
}

// [count * coefficients, 3]: a texel for each coefficient.
function harmonics(header, arrays, kind, count) {
  const coefficients = (header.sh_degree + 1) ** 2, all = new Float32Array(3 * coefficients * count);
  const bands = [arrays[`${kind}_color`]];
  for (let d = 1; d <= header.sh_degree; ++d) bands.push(arrays[`${kind}_sh${d}`]);
  let start = 0;
  for (const { shape: [, , c], values } of bands) {
    for (let i = 0; i < count; ++i) for (let k = 0; k < c; ++k) all[3 * coefficients * i + start + k] = values[c * i + k];
    start += c;
  }
  return all;
}

// Rows of `columns` numbers as rows of four.
function widened(values, columns) {
  const rows = values.length / columns, wide = new Float32Array(4 * rows);
  for (let i = 0; i < rows; ++i) for (let k = 0; k < columns; ++k) wide[4 * i + k] = values[columns * i + k];
  return wide;
}

// One key of paths: three texels for each Gaussian (shift, turn, growth), one for each corner of a convex.
export function keyTextures(gl, { arrays }, key, old) {
  const row = (name) => {
    const { shape: [, m, c], values } = arrays[name];
    return values.subarray(key * m * c, (key + 1) * m * c);
  };
  const [means, turns, scales] = ["means", "turns", "scales"].map((name) => row(`g_path_${name}`)), count = means.length / 3;
  const all = new Float32Array(12 * count);
  for (let i = 0; i < count; ++i) {
    for (let j = 0; j < 3; ++j) all[12 * i + j] = means[3 * i + j], all[12 * i + 8 + j] = scales[3 * i + j];
    for (let j = 0; j < 4; ++j) all[12 * i + 4 + j] = turns[4 * i + j];
  }
  return { g: numbers(gl, all, 4, { texture: old?.g }), c: numbers(gl, widened(row("c_path_points"), 3), 4, { texture: old?.c }) };
}
