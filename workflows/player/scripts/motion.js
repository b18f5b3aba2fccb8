// Where things are at a time, on the CPU: poses of nodes (for the shaders and for sorting), keys of paths, and the depth of every centre.
import { turned } from "./camera.js";

// The key before time t in [0, 1], and the share of the way to the one after.
export function keyAt(t, keys) {
  const at = Math.min(Math.max(t, 0), 1) * (keys - 1), low = Math.max(0, Math.min(Math.floor(at), keys - 2));
  return { low, high: Math.min(low + 1, keys - 1), between: at - low };
}

// Row `t` of an array [keys, 1, c], linear between keys.
export function rowAt({ shape: [keys, , c], values }, t) {
  const { low, high, between } = keyAt(t, keys), row = new Float64Array(c);
  for (let k = 0; k < c; ++k) row[k] = values[low * c + k] + between * (values[high * c + k] - values[low * c + k]);
  return row;
}

// Turn (unit, w x y z), home, and where home is now, 4 numbers each, for every node at time t: Float32Array [12 B].
export function posesAt({ header, arrays }, t, out = new Float32Array(12 * header.nodes)) {
  const courses = rowAt(arrays.node_courses, t), modes = arrays.node_modes.values, homes = arrays.node_homes.values;
  const count = header.nodes, pose = new Float64Array(7 * count);
  for (let r = 0; r < header.modes; ++r)
    for (let i = 0, at = 7 * count * r, course = courses[r]; i < 7 * count; ++i, ++at) pose[i] += course * modes[at];
  for (let b = 0; b < count; ++b) {
    const w = 1 + pose[7 * b], x = pose[7 * b + 1], y = pose[7 * b + 2], z = pose[7 * b + 3];
    const norm = Math.max(Math.sqrt(w * w + x * x + y * y + z * z), 1e-6), at = 12 * b;
    out[at] = w / norm, out[at + 1] = x / norm, out[at + 2] = y / norm, out[at + 3] = z / norm;
    for (let j = 0; j < 3; ++j) out[at + 4 + j] = homes[3 * b + j], out[at + 8 + j] = homes[3 * b + j] + pose[7 * b + 4 + j];
  }
  return out;
}

// Frames over which a life's drift and spin are given: three spans, at most the whole clip, at least one.
export const reachOf = (logSpan, frames) => Math.min(Math.max(3 * Math.exp(logSpan), 1), Math.max(frames, 1));

// z of the middle of a convex whose corners are at depths `z`, or -Infinity if it is not drawn: in the antialiased mode corners nearer than
// `near` move to that plane, and otherwise such a convex is left out.
function middleOf(z, near, antialiased) {
  let sum = 0, front = false, behind = false;
  for (const one of z) {
    sum += antialiased ? Math.max(one, near) : one;
    front ||= one > near, behind ||= one < near;
  }
  return antialiased ? (front ? sum / z.length : -Infinity) : behind ? -Infinity : sum / z.length;
}

// v turned by the rotation vector `turn`, rad.
function turnedBy(v, turn) {
  const angle = Math.hypot(...turn);
  return angle < 1e-12 ? v : turned(v, turn.map((one) => one / angle), angle);
}

// The depths by which primitives are sorted: z of Gaussians, then of the middles of convexes, in a camera whose z is a x + b y + c z + d.
export class Depths {
  constructor(scene) {
    const { header, arrays } = scene;
    this.scene = scene;
    this.count = header.gaussians[0] + header.gaussians[1] + header.convexes[0] + header.convexes[1];
    this.depth = new Float32Array(this.count);
    const corners = Math.max(header.corners, 1), points = arrays.c_points.values, convexes = arrays.c_points.shape[0];
    const centroids = new Float32Array(3 * convexes);
    this.radius = new Float32Array(convexes);
    for (let i = 0; i < convexes; ++i) {
      for (let k = 0; k < corners; ++k) for (let j = 0; j < 3; ++j) centroids[3 * i + j] += points[3 * (i * corners + k) + j] / corners;
      for (let k = 0; k < corners; ++k)
        this.radius[i] = Math.max(this.radius[i], Math.hypot(...[0, 1, 2].map((j) => points[3 * (i * corners + k) + j] - centroids[3 * i + j])));
    }
    const kind = (name, at, centres, [still, moving], each) => ({ name, at, centres, still, moving, each });
    this.kinds = [kind("g", 0, arrays.g_means.values, header.gaussians, 1)];
    this.kinds.push(kind("c", arrays.g_means.shape[0], centroids, header.convexes, corners));
    this.last = "";  // camera and time of what `depth` holds
  }

  // Depths at time t; -Infinity for what is too faint then to be drawn.
  at(t, row) {
    const camera = row.join(), now = `${camera}/${t}`;
    if (now === this.last) return this.depth;
    const turned = !this.last.startsWith(`${camera}/`);
    for (const kind of this.kinds) {
      if (turned) this.#stand(kind, 0, kind.still, row);
      if (kind.moving) this.#move(kind, t, row);
    }
    this.last = now;
    return this.depth;
  }

