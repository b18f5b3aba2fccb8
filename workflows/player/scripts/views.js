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
  const row = (k) => [m[4 * k], m[4 * k + 1], m[4 * k + 2]], dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const [x, y, z] = [row(0), row(1), row(2)];
  const turned = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
  const off = [dot(x, x) - 1, dot(y, y) - 1, dot(z, z) - 1, dot(x, y), dot(turned, z) - 1, m[12], m[13], m[14], m[15] - 1];
  return off.every((one) => Math.abs(one) <= RIGID);
}
