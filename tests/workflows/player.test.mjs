// Run by test_player_scripts.py with the player's modules in SCRIPTS and scenes with the truth about them in SCENES.
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import test from "node:test";

const load = (name) => import(`${process.env.SCRIPTS}/${name}.js`);
const { readContainer } = await load("container");
const { checkScene } = await load("layout");
const { Depths, rowAt } = await load("motion");
const { LAYERS, layersOf, rangesOf } = await load("layout");
const { Camera } = await load("camera");
const { Answers, Sorter } = await load("worker");

const files = (ending) => readdirSync(process.env.SCENES).filter((name) => name.endsWith(ending));
const read = (name) => new Uint8Array(readFileSync(`${process.env.SCENES}/${name}`));
const truth = (name) => JSON.parse(readFileSync(`${process.env.SCENES}/${name.replace(/\.e4dw$/, ".json")}`));

for (const name of files(".e4dw"))
  test(`${name}: numbers and depths are those of Python`, async () => {
    const scene = await readContainer(read(name)), { sums, row, moments } = truth(name);
    checkScene(scene);
    for (const [array, [sum, last]] of Object.entries(sums)) {
      const { values } = scene.arrays[array], found = values.reduce((a, x, i) => a + x * ((i % 7) + 1), 0);
      assert.ok(Math.abs(found - sum) <= 1e-4 * (1 + Math.abs(sum) + values.length), `${array}: ${found}, expected ${sum}`);
      if (values.length) assert.ok(Math.abs(values.at(-1) - last) <= 1e-5 * (1 + Math.abs(last)), array);
    }
    const depths = new Depths(scene);
    for (const { time, depth } of [...moments, moments[0]]) {
      const found = depths.at(time, row);
      depth.forEach((z, i) => z === null ? assert.equal(found[i], -Infinity) : assert.ok(Math.abs(found[i] - z) < 1e-4, `${i}: ${found[i]}, ${z}`));
    }
  });

for (const name of files(".bad"))
  test(`${name}: refused in words`, async () => {
    const said = [], answers = new Answers((message) => said.push(message));
    await answers.take({ kind: "open", bytes: read(name) });
    assert.equal(said.length, 1);
    assert.equal(said[0].kind, "failed");
    assert.match(said[0].message, /^(The scene|This is not a scene|Two of the scene|One of the scene|The numbers of the scene)/);
  });

test("primitives are sorted nearest first, equal ones in their order, and those behind left out", () => {
  const depth = new Float32Array([3, 1, -2, 2, 1, -Infinity, NaN, 2, 0.5]), order = new Uint32Array(depth.length);
  const count = new Sorter(depth.length).sort(depth, 0.75, order);
  assert.deepEqual([...order.subarray(0, count)], [1, 4, 3, 7, 0]);
  assert.equal(new Sorter(3).sort(new Float32Array(3).fill(-1), 0.1, order), 0);
});

test("a layer has the primitives of its name, and the layers that say nothing new are left out", () => {
  const header = { gaussians: [2, 1], convexes: [1, 2] }, depth = new Float32Array([6, 5, 4, 3, 2, 1]), order = new Uint32Array(6);
  const drawn = (layer) => [...order.subarray(0, new Sorter(6).sort(depth, 0.1, order, rangesOf(header, layer)))];
  assert.deepEqual(drawn("all"), [5, 4, 3, 2, 1, 0]);
  assert.deepEqual([drawn("Gaussians"), drawn("convexes")], [[2, 1, 0], [5, 4, 3]]);
  assert.deepEqual([drawn("dynamic"), drawn("static")], [[5, 4, 2], [3, 1, 0]]);
  assert.deepEqual(layersOf(header), LAYERS);
  assert.deepEqual(layersOf({ gaussians: [5, 0], convexes: [0, 0] }), ["all"]);
});

test("200,000 primitives are sorted within 8 ms", () => {
  const count = 200_000, sorter = new Sorter(count), order = new Uint32Array(count), depth = new Float32Array(count);
  let best = Infinity, seed = 1;
  for (let round = 0; round < 200 && best > 8; ++round) {
    for (let i = 0; i < count; ++i) depth[i] = 1 + 20 * ((seed = (seed * 16807) % 2147483647) / 2147483647);
    const start = process.cpuUsage();  // on a busy machine time passes for others
    assert.equal(sorter.sort(depth, 0.01, order), count);
    const { user, system } = process.cpuUsage(start);
    best = Math.min(best, (user + system) / 1000);
  }
  for (let i = 1; i < count; ++i) assert.ok(depth[order[i - 1]] <= depth[order[i]] * (1 + 2e-6));
  assert.ok(best <= 8, `${best} ms`);
});

