// The controls below the picture, and what is said above it.
import { layersOf } from "./layout.js";

const NOTE = 6000;  // ms for which a message is seen that ends by itself

const find = (id) => document.getElementById(id);

export class Panel {
  constructor(player, { header }) {
    this.player = player;
    const moves = header.motion !== "static";
    for (const id of ["play", "time", "clock", "speed", "loop"]) find(id).hidden = !moves;
    find("play").onclick = () => player.toggle();
    find("time").oninput = (event) => player.seek(Number(event.target.value));
    find("speed").onchange = (event) => player.setSpeed(Number(event.target.value));
    find("loop").onclick = () => player.setLoop(!player.loop);
    find("mode").onclick = () => player.setMode(player.mode === "orbit" ? "fly" : "orbit");
    find("full").hidden = !document.fullscreenEnabled;  // a telephone's browser or a frame of another page may have none
    find("full").onclick = () => player.fullScreen();
    find("help").onclick = () => player.help();
    const photos = find("photo");
    header.cameras.forEach((camera, k) => photos.append(new Option(camera.name, k)));
    photos.hidden = find("before").hidden = find("after").hidden = !header.cameras.length;
    photos.onchange = (event) => player.jump(Number(event.target.value));
    const layers = layersOf(header);
    for (const layer of layers) find("layer").append(new Option(layer));
    find("layer").hidden = layers.length < 2;
    find("layer").onchange = (event) => player.setLayer(event.target.value);
    find("before").onclick = () => player.jump(player.photo - 1);
    find("after").onclick = () => player.jump(player.photo + 1);
    for (const one of document.querySelectorAll(".unsafe")) one.hidden = isSecureContext;  // a browser tells such a page of no headset
    find("bar").hidden = false;
  }

  // The button for a headset, only where there may be one.
  offerStereo(there, act) {
    find("stereo").hidden = !there;
    find("stereo").onclick = act;
  }

  show() {
    const { player } = this, { playing, time, loop, mode, photo, layer, seconds } = player;
    find("play").textContent = playing ? "❚❚" : "▶";
    find("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    find("time").value = time;
    find("clock").textContent = `${(time * seconds).toFixed(2)} s`;
    find("loop").setAttribute("aria-pressed", loop);
    find("mode").textContent = mode === "orbit" ? "Orbit" : "Fly";
    find("mode").setAttribute("aria-label", mode === "orbit" ? "Dragging turns the scene" : "Dragging looks around");
    find("photo").value = photo;
    find("layer").value = layer;
  }
}

// A message over the picture; none for "".
export function say(message, serious = false) {
  const box = find("message");
  box.textContent = message;
  box.hidden = !message;
  box.classList.toggle("serious", serious);
}

// The player has come to its end.
export function fail(error) {
  say(error.message, true);
  document.body.classList.add("failed");
}

// A message that ends by itself.
export function note(message) {
  say(message);
  setTimeout(() => find("message").textContent === message && say(""), NOTE);
}

export function showHelp(show = find("keys").hidden) {
  find("keys").hidden = !show;
}

// show: whether the controls shall be seen; by default if they are not.
export function showControls(show = document.body.classList.contains("plain")) {
  document.body.classList.toggle("plain", !show);
  if (!show) showHelp(false);
}

// In a picture that somebody asked for, nothing lies over it.
export function bare(on) {
  document.body.classList.toggle("bare", on);
}
