// Stereo in a headset by WebXR: the scene stands before the viewer as the page's camera saw it, one picture an eye.

const REACH = 2;  // metres from the viewer to the point that the camera turns about
const MODE = "immersive-vr";

export async function hasStereo(xr = navigator.xr) {
  try {
    return Boolean(xr && (await xr.isSessionSupported(MODE)));
  } catch {
    return false;
  }
}

// Where the viewer's space lies in the scene, from a camera: the eye, world units a metre, and right, up and back with up as the scene has it.
export function standAt({ eye, forward, right, up, distance }) {
  const along = forward.reduce((sum, x, k) => sum + x * up[k], 0), level = forward.map((x, k) => x - along * up[k]), size = Math.hypot(...level);
  const ahead = size > 1e-6 ? level.map((x) => x / size) : forward, back = ahead.map((x) => -x);
  const side = size > 1e-6 ? [1, 2, 0].map((a, k) => ahead[a] * up[(k + 2) % 3] - ahead[(k + 2) % 3] * up[a]) : right;
  return { eye, scale: distance / REACH, axes: [side, up, back] };
}

// What `draw` takes for an eye. inverse: 16 numbers of its space from the viewer's, projection: 16 of its clip space, both column by column
// as WebXR gives them (y up, z back).
export function eyeView(inverse, projection, { width, height }, { eye, scale, axes }) {
  const pose = [];
  for (const [row, sign] of [[0, 1], [1, -1], [2, -1]]) {  // x right, y down, z ahead
    const turned = [0, 1, 2].map((k) => sign * [0, 1, 2].reduce((sum, j) => sum + inverse[4 * j + row] * axes[j][k], 0));
    const moved = turned.reduce((sum, x, k) => sum - x * eye[k], sign * scale * inverse[12 + row]);
    pose.push(...turned, moved);
  }
  const p = projection, K = [(width * p[0]) / 2, 0, (width * (1 - p[8])) / 2, 0, (height * p[5]) / 2, (height * (1 + p[9])) / 2, 0, 0, 1];
  return { cam_from_world: [...pose, 0, 0, 0, 1], K, width, height };
}

export class Stereo {
  constructor(player) {
    this.player = player;
    this.session = null;
  }

  async toggle() {
    if (this.session) return this.session.end();
    const { player } = this, { gl } = player.renderer;
    const session = await navigator.xr.requestSession(MODE);
    await gl.makeXRCompatible?.();
    await player.there();  // the device may be another one now
    const layer = new XRWebGLLayer(session, gl, { alpha: false, antialias: false, depth: false });
    session.updateRenderState({ baseLayer: layer });
    const space = await session.requestReferenceSpace("local");
    this.session = session, this.place = standAt({ ...player.camera, up: player.camera.up, distance: player.camera.distance }), this.before = null;
    session.addEventListener("select", () => player.toggle());  // a controller's trigger, or a pinch of fingers
    session.addEventListener("end", () => {
      this.session = null;
      player.changed();
    });
    const frame = (now, shown) => {
      if (this.session !== session) return;
      session.requestAnimationFrame(frame);
      player.pass(this.before === null ? 0 : Math.min((now - this.before) / 1000, 0.5));
      this.before = now;
      const seen = shown.getViewerPose(space);
      if (seen) this.#draw(seen.views, layer);
    };
    session.requestAnimationFrame(frame);
  }

  // Draws an eye after the other, in the order of the last sorting that has come to its end.
  #draw(views, layer) {
    const { player, place } = this, { renderer } = player;
    const eyes = views.map((one) => {
      const port = layer.getViewport(one);
      return { port, view: { time: player.time, ...eyeView(one.transform.inverse.matrix, one.projectionMatrix, port, place) } };
    });
    if (!eyes.length) return;
    player.sortFor(eyes[0].view);
    for (const { port, view } of eyes) renderer.draw(view, { frame: layer.framebuffer, x: port.x, y: port.y });
  }
}
