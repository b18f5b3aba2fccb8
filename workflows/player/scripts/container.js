// Reads the file of a scene: a JSON header and one zlib stream of arrays (docs/player.md). Nothing in it is believed before it is checked.

const MAGIC = "E4DW", VERSION = 1;
const MOST_HEADER = 1 << 24, MOST_DATA = 2 ** 30, MOST_NUMBERS = 2 ** 28;  // bytes, bytes, numbers of an array

// The header, and for each array its shape [n, m, c] and values, a Float32Array ordered by n, then m, then c.
export async function readContainer(bytes) {
  expect(bytes.length >= 4 && String.fromCharCode(...bytes.subarray(0, 4)) === MAGIC, "This is not a scene of this player.");
  expect(bytes.length >= 12, "The scene's file is cut short.");
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const version = view.getUint32(4, true), length = view.getUint32(8, true);
  expect(version === VERSION, `The scene's version is ${version}, and this player shows version ${VERSION}.`);
  expect(length <= MOST_HEADER && bytes.length >= 12 + length, "The scene's file is cut short.");
  const header = parsed(bytes.subarray(12, 12 + length));
  const said = header.arrays.map(checkedArray);
  expect(new Set(said.map((one) => one.name)).size === said.length, "Two of the scene's arrays have one name.");
  const total = said.reduce((sum, one) => sum + bytesOf(one), 0);
  expect(total <= MOST_DATA, "The scene claims more data than this player reads.");
  const data = await inflated(bytes.subarray(12 + length), total);
  const arrays = {};
  let at = 0;
  for (const one of said) {
    arrays[one.name] = { shape: one.shape, values: decoded(one, data.subarray(at, at + bytesOf(one))) };
    at += bytesOf(one);
  }
  return { header, arrays };
}

export function expect(condition, message) {
  if (!condition) throw new Error(message);
}

function parsed(bytes) {
  let header = null;
  try {
    header = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
  } catch {
    // said below
  }
  expect(header !== null && typeof header === "object" && Array.isArray(header.arrays), "The scene's header is damaged.");
  return header;
}

const isWhole = (x) => Number.isSafeInteger(x) && x >= 0;

function checkedArray(one) {
  const { name, shape, planes, low = [], step = [], delta = false } = one ?? {};
  expect(typeof name === "string", "One of the scene's arrays has no name.");
  const fits = Array.isArray(shape) && shape.length === 3 && shape.every(isWhole) && shape[0] * shape[1] * shape[2] <= MOST_NUMBERS;
  expect(fits, `The scene's array ${name} has no shape.`);
  expect(isWhole(planes) && planes <= 4, `The numbers of the scene's array ${name} have no size.`);
  const columns = planes ? shape[2] : 0;
  for (const numbers of [low, step])
    expect(Array.isArray(numbers) && numbers.length === columns && numbers.every(Number.isFinite), `The scene's array ${name} has no steps.`);
  return { name, shape, planes, low, step, delta };
}

const bytesOf = ({ shape, planes }) => shape[0] * shape[1] * shape[2] * (planes || 4);

async function inflated(bytes, total) {
  expect(typeof DecompressionStream === "function", "This browser is too old for the scene, which it cannot unpack. Try a newer one.");
  const out = new Uint8Array(total);
  let filled = 0;
  try {
    const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (filled + value.length > total) {
        await reader.cancel();
        filled = NaN;
        break;
      }
      out.set(value, filled);
      filled += value.length;
    }
  } catch {
    filled = NaN;
  }
  expect(filled === total, "The scene's data are damaged or cut short.");
  return out;
}

// The bytes of an array lie by column, then plane (least significant first), then row.
function decoded({ shape: [n, m, c], planes, low, step, delta }, data) {
  const rows = n * m, values = new Float32Array(rows * c);
  if (!planes) {
    const bits = new Uint32Array(rows * c);
    gather(data, bits, rows, c, 4);
    const floats = new Float32Array(bits.buffer);
    for (let k = 0; k < c; ++k) for (let i = 0; i < rows; ++i) values[i * c + k] = floats[k * rows + i];
    return values;
  }
  const whole = new Uint32Array(rows * c);
  gather(data, whole, rows, c, planes);
  const before = new Float64Array(m);
  for (let k = 0; k < c; ++k) {
    before.fill(0);
    for (let i = 0, at = k * rows; i < rows; ++i, ++at) {
      let q = whole[at];
      if (delta) q = before[i % m] += q & 1 ? -(q + 1) / 2 : q / 2;
      values[i * c + k] = low[k] + step[k] * q;
    }
  }
  return values;
}

function gather(data, whole, rows, c, planes) {
  for (let k = 0; k < c; ++k)
    for (let p = 0; p < planes; ++p) {
      const from = (k * planes + p) * rows, to = k * rows, shift = 8 * p;
      for (let i = 0; i < rows; ++i) whole[to + i] |= data[from + i] << shift;
    }
}
