// Sorts primitives by depth, nearest first: a counting sort in two passes over 24 bits of the depths' own bits, which are in order for
// positive floats. Equal depths keep their order, so Gaussians stay before convexes.

const DIGIT = 12, DIGITS = 1 << DIGIT;

export class Sorter {
  constructor(count) {
    this.first = new Uint32Array(count);   // numbers of those that are drawn
    this.keys = new Uint32Array(count);
    this.second = new Uint32Array(count);  // both after the first pass
    this.digits = new Uint32Array(count);
    this.low = new Uint32Array(DIGITS);
    this.high = new Uint32Array(DIGITS);
  }

  // Fills `order` with the numbers of the primitives at `depth` `near` or beyond, and returns how many there are. Only those in `ranges`
  // ([from, to) each) are looked at.
  sort(depth, near, order, ranges = [[0, depth.length]]) {
    const { first, keys, second, digits, low, high } = this, bits = new Uint32Array(depth.buffer, depth.byteOffset, depth.length);
    let count = 0, least = 0xffffffff, most = 0;
    for (const [from, to] of ranges)
      for (let i = from; i < to; ++i) {
        if (!(depth[i] >= near)) continue;
        const key = bits[i];
        first[count++] = i;
        if (key < least) least = key;
        if (key > most) most = key;
      }
    const shift = Math.max(0, 32 - Math.clz32(most - least) - 2 * DIGIT);
    low.fill(0), high.fill(0);
    for (let i = 0; i < count; ++i) {
      const key = (bits[first[i]] - least) >>> shift;
      keys[i] = key;
      low[key & (DIGITS - 1)]++, high[key >>> DIGIT]++;
    }
    for (let d = 0, a = 0, b = 0; d < DIGITS; ++d) {
      const x = low[d], y = high[d];
      low[d] = a, high[d] = b;
      a += x, b += y;
    }
    for (let i = 0; i < count; ++i) {
      const key = keys[i], at = low[key & (DIGITS - 1)]++;
      second[at] = first[i], digits[at] = key >>> DIGIT;
    }
    for (let i = 0; i < count; ++i) order[high[digits[i]]++] = second[i];
    return count;
  }
}
