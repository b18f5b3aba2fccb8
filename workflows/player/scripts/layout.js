// Which arrays a scene has, and of which shapes: the same rules as scene/formats/web/layout.py.
import { expect } from "./container.js";
import { isRigid } from "./camera.js";

export const MOTIONS = ["static", "lives", "nodes", "paths"];
const LINKS = 4;  // nodes that carry a point
const MOST = 2 ** 24;  // primitives, nodes, keys, frames

const isWhole = (x) => Number.isSafeInteger(x) && x >= 0 && x <= MOST;
const areNumbers = (list, count) => Array.isArray(list) && list.length === count && list.every(Number.isFinite);

// Throws an Error that says what is wrong with a header or its arrays.
export function checkScene({ header, arrays }) {
  const good = (condition, name) => expect(condition, `The scene's field ${name} is damaged.`);
  for (const name of ["background", "up", "target"]) good(areNumbers(header[name], 3), name);
  for (const name of ["gaussians", "convexes"]) good(areNumbers(header[name], 2) && header[name].every(isWhole), name);
  for (const [name, most] of [["corners", 8], ["sh_degree", 3], ["frames", MOST], ["keys", MOST], ["nodes", MOST], ["modes", 4096]])
    good(isWhole(header[name]) && header[name] <= most, name);
  good(MOTIONS.includes(header.motion), "motion");
  good(header.convexes[0] + header.convexes[1] === 0 || header.corners >= 3, "corners");
  good(!["nodes", "paths"].includes(header.motion) || header.keys >= 1, "keys");
  good(header.frames >= 1, "frames");
  for (const name of ["light", "antialiased"]) good(typeof header[name] === "boolean", name);
  good(!header.light || header.motion === "nodes", "light");
  good(Number.isFinite(header.near) && header.near >= 1e-12 && header.near <= 1e12, "near");
  good(Number.isFinite(header.seconds) && header.seconds >= 0, "seconds");
  good(Array.isArray(header.cameras) && header.cameras.length <= 10000, "cameras");
  const windows = header.windows ?? [];
  good(Array.isArray(windows) && windows.length <= 10000 && (!windows.length || header.motion === "lives"), "windows");
  for (const one of windows) good(areNumbers(one, 4) && one.slice(2).every(isWhole), "windows");
  for (const name of ["gaussians", "convexes"]) good(header[name][0] + header[name][1] + laterRows(header, 0, name) <= MOST, "windows");
  for (const camera of header.cameras) {
    const numbers = [camera?.time, camera?.width, camera?.height].every(Number.isFinite);
    good(numbers && camera.width > 0 && camera.height > 0 && typeof camera.name === "string", "cameras");
    good(areNumbers(camera.cam_from_world, 16) && isRigid(camera.cam_from_world), "cameras");
    good(areNumbers(camera.K, 9) && camera.K[0] > 0 && camera.K[4] > 0, "cameras");
  }
  const wanted = shapesOf(header);
  for (const name of new Set([...Object.keys(wanted), ...Object.keys(arrays)])) {
    const given = arrays[name]?.shape;
    expect(wanted[name] && given && given.every((x, k) => x === wanted[name][k]), `The scene's array ${name} has the wrong shape.`);
  }
  for (const name of ["g_links", "c_links"])
    expect((arrays[name]?.values ?? []).every((node) => node >= 0 && node < header.nodes), `The scene's array ${name} is damaged.`);
}

// How many primitives of a kind window k and those after it hold.
export function laterRows({ windows = [] }, k, name) {
  return windows.slice(k).reduce((sum, one) => sum + one[name === "gaussians" ? 2 : 3], 0);
}

// The header of a scene with all its windows, and of its arrays those in `names`, with room for what the windows hold, which comes last. Until it
// is there, nothing of it is seen.
export function withRoom({ header, arrays }, names) {
  const counts = ["gaussians", "convexes"].map((name) => [name, [header[name][0], header[name][1] + laterRows(header, 0, name)]]);
  const whole = { ...header, ...Object.fromEntries(counts) }, shapes = shapesOf(whole), room = {};
  for (const name of names.filter((one) => shapes[one])) {
    const shape = shapes[name];
    room[name] = { shape, values: new Float32Array(shape[0] * shape[1] * shape[2]) };
    room[name].values.set(arrays[name].values);
  }
  return { header: whole, arrays: room };
}