test("a camera takes the place of a capture's, and turns about its target", () => {
  const photo = { name: "a", time: 0, width: 80, height: 60, K: [70, 0, 41, 0, 72, 29, 0, 0, 1] };
  photo.cam_from_world = [1, 0, 0, 0.2, 0, 1, 0, -0.1, 0, 0, 1, 3, 0, 0, 0, 1];
  const camera = new Camera({ up: [0, -1, 0], target: [0, 0, 0], cameras: [photo] });
  const near = (a, b) => a.forEach((x, k) => assert.ok(Math.abs(x - b[k]) < 1e-9, `${a} ${b}`));
  near(camera.view(80, 60).cam_from_world, photo.cam_from_world);
  near(camera.view(80, 60).K, photo.K);
  near(camera.view(160, 60).K, [70, 0, 81, 0, 72, 29, 0, 0, 1]);
  const before = camera.distance;
  for (let k = 0; k < 500; ++k) camera.turn(0.11, 0.05, true);  // never over the top
  assert.ok(Math.abs(camera.distance - before) < 1e-9);
  const m = camera.view(80, 60).cam_from_world;
  for (const [a, b] of [[0, 0], [4, 4], [8, 8], [0, 4], [4, 8], [0, 8]]) {
    const product = m[a] * m[b] + m[a + 1] * m[b + 1] + m[a + 2] * m[b + 2];
    assert.ok(Math.abs(product - (a === b ? 1 : 0)) < 1e-9);
  }
  assert.ok(Math.abs(m[9]) < 0.9995, "not straight down");
});

test("a browser that cannot unpack is told so, not that the scene is damaged", async () => {
  const [name] = files(".e4dw"), kept = globalThis.DecompressionStream;
  try {
    delete globalThis.DecompressionStream;
    await assert.rejects(readContainer(read(name)), /browser is too old/);
  } finally {
    globalThis.DecompressionStream = kept;
  }
});

function send(to, name, fields) {
  const event = new Event(name, { cancelable: true });
  for (const [key, value] of Object.entries({ target: { tagName: "CANVAS" }, ...fields })) Object.defineProperty(event, key, { value });
  to.dispatchEvent(event);
  return event.defaultPrevented;
}

test("a pinch goes nearer as fingers part, held keys repeat no command, and none stays down", async () => {
  const { Controls } = await load("controls"), canvas = new EventTarget(), page = new EventTarget(), did = [], near = [];
  globalThis.addEventListener = page.addEventListener.bind(page);
  const camera = { approach: (factor) => near.push(factor) };
  const player = { camera, changed() {}, toggle: () => did.push("toggle"), step: (frames) => did.push(frames) };
  const controls = new Controls(canvas, player);
  for (let k = 0; k < 10; ++k) send(canvas, "wheel", { deltaY: -10 * Math.log(2), ctrlKey: true });  // browsers: -100 ln of the spread
  assert.ok(Math.abs(near.splice(0).reduce((a, b) => a * b) - 0.5) < 1e-9);
  for (const [name, scale] of [["start", 1], ["change", 1.25], ["change", 2], ["end", 2], ["start", 1], ["change", 2]])  // Safari on a Mac
    assert.ok(send(canvas, `gesture${name}`, { scale }), "the page itself is not zoomed");
  assert.ok(Math.abs(near.splice(0).reduce((a, b) => a * b) - 0.25) < 1e-9);
  canvas.setPointerCapture = canvas.focus = () => {};
  send(canvas, "pointerdown", { pointerId: 1, clientX: 0, clientY: 0 });
  assert.ok(send(canvas, "gesturechange", { scale: 4 }) && !near.length, "fingers on a screen");
  for (const repeat of [false, true, true]) send(page, "keydown", { code: "Space", key: " ", repeat });
  for (const repeat of [false, true]) send(page, "keydown", { code: "Period", key: ".", repeat });
  assert.deepEqual(did, ["toggle", 1, 1]);
  send(canvas, "pointerup", { pointerId: 1 });
  send(page, "keydown", { code: "KeyW", key: "w" });
  assert.ok(controls.busy);
  send(page, "keyup", { code: "MetaLeft", key: "Meta" });
  assert.ok(!controls.busy);
});

test("commands go by what is typed on any keyboard, and flying by the place of its keys", async () => {
  const { Controls } = await load("controls"), page = new EventTarget(), did = [];
  globalThis.addEventListener = page.addEventListener.bind(page);
  const note = (name) => (...values) => did.push([name, ...values].join(" "));
  const player = { photo: 5, loop: true, mode: "orbit", changed() {} };
  for (const name of ["toggle", "fullScreen", "setLoop", "setMode", "jump", "step", "help"]) player[name] = note(name);
  const controls = new Controls(new EventTarget(), player), altGr = { getModifierState: (name) => name === "AltGraph" };
  const does = (code, key, more = {}) => (did.length = 0, send(page, "keydown", { code, key, ...more }), did.join());
  assert.equal(does("Digit8", "[", { ctrlKey: true, altKey: true }), "jump 4", "German on Windows");
  assert.equal(does("Digit9", "]", altGr), "jump 6", "German on Linux");
  assert.equal(does("Digit5", "[", { altKey: true }), "jump 4", "German on a Mac");
  assert.equal(does("KeyF", "[", { altKey: true, ctrlKey: true }), "jump 4", "Hungarian");
  assert.equal(does("KeyM", ","), "step -1", "French");
  assert.equal(does("Comma", "."), "step 1", "French, with shift");
  assert.equal(does("Semicolon", "m"), "", "French: no command");
  assert.equal(does("BracketLeft", "х") + does("Period", "ю") + does("KeyF", "а"), "jump 4step 1fullScreen", "Russian");
  assert.equal(does("KeyP", "p") + does("KeyN", "N", { repeat: true }) + does("Minus", "?"), "jump 4jump 6help");
  assert.equal(does("Space", " ") + does("KeyO", "o") + does("KeyL", "l"), "togglesetMode flysetLoop false");
  assert.equal(does("KeyF", "ƒ", { altKey: true }) + does("KeyF", "f", { ctrlKey: true }) + does("BracketLeft", "[", { metaKey: true }), "");
  assert.equal(does("BracketLeft", "[", { ctrlKey: true }) + does("ArrowLeft", "ArrowLeft", { altKey: true }) + does("KeyP", "p", { ctrlKey: true }), "");
  assert.ok(!controls.busy);
  does("KeyW", "z"), does("KeyA", "q");
  assert.deepEqual([...controls.held], ["KeyW", "KeyA"], "French");
});

