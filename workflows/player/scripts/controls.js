// Pointers, wheel and keys on the canvas, as movements of the camera and commands of the player.

const KEYS = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, 1, 0], KeyQ: [0, -1, 0] };
const TURN = 0.005;  // radians a px of dragging
const PACE = 0.6;  // of the distance to the target, a second of flying
const WHEEL = 0.0012, PINCH = 0.01;  // of ln distance; browsers tell a pinch on a trackpad as a wheel with ctrl, by 100 times its ln
const SIGNS = { Comma: ",", Period: ".", BracketLeft: "[", BracketRight: "]" };  // of the keys that have them on a US keyboard
const AGAIN = [...Object.values(SIGNS), "p", "n"];  // what acts again while its key is held

// What was typed, whatever the keyboard's layout: a sign or a small letter. Where letters are not Latin, it is that of the US keyboard's key.
const typed = ({ key, code }) => (/^[ -~]$/.test(key) ? key.toLowerCase() : SIGNS[code] ?? /^Key([A-Z])$/.exec(code)?.[1].toLowerCase());

export class Controls {
  // player: camera, mode ("orbit" or "fly"), changed(), and what `#key` calls.
  constructor(canvas, player) {
    this.player = player;
    this.pointers = new Map();
    this.held = new Set();
    const on = (name, act) => canvas.addEventListener(name, act);
    on("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus();
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    on("pointermove", (event) => this.#drag(event));
    for (const name of ["pointerup", "pointercancel"]) on(name, (event) => this.pointers.delete(event.pointerId));
    on("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const way = (event.ctrlKey ? PINCH : WHEEL) * event.deltaY;
      player.camera.approach(Math.exp(Math.max(-0.4, Math.min(0.4, way))));
      player.changed();
    }, { passive: false });
    // Safari on a Mac tells a pinch on a trackpad so; of one on a screen, the pointers tell as well.
    for (const name of ["gesturestart", "gesturechange", "gestureend"]) on(name, (event) => {
      event.preventDefault();
      const spread = Math.max(event.scale, 0.01);
      if (name === "gesturechange" && !this.pointers.size) player.camera.approach(this.spread / spread);
      this.spread = spread;
      player.changed();
    });
    addEventListener("keydown", (event) => this.#key(event));
    addEventListener("keyup", ({ key, code }) => {
      if (key === "Meta") this.held.clear();  // macOS tells of no other key that is let go while this one is down
      else this.held.delete(code);
    });
    addEventListener("blur", () => this.held.clear());
  }

  get busy() {
    return this.held.size > 0 || this.pointers.size > 0;
  }

  #drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const { camera, mode } = this.player, now = [event.clientX, event.clientY];
    const dx = now[0] - before[0], dy = now[1] - before[1], size = Math.min(innerWidth, innerHeight);
    if (this.pointers.size === 2) {  // two fingers: slide, and go nearer as they part
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      camera.approach(apart(before) / apart(now));
      camera.slide(-dx / 2 / size, -dy / 2 / size);
    } else if (event.buttons & 6 || event.shiftKey) camera.slide(-dx / size, -dy / size);
    else if (mode === "orbit") camera.turn(-TURN * dx, -TURN * dy, true);
    else camera.turn(-0.5 * TURN * dx, -0.5 * TURN * dy, false);
    this.pointers.set(event.pointerId, now);
    this.player.changed();
  }

  #key(event) {
    const on = event.target.tagName, pressing = event.code === "Space" || event.code === "Enter";
    if (event.code === "Escape") return this.player.help(false);
    // Many keyboards have brackets only with AltGr, which may be told as ctrl and alt, or with Option.
    const bracket = (event.key === "[" || event.key === "]") && (event.altKey || event.getModifierState?.("AltGraph"));
    if (event.metaKey || ((event.ctrlKey || event.altKey) && !bracket) || on === "SELECT") return;
    if ((on === "BUTTON" && pressing) || (on === "INPUT" && event.code.startsWith("Arrow"))) return;
    const { player } = this, { camera } = player, name = typed(event);
    const arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.code];
    const before = () => player.jump(player.photo - 1), after = () => player.jump(player.photo + 1), help = () => player.help();
    const acts = {
      " ": () => player.toggle(), f: () => player.fullScreen(), l: () => player.setLoop(!player.loop), r: () => player.jump(player.photo),
      o: () => player.setMode(player.mode === "orbit" ? "fly" : "orbit"), "[": before, p: before, "]": after, n: after,
      ",": () => player.step(-1), ".": () => player.step(1), h: help, "?": help, c: () => player.toggleControls(),
    };
    if (KEYS[event.code] && !bracket) this.held.add(event.code);  // by their places, the same on every keyboard
    else if (arrows) camera.turn(0.06 * arrows[0], 0.06 * arrows[1], player.mode === "orbit");
    else if (acts[name]) {
      if (!event.repeat || AGAIN.includes(name)) acts[name]();
    } else return;
    event.preventDefault();
    player.changed();
  }

  // Flies on while keys are held, for `seconds` since the last call.
  advance(seconds) {
    if (!this.held.size) return;
    const { camera } = this.player, way = [0, 0, 0];
    for (const code of this.held) KEYS[code].forEach((x, k) => (way[k] += x));
    const step = PACE * camera.distance * Math.min(seconds, 0.1);
    camera.fly(...way.map((x) => x * step));
    this.player.changed();
  }
}
