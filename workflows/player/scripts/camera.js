// The camera that a visitor moves: a pose in the world, turned about a target or about itself. Axes are OpenCV's (x right, y down, z forward).

const add = (a, b, s = 1) => a.map((x, k) => x + s * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const size = Math.hypot(...a);
  return size > 1e-12 ? a.map((x) => x / size) : [0, 0, 1];
};
const MOST_TILT = Math.cos((3 * Math.PI) / 180);  // the view stays so far from straight up and down

// v turned by `angle` about the unit `axis`.
export function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(v, axis) * (1 - c), side = cross(axis, v);
  return v.map((x, k) => c * x + s * side[k] + along * axis[k]);
}

// Where the camera of a cam_from_world is.
export const eyeOf = (m) => [0, 1, 2].map((j) => -(m[j] * m[3] + m[4 + j] * m[7] + m[8 + j] * m[11]));

export class Camera {
  constructor({ up, target, cameras }) {
    this.up = unit(up);
    this.goal = target;
    if (cameras.length) this.jump(cameras[0]);
    else this.#look([target[0], target[1], target[2] - 3], target, { width: 4, height: 3, K: [4, 0, 2, 0, 4, 1.5, 0, 0, 1] });
  }

  // Takes the place of a capture's camera.
  jump({ cam_from_world: m, K, width, height }) {
    this.right = [m[0], m[1], m[2]], this.down = [m[4], m[5], m[6]], this.forward = [m[8], m[9], m[10]];
    this.eye = eyeOf(m);
    this.lens = { K, width, height };
    this.target = this.goal.slice();
    const ahead = dot(add(this.goal, this.eye, -1), this.forward);
    if (!(ahead > 1e-6)) this.target = add(this.eye, this.forward, Math.max(Math.hypot(...add(this.goal, this.eye, -1)), 1));
  }

  #look(eye, target, lens) {
    this.eye = eye, this.target = target.slice(), this.lens = lens;
    this.forward = unit(add(target, eye, -1));
    this.right = unit(cross(this.forward, this.up));
    this.down = cross(this.forward, this.right);
  }

  get distance() {
    return Math.max(Math.hypot(...add(this.target, this.eye, -1)), 1e-6);
  }

  // Turns the view by angles about the scene's up and about its own right; about the target, or on the spot.
  turn(yaw, pitch, aboutTarget) {
    const tilt = dot(turned(this.forward, this.right, pitch), this.up);
    const steep = Math.abs(tilt) > MOST_TILT && Math.abs(tilt) > Math.abs(dot(this.forward, this.up));
    const right = this.right, spin = (v) => turned(steep ? v : turned(v, right, pitch), this.up, yaw);
    const arm = spin(add(this.eye, this.target, -1));
    [this.right, this.down, this.forward] = [this.right, this.down, this.forward].map(spin);
    if (aboutTarget) this.eye = add(this.target, arm);
    else this.target = add(this.eye, this.forward, Math.hypot(...arm));
    this.#square();
  }

  #square() {  // rounding adds up over thousands of turns
    this.forward = unit(this.forward);
    this.right = unit(add(this.right, this.forward, -dot(this.right, this.forward)));
    this.down = cross(this.forward, this.right);
  }

  // Moves sideways in the picture by shares of the distance to the target.
  slide(x, y) {
    const step = add(this.right.map((v) => v * x), this.down, y).map((v) => v * this.distance);
    this.eye = add(this.eye, step), this.target = add(this.target, step);
  }

  // Goes nearer to the target by a factor.
  approach(factor) {
    this.eye = add(this.target, add(this.eye, this.target, -1), factor);
  }

  // Flies by world units along right, up and forward.
  fly(right, up, forward) {
    const step = add(add(this.right.map((v) => v * right), this.up, up), this.forward, forward);
    this.eye = add(this.eye, step), this.target = add(this.target, step);
  }

  // Pose and intrinsics for a picture of width x height px that shows at least what the capture's camera saw.
  view(width, height) {
    const { K, width: w, height: h } = this.lens, s = Math.min(width / w, height / h);
    const rows = [this.right, this.down, this.forward];
    return {
      cam_from_world: [...rows.flatMap((r) => [...r, -dot(r, this.eye)]), 0, 0, 0, 1],
      K: [s * K[0], 0, width / 2 + s * (K[2] - w / 2), 0, s * K[4], height / 2 + s * (K[5] - h / 2), 0, 0, 1],
      width,
      height,
    };
  }
}

// What `e4dgs.show` takes: a view is refused in words before anything is changed by it.

const RIGID = 1e-3;  // how far rows of a rotation may be from unit length and right angles

const areNumbers = (list, count) => list?.length === count && Array.from(list).every(Number.isFinite);

// Throws a TypeError for what is no view, and a RangeError for a picture of more than `most` px along a side.
export function checkView({ time, cam_from_world: m, K, width, height } = {}, most) {
  const good = (condition, message) => {
    if (!condition) throw new TypeError(`show: ${message}`);
  };
  good(time >= 0 && time <= 1, "time must be a number in [0, 1]");
  good(areNumbers(m, 16), "cam_from_world must be 16 finite numbers, row by row");
  good(isRigid(m), "cam_from_world must be a rotation and a shift (rows of unit length at right angles, right-handed, then 0 0 0 1)");
  good(areNumbers(K, 9), "K must be 9 finite numbers, row by row");
  good(K[0] > 0 && K[4] > 0, "the focal lengths in K must be positive");
  good(K[1] === 0 && K[3] === 0 && K[6] === 0 && K[7] === 0 && K[8] === 1, "K must be fx 0 cx, 0 fy cy, 0 0 1");
  for (const size of [width, height]) good(Number.isInteger(size) && size >= 1, "width and height must be whole numbers of px");
  if (Math.max(width, height) > most) throw new RangeError(`show: ${width}x${height} px is more than this device draws (${most} px a side)`);
}

// Whether 16 numbers, row by row, are a rotation and a shift.
export function isRigid(m) {
  const [x, y, z] = [0, 4, 8].map((k) => [m[k], m[k + 1], m[k + 2]]);
  const off = [dot(x, x) - 1, dot(y, y) - 1, dot(z, z) - 1, dot(x, y), dot(cross(x, y), z) - 1, m[12], m[13], m[14], m[15] - 1];
  return off.every((one) => Math.abs(one) <= RIGID);
}

// What the page's address asks for after its "#", which works without a server too: `time=0.3&camera=2&play=0&controls=0`. cameras: how many
// there are; they count from 1. What is refused is left out, and `warn` hears why.
export function askedIn(hash, cameras, warn) {
  const between = (from, to) => (text) => (text.trim() && Number(text) >= from && Number(text) <= to ? Number(text) : null);
  const camera = (text) => (/^\d+$/.test(text) ? between(1, cameras)(text) : null), onOrOff = (text) => (text === "0" || text === "1" ? text === "1" : null);
  const known = { time: [between(0, 1), "a number in [0, 1]"], camera: [camera, `one of the scene's ${cameras} cameras, from 1 on`] };
  known.play = known.controls = [onOrOff, "0 or 1"];
  const found = {};
  for (const [name, text] of new URLSearchParams(hash.slice(1))) {
    const [read, words] = Object.hasOwn(known, name) ? known[name] : [() => null, `one of ${Object.keys(known).join(", ")}, each with a value`];
    const value = read(text);
    if (value === null) warn(`The page's address: "${name}=${text}" after # is left out; it must be ${words}.`);
    else found[name] = value;
  }
  return found;
}
