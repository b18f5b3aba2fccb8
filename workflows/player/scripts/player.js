// The player: what is shown (camera, time), when it is sorted and drawn, and what `window.e4dgs` offers.
import { Camera, checkView } from "./camera.js";
import { Controls } from "./controls.js";
import { Pixels } from "./gpu.js";
import { Panel, bare, fail, note, say, showControls, showHelp } from "./panel.js";
import { Renderer } from "./renderer.js";
import { startSorter } from "./sorter.js";
import { Stereo, hasStereo } from "./stereo.js";
import { Windows } from "./windows.js";

const USUAL_SECONDS = 4;  // of a scene whose times have no seconds
const REST = 250;  // ms after which a picture that stands still gets all pixels
const PATIENCE = 5000;  // ms for which a picture that was asked for waits for a lost graphics device
const LOST = "The graphics device was lost; waiting for it.", GONE = "The graphics device was lost and does not come back. Reload the page.";

export class Player {
  constructor(canvas) {
    this.canvas = canvas;
    this.playing = false, this.loop = true, this.speed = 1, this.mode = "orbit", this.layer = "all", this.photo = 0, this.time = 0;
    this.times = { sort: 0, upload: 0, draw: 0, frame: 0 };
    this.asked = null, this.touched = 0, this.now = 0, this.drew = false;
  }

