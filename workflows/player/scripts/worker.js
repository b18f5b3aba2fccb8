// What happens beside the page's own thread: the scene is decoded once, then primitives are sorted for each camera and time that is asked.
import { readContainer } from "./container.js";
import { checkScene, rangesOf } from "./layout.js";
import { Depths } from "./motion.js";
import { Sorter } from "./sort.js";

const KEPT = ["g_means", "c_points", "g_opacity", "c_opacity", "g_life", "g_drift", "c_life", "c_drift", "c_spin", "node_homes", "node_modes"];
KEPT.push("node_courses", "g_links", "g_weights", "c_links", "c_weights", "g_path_means", "c_path_points", "light");

// Answers messages with `post(message, transferred)`.
export class Answers {
  constructor(post) {
    this.post = post;
    this.spare = [];
  }

  async take(message) {
    try {
      if (message.kind === "open") await this.#open(message.bytes);
      if (message.kind === "sort") this.#sort(message);
    } catch (error) {
      this.post({ kind: "failed", message: error.message });
    }
  }

  async #open(bytes) {
    const scene = await readContainer(bytes);
    checkScene(scene);
    this.depths = new Depths(scene);
    this.sorter = new Sorter(this.depths.count);
    const moved = Object.entries(scene.arrays).filter(([name]) => !KEPT.includes(name)).map(([, one]) => one.values.buffer);
    this.post({ kind: "opened", scene }, moved);
  }

  #sort({ id, time, row, layer, order }) {
    const start = performance.now(), { depths } = this, { header } = depths.scene;
    const result = order ?? new Uint32Array(depths.count);
    const count = this.sorter.sort(depths.at(time, row), header.near, result, rangesOf(header, layer));
    this.post({ kind: "sorted", id, order: result, count, milliseconds: performance.now() - start }, [result.buffer]);
  }
}

// The code of a worker, or the page's own thread where there are none.
export function answersTo(scope) {
  const answers = new Answers((message, moved) => scope.postMessage(message, moved));
  scope.onmessage = (event) => answers.take(event.data);
  scope.postMessage({ kind: "there" });
}
