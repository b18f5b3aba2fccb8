// The page: finds the scene's data, opens them, and offers `window.e4dgs`.
import { askedIn } from "./camera.js";
import { Player } from "./player.js";
import { fail, say } from "./panel.js";
import { fetched } from "./windows.js";

const CUT = "The scene's data are damaged or cut short.";

async function data() {
  if (document.readyState === "loading") await new Promise((done) => document.addEventListener("DOMContentLoaded", done, { once: true }));
  const inside = document.getElementById("scene"), address = document.body.dataset.scene;
  if (inside) return fromBase64(inside.textContent);
  if (!address) throw new Error(CUT);
  return fetched(address);
}

function fromBase64(text) {
  try {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const letters = atob(text), bytes = new Uint8Array(letters.length);
    for (let k = 0; k < letters.length; ++k) bytes[k] = letters.charCodeAt(k);
    return bytes;
  } catch {
    throw new Error(CUT);
  }
}

function infoOf({ scene: { header }, bytes, seconds, times, renderer }) {
  const sum = ([a, b]) => a + b;
  return {
    gaussians: sum(header.gaussians), convexes: sum(header.convexes), moving: header.gaussians[1] + header.convexes[1], motion: header.motion,
    bytes, duration: seconds, sh_degree: header.sh_degree, cameras: header.cameras.length, milliseconds: { ...times }, uploads: { ...renderer.uploads },
  };
}

export function start() {
  const canvas = document.getElementById("canvas"), player = new Player(canvas);
  const take = (usual = {}) => player.take({ ...usual, ...askedIn(location.hash, player.scene.header.cameras.length, console.warn) });
  const ready = (async () => {
    say("Opening the scene…");
    const bytes = await data();
    player.bytes = bytes.length;
    await player.open(bytes, document.body.dataset.scene ?? "", () => take({ play: document.body.dataset.play === "true" }));
    document.body.classList.add("ready");
    addEventListener("hashchange", () => take());
  })();
  ready.catch(fail);
  window.e4dgs = {
    canvas,
    ready,
    get info() {
      return player.renderer?.scene ? infoOf(player) : null;  // until the scene is there
    },
    show: async (view) => (await ready, player.show(view)),
    play: async () => (await ready, player.play()),
    pause: async () => (await ready, player.pause()),
    bench: async (frames) => (await ready, player.bench(frames)),
  };
}