test("a picture has the pixels that a device draws in time, and fewer after one that failed", async () => {
  const { Pixels } = await load("gpu"), pixels = new Pixels(4096, false);
  assert.deepEqual(pixels.of(1000, 500, false), [1000, 500]);
  assert.deepEqual(pixels.of(8192, 2048, false), [4096, 1024], "no more than the device can");
  assert.deepEqual(pixels.of(0, 0, false), [1, 1]);
  pixels.took(180);
  assert.deepEqual([pixels.of(1000, 500, true), pixels.of(1000, 500, false)], [[600, 300], [1000, 500]]);
  assert.deepEqual(new Pixels(4096, true).of(1000, 500, true), [400, 200]);
  assert.ok(pixels.overcome(new Error("once")));
  assert.deepEqual(pixels.of(1000, 500, false), [1000, 500]);
  assert.ok(pixels.overcome(new RangeError("too large")));
  assert.deepEqual([pixels.of(1000, 500, false), pixels.of(500, 250, false)], [[707, 354], [500, 250]]);
  assert.ok(pixels.overcome(new Error()) && pixels.overcome(new Error()) && !pixels.overcome(new Error()), "the fifth in a row");
});

test("an address asks for what it may, and what is refused is said", async () => {
  const { askedIn } = await load("camera"), said = [], read = (hash) => askedIn(hash, 3, (words) => said.push(words));
  assert.deepEqual(read("#time=0.3&camera=2&play=0&controls=0"), { time: 0.3, camera: 2, play: false, controls: false });
  assert.deepEqual([read(""), read("#"), read("#play=1&controls=1&time=1")], [{}, {}, { play: true, controls: true, time: 1 }]);
  assert.deepEqual(said, []);
  const bad = ["time=", "time=1.1", "time=NaN", "camera=0", "camera=4", "camera=1.5", "play=yes", "controls=", "toString=1", "top", "play=toString"];
  assert.deepEqual(read(`#${bad.join("&")}&time=0.5`), { time: 0.5 });
  assert.equal(said.length, bad.length);
  assert.match(said[1], /"time=1.1" .* must be a number in \[0, 1\]/);
  assert.match(said[9], /"top=" .* must be one of time, camera, controls, play/);
});

test("an eye of a headset sees what a camera of the page sees", async () => {
  const { eyeView, hasStereo, standAt } = await load("stereo"), near = (a, b) => a.forEach((x, k) => assert.ok(Math.abs(x - b[k]) < 1e-9, `${a} ${b}`));
  const place = standAt({ eye: [0, 0, -3], forward: [0, 0, 1], right: [1, 0, 0], up: [0, -1, 0], distance: 3 });  // OpenCV's axes, level
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], projection = [1.2, 0, 0, 0, 0, 1.5, 0, 0, 0.1, -0.2, -1, -1, 0, 0, -0.1, 0];
  const straight = eyeView(identity, projection, { width: 200, height: 100 }, place);
  near(straight.cam_from_world, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1]);
  near(straight.K, [120, 0, 90, 0, 75, 40, 0, 0, 1]);
  const inverse = identity.slice();
  inverse[12] = 0.032;  // the left eye is 32 mm to the left, so the scene lies 32 mm to its right; a metre is 1.5 units
  near(eyeView(inverse, projection, { width: 200, height: 100 }, place).cam_from_world, [1, 0, 0, 0.048, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1]);
  const tilted = standAt({ eye: [0, 0, -3], forward: [0, 0.6, 0.8], right: [1, 0, 0], up: [0, -1, 0], distance: 3 });
  near(tilted.axes.flat(), [1, 0, 0, 0, -1, 0, 0, 0, -1]);
  assert.equal(await hasStereo(null), false);
  assert.equal(await hasStereo({ isSessionSupported: async () => { throw new Error("not allowed"); } }), false);
  assert.equal(await hasStereo({ isSessionSupported: async (mode) => mode === "immersive-vr" }), true);
});

test("rows between keys lie on a line", () => {
  assert.deepEqual([...rowAt({ shape: [3, 1, 2], values: new Float32Array([0, 1, 2, 3, 6, 5]) }, 0.75)], [4, 4]);
});
