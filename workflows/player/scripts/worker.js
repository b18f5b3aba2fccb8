// What happens beside the page's own thread: the scene is decoded once, then primitives are sorted for each camera and time that is asked.
import { readContainer } from "./container.js";
import { checkScene, checkWindow, placeRows, rangesOf, withRoom } from "./layout.js";
import { Depths } from "./motion.js";

const KEPT = ["g_means", "c_points", "g_opacity", "c_opacity", "g_life", "g_drift", "c_life", "c_drift", "c_spin", "node_homes", "node_modes"];
KEPT.push("node_courses", "g_links", "g_weights", "c_links", "c_weights", "g_path_means", "c_path_points", "light");

const DIGIT = 12, DIGITS = 1 << DIGIT;

// Sorts primitives by depth, nearest first: a counting sort in two passes over 24 bits of the depths' own bits, which are in order for
// positive floats. Equal depths keep their order, so Gaussians stay before convexes.
export class Sorter {
  constructor(count) {
    this.first = new Uint32Array(count);  // numbers of those that are drawn
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

// Answers messages with `post(message, transferred)`.
export class Answers {
  constructor(post) {
    this.post = post;
    this.spare = [];
  }

  async take(message) {
    try {
      if (message.kind === "open") await this.#open(message.bytes);
      if (message.kind === "add") await this.#add(message);
      if (message.kind === "sort") this.#sort(message);
    } catch (error) {
      this.post({ kind: "failed", message: error.message });
    }
  }

  async #open(bytes) {
    const { header, arrays } = await readContainer(bytes);
    checkScene({ header, arrays });
    const scene = withRoom({ header, arrays }, KEPT);
    this.depths = new Depths(scene);
    this.sorter = new Sorter(this.depths.count);
    this.post({ kind: "opened", scene: { header: scene.header, arrays, parts: [] } }, buffersOf(arrays));
  }

  async #add({ id, bytes, window }) {
    try {
      const part = await readContainer(bytes), { scene } = this.depths;
      checkWindow(part, scene.header, window);
      placeRows(scene, part, window);
      this.depths = new Depths(scene);
      this.post({ kind: "added", id, part }, buffersOf(part.arrays));
    } catch (error) {
      this.post({ kind: "refused", id, message: error.message });
    }
  }

  #sort({ id, time, row, layer, order }) {
    const start = performance.now(), { depths } = this, { header } = depths.scene;
    const result = order ?? new Uint32Array(depths.count);
    const count = this.sorter.sort(depths.at(time, row), header.near, result, rangesOf(header, layer));
    this.post({ kind: "sorted", id, order: result, count, milliseconds: performance.now() - start }, [result.buffer]);
  }
}

const buffersOf = (arrays) => Object.values(arrays).map(({ values }) => values.buffer);

// The code of a worker, or the page's own thread where there are none.
export function answersTo(scope) {
  const answers = new Answers((message, moved) => scope.postMessage(message, moved));
  scope.onmessage = (event) => answers.take(event.data);
  scope.postMessage({ kind: "there" });
}