  // bytes: the scene's file. address: where it came from, beside which its windows lie, if it has any. begin: called before the first picture.
  async open(bytes, address, begin) {
    const { scene, sorter } = await startSorter(bytes);
    this.scene = scene, this.sorter = sorter, this.bytes = bytes.length || this.bytes;
    this.seconds = scene.header.seconds || (scene.header.motion === "static" ? 0 : USUAL_SECONDS);
    this.renderer = new Renderer(this.canvas);
    this.renderer.load(scene);
    this.pixels = new Pixels(this.renderer.most, this.renderer.software);
    this.camera = new Camera(scene.header);
    this.time = scene.header.cameras[0]?.time ?? 0;
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      say(LOST);
      setTimeout(() => this.renderer.gl.isContextLost() && say(GONE), PATIENCE);
    });
    this.canvas.addEventListener("webglcontextrestored", () => this.#restored());
    this.controls = new Controls(this.canvas, this);
    this.panel = new Panel(this, scene);
    this.stereo = new Stereo(this);
    hasStereo().then((there) => this.panel.offerStereo(there, () => this.stereo.toggle().catch((error) => note(error.message))));
    this.windows = new Windows(scene.header, address, (k, more) => this.#add(k, more));
    begin();
    const missing = await this.windows.at(this.time).then(() => "", ({ message }) => message);
    while (!(await this.#tried(() => this.#drawn(this.#window(true)))));
    this.#loop();
    this.panel.show();
    say(missing);
    this.windows.fetchAll(() => this.time, ({ message }) => say(message));
  }

  // Decodes a window, which is drawn from now on.
  async #add(k, bytes) {
    this.bytes += bytes.length;
    const part = await this.sorter.add(k, bytes);
    this.scene.parts[k] = part;
    this.renderer.add(part, k);
    this.last = "";
  }

  // -- what the page and its keys ask for ----------------------------------------------------------------------------------------------

  changed() {
    this.touched = performance.now();
    this.asked = null;
    bare(false);
  }

  play() {
    this.playing = this.scene.header.motion !== "static";
    if (this.time >= 1) this.time = 0;
    this.changed(), this.panel.show();
  }

  pause() {
    this.playing = false;
    this.changed(), this.panel.show();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), 1);
    this.changed(), this.panel.show();
  }

  step(frames) {
    this.playing = false;
    this.seek(this.time + frames / Math.max(this.scene.header.frames - 1, 1));
  }

  setSpeed(speed) {
    this.speed = speed;
  }

  setLoop(loop) {
    this.loop = loop;
    this.panel.show();
  }

  setMode(mode) {
    this.mode = mode;
    this.panel.show();
  }

  setLayer(layer) {
    this.layer = layer;
    this.changed(), this.panel.show();
  }

  jump(photo) {
    const { cameras } = this.scene.header;
    if (!cameras.length) return;
    this.photo = (photo + cameras.length) % cameras.length;
    this.camera.jump(cameras[this.photo]);
    if (!this.playing) this.time = cameras[this.photo].time;
    this.changed(), this.panel.show();
  }

  // What the page's address asks for: each of { camera, counted from 1, time, controls, play } that is there.
  take({ camera, time, controls, play }) {
    if (camera !== undefined) this.jump(camera - 1);
    if (time !== undefined) this.seek(time);
    if (controls !== undefined) showControls(controls);
    if (play !== undefined) play ? this.play() : this.pause();
  }

  toggleControls() {
    showControls();
  }

  // show: whether the list of keys shall be seen; by default if it is not.
  help(show) {
    showHelp(show);
  }

  fullScreen() {
    const refused = () => note("This page may not fill the screen here.");
    if (document.fullscreenElement) document.exitFullscreen();
    else if (document.fullscreenEnabled) document.documentElement.requestFullscreen().catch(refused);
    else refused();
  }

  // Draws exactly this picture, without controls over it. time in [0, 1]; cam_from_world 16 and K 9 numbers, row by row, OpenCV axes, px.
  async show(view) {
    checkView(view, this.renderer.most);
    await this.there();
    await this.windows.at(view.time);
    this.playing = false;
    bare(true);
    const ratio = devicePixelRatio || 1;
    Object.assign(this.canvas.style, { width: `${view.width / ratio}px`, height: `${view.height / ratio}px` });
    this.asked = { ...view, cam_from_world: Array.from(view.cam_from_world), K: Array.from(view.K) };
    try {
      await this.#drawn(this.asked);
    } catch (error) {
      this.changed();
      throw error;
    }
  }

  // Mean milliseconds a frame of turning once around the target while time runs: of sorting, of uploads, of drawing.
  async bench(frames = 60) {
    this.measuring = true;
    const sum = { sort: 0, upload: 0, draw: 0, frame: 0 }, { width, height } = this.canvas, start = performance.now();
    for (let k = 0; k < frames; ++k) {
      this.camera.turn((2 * Math.PI) / frames, 0, true);
      await this.#drawn({ time: k / Math.max(frames - 1, 1), ...this.camera.view(width, height) });
      for (const name of ["sort", "upload", "draw"]) sum[name] += this.times[name] / frames;
    }
    sum.frame = (performance.now() - start) / frames;
    this.measuring = false;
    return sum;
  }

  // -- frames ----------------------------------------------------------------------------------------------------------------------------

  #window(moving) {
    Object.assign(this.canvas.style, { width: "100%", height: "100%" });
    const ratio = devicePixelRatio || 1, size = this.pixels.of(this.canvas.clientWidth * ratio, this.canvas.clientHeight * ratio, moving);
    return { time: this.time, layer: this.layer, ...this.camera.view(...size) };
  }

  // Whether `act` has drawn a picture. A device may fail once, or at pictures of that size; what fails again and again is thrown.
  async #tried(act) {
    try {
      await act();
      this.pixels.failures = 0;
      return true;
    } catch (error) {
      if (!this.pixels.overcome(error)) throw error;
      return false;
    }
  }

  // Sorts for the view, then draws it, and if asked waits until it is there.
  async #drawn(view, wait = true) {
    const { gl } = this.renderer, start = performance.now();
    const { order, count, milliseconds } = await this.sorter.sort(view.time, view.cam_from_world.slice(8, 12), view.layer);
    const sorted = performance.now();
    this.renderer.setOrder(order, count);
    this.sorter.give(order);
    const uploaded = performance.now();
    this.renderer.draw(view);
    if (wait) gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    this.times = { sort: milliseconds, upload: uploaded - sorted, draw: performance.now() - uploaded, frame: performance.now() - start };
    this.last = JSON.stringify(view);
  }

  #loop() {
    requestAnimationFrame(async (now) => {
      const seconds = Math.min((now - (this.now || now)) / 1000, 0.5);
      this.now = now;
      try {
        await this.#tried(() => this.#frame(seconds));
      } catch (error) {
        return fail(error);
      }
      this.#loop();
    });
  }

  async #frame(seconds) {
    if (this.asked || this.measuring || this.stereo.session || document.hidden || this.renderer.gl.isContextLost()) return;
    this.controls.advance(seconds);
    this.pass(seconds);
    const moving = this.playing || performance.now() - this.touched < REST || this.controls.busy;
    const view = this.#window(moving);
    const again = this.drew;  // whether the time since the last frame is that of a frame
    this.drew = JSON.stringify(view) !== this.last;
    if (!this.drew) return;  // nothing has changed, so nothing is sorted, uploaded or drawn
    await this.#drawn(view, false);
    if (this.asked) return this.#drawn(this.asked);  // asked for in the meantime
    this.times.frame = again ? 1000 * seconds : this.times.frame;
    if (moving) this.pixels.took(this.times.frame);
  }

  // Lets time pass while the scene plays and nothing of what is seen now is still on its way; a headset, too, which has frames of its own.
  pass(seconds) {
    if (this.playing && !this.windows.lacks(this.time)) this.#advance(seconds);
  }

  // Starts to sort for a view, if no sorting is under way; the order is there for a later frame.
  sortFor(view) {
    if (this.sorting) return;
    this.sorting = true;
    this.#tried(async () => {
      const { order, count } = await this.sorter.sort(view.time, view.cam_from_world.slice(8, 12), this.layer);
      this.renderer.setOrder(order, count);
      this.sorter.give(order);
    }).catch(fail).finally(() => (this.sorting = false));
  }

  #advance(seconds) {
    this.time += (seconds * this.speed) / Math.max(this.seconds, 1e-3);
    if (this.time >= 1) {
      if (this.loop) this.time %= 1;
      else (this.time = 1), (this.playing = false);
    }
    this.panel.show();
  }

  // Waits until the graphics device is there.
  async there() {
    const start = performance.now();
    while (this.renderer.gl.isContextLost()) {
      if (performance.now() - start > PATIENCE) throw new Error(GONE);
      await new Promise((done) => setTimeout(done, 50));
    }
    await this.restoring;
  }

  #restored() {
    this.restoring = this.#renew();
  }

  async #renew() {
    try {
      this.renderer.load(this.scene);
      this.last = "";
      say("");
      if (this.asked) await this.#drawn(this.asked);
    } catch (error) {
      fail(error);
    }
  }
}