  #stand({ name, at, centres }, from, to, [a, b, c, d]) {
    const depth = this.depth, { near } = this.scene.header;
    for (let i = from, j = 3 * from; i < to; ++i, j += 3) {
      depth[at + i] = a * centres[j] + b * centres[j + 1] + c * centres[j + 2] + d;
      if (name === "c" && depth[at + i] - this.radius[i] < near) depth[at + i] = this.#clipped(i, depth[at + i], [a, b, c], [0, 0, 0]);
    }
  }

  // The depth of convex i near the camera, with its middle at depth z and turned by `turn` since its rest.
  #clipped(i, z, [a, b, c], turn) {
    const { near, antialiased, corners } = this.scene.header, { centres } = this.kinds[1], points = this.scene.arrays.c_points.values;
    const deep = [];
    for (let k = 0; k < corners; ++k) {
      const arm = turnedBy([0, 1, 2].map((j) => points[3 * (i * corners + k) + j] - centres[3 * i + j]), turn);
      deep.push(z + a * arm[0] + b * arm[1] + c * arm[2]);
    }
    return middleOf(deep, near, antialiased);
  }

  #move(kind, t, row) {
    const { header, arrays } = this.scene, { name, at, centres, still, moving } = kind, depth = this.depth;
    if (header.motion === "lives") {
      const life = arrays[`${name}_life`].values, drift = arrays[`${name}_drift`].values, opacity = arrays[`${name}_opacity`].values;
      const frame = t * (header.frames - 1), [a, b, c, d] = row;
      for (let i = 0, j = 3 * still; i < moving; ++i, j += 3) {
        const age = frame - life[2 * i], shares = age * Math.exp(-life[2 * i + 1]);
        if (opacity[still + i] * Math.exp(-0.5 * shares * shares) < 1 / 255) {
          depth[at + still + i] = -Infinity;
          continue;
        }
        const s = age / reachOf(life[2 * i + 1], header.frames), k = 3 * i;
        depth[at + still + i] =
          a * (centres[j] + s * drift[k]) + b * (centres[j + 1] + s * drift[k + 1]) + c * (centres[j + 2] + s * drift[k + 2]) + d;
        if (name === "c" && depth[at + still + i] - this.radius[still + i] < header.near) {
          const turn = [0, 1, 2].map((n) => s * arrays.c_spin.values[k + n]);
          depth[at + still + i] = this.#clipped(still + i, depth[at + still + i], row, turn);
        }
      }
    } else if (header.motion === "nodes") {
      this.#carry(kind, t, row);
    } else {
      this.#follow(kind, t, row);
    }
  }

  // z of a point that nodes carry is a weighted sum over them of one linear function of the point each.
  #carry({ name, at, centres, still, moving, each }, t, [a, b, c, d]) {
    const { header, arrays } = this.scene, poses = posesAt(this.scene, t, this.poses), depth = this.depth;
    this.poses = poses;
    const linear = new Float64Array(4 * header.nodes);
    for (let n = 0, p = 0; n < header.nodes; ++n, p += 12) {
      const [w, x, y, z] = poses.subarray(p, p + 4);
      const u = a * (1 - 2 * (y * y + z * z)) + b * 2 * (x * y + w * z) + c * 2 * (x * z - w * y);
      const v = a * 2 * (x * y - w * z) + b * (1 - 2 * (x * x + z * z)) + c * 2 * (y * z + w * x);
      const s = a * 2 * (x * z + w * y) + b * 2 * (y * z - w * x) + c * (1 - 2 * (x * x + y * y));
      linear[4 * n] = u, linear[4 * n + 1] = v, linear[4 * n + 2] = s;
      const home = u * poses[p + 4] + v * poses[p + 5] + s * poses[p + 6];
      linear[4 * n + 3] = a * poses[p + 8] + b * poses[p + 9] + c * poses[p + 10] + d - home;
    }
    const links = arrays[`${name}_links`].values, weights = arrays[`${name}_weights`].values;
    const points = name === "g" ? centres : arrays.c_points.values;
    const { near, antialiased } = header, deep = new Float64Array(each);
    for (let i = 0; i < moving; ++i) {
      for (let k = 0; k < each; ++k) {
        const point = i * each + k, j = 3 * (still * each + point), l = 4 * point, m = 3 * point;
        const x = points[j], y = points[j + 1], z = points[j + 2];
        const w0 = weights[m], w1 = weights[m + 1], w2 = weights[m + 2], w3 = 1 - w0 - w1 - w2;
        const n0 = 4 * links[l], n1 = 4 * links[l + 1], n2 = 4 * links[l + 2], n3 = 4 * links[l + 3];
        const mean = (q) => w0 * linear[n0 + q] + w1 * linear[n1 + q] + w2 * linear[n2 + q] + w3 * linear[n3 + q];
        deep[k] = mean(0) * x + mean(1) * y + mean(2) * z + mean(3);
      }
      depth[at + still + i] = name === "g" ? deep[0] : middleOf(deep, near, antialiased);
    }
  }

  #follow({ name, at, centres, still, moving, each }, t, [a, b, c, d]) {
    const { header, arrays } = this.scene, depth = this.depth, { near, antialiased } = header, deep = new Float64Array(each);
    const { shape: [keys], values } = arrays[name === "g" ? "g_path_means" : "c_path_points"];
    const points = name === "g" ? centres : arrays.c_points.values;
    const { low, high, between } = keyAt(t, keys), size = 3 * moving * each, before = low * size, after = high * size;
    for (let i = 0; i < moving; ++i) {
      for (let k = 0; k < each; ++k) {
        const j = 3 * (i * each + k), p = before + j, q = after + j, r = 3 * still * each + j, s = 1 - between;
        const x = points[r] + s * values[p] + between * values[q], y = points[r + 1] + s * values[p + 1] + between * values[q + 1];
        deep[k] = a * x + b * y + c * (points[r + 2] + s * values[p + 2] + between * values[q + 2]) + d;
      }
      depth[at + still + i] = name === "g" ? deep[0] : middleOf(deep, near, antialiased);
    }
  }
}