// Throws an Error if `part` is not window k of the scene with this header.
export function checkWindow(part, header, k) {
  checkScene(part);
  const same = ["motion", "corners", "sh_degree", "frames"].every((name) => part.header[name] === header[name]);
  const { gaussians, convexes } = part.header, [, , g, c] = header.windows[k];
  expect(same && `${gaussians}/${convexes}` === `0,${g}/0,${c}`, "It belongs to another scene.");
}

// Puts the primitives of window k into such arrays.
export function placeRows({ header, arrays }, part, k) {
  for (const [name, { shape: [rows], values }] of Object.entries(arrays)) {
    const later = laterRows(header, k, name.startsWith("g_") ? "gaussians" : "convexes");
    values.set(part.arrays[name].values, (values.length / rows) * (rows - later));
  }
}

export function shapesOf(header) {
  const { corners, keys, nodes, modes, motion, light } = header;
  const [gaussians, convexes] = [header.gaussians, header.convexes].map(([still, moving]) => still + moving);
  const moving = header.gaussians[1], bending = header.convexes[1];
  const shapes = { g_means: [gaussians, 1, 3], g_turns: [gaussians, 1, 3], g_scales: [gaussians, 1, 3] };
  Object.assign(shapes, { c_points: [convexes, corners, 3], c_shape: [convexes, 1, 2] });
  for (const [kind, count] of [["g", gaussians], ["c", convexes]]) {
    shapes[`${kind}_opacity`] = [count, 1, 1];
    shapes[`${kind}_color`] = [count, 1, 3];
    for (let d = 1; d <= header.sh_degree; ++d) shapes[`${kind}_sh${d}`] = [count, 1, 3 * (2 * d + 1)];
    if (light) shapes[`${kind}_shades`] = [count, 1, 3];
  }
  if (light) shapes.light = [keys, 1, 3];
  if (motion === "lives")
    for (const [kind, count] of [["g", moving], ["c", bending]])
      Object.assign(shapes, { [`${kind}_life`]: [count, 1, 2], [`${kind}_drift`]: [count, 1, 3], [`${kind}_spin`]: [count, 1, 3] });
  if (motion === "nodes") {
    Object.assign(shapes, { node_homes: [nodes, 1, 3], node_modes: [modes, nodes, 7], node_courses: [keys, 1, modes] });
    Object.assign(shapes, { g_links: [moving, 1, LINKS], g_weights: [moving, 1, LINKS - 1] });
    Object.assign(shapes, { c_links: [bending, corners, LINKS], c_weights: [bending, corners, LINKS - 1] });
  }
  if (motion === "paths") {
    Object.assign(shapes, { g_path_means: [keys, moving, 3], g_path_turns: [keys, moving, 4], g_path_scales: [keys, moving, 3] });
    shapes.c_path_points = [keys, bending * corners, 3];
  }
  return shapes;
}

// Which primitives can be shown alone, by the names that `e4dgs view` has for them, and where these are in the order of a scene.

export const LAYERS = ["all", "Gaussians", "convexes", "dynamic", "static"];

// [from, to) of the numbers of primitives in a layer.
export function rangesOf({ gaussians: [still, moving], convexes: [stiff, bending] }, layer) {
  const g = still + moving, total = g + stiff + bending;
  return {
    all: [[0, total]],
    Gaussians: [[0, g]],
    convexes: [[g, total]],
    dynamic: [[still, g], [g + stiff, total]],
    static: [[0, still], [g, g + stiff]],
  }[layer];
}

// The layers that are neither empty nor all there is, after "all".
export function layersOf(header) {
  const size = (layer) => rangesOf(header, layer).reduce((sum, [from, to]) => sum + to - from, 0);
  return LAYERS.filter((layer) => layer === "all" || (size(layer) > 0 && size(layer) < size("all")));
}
