// Which primitives can be shown alone, by the names that `e4dgs view` has for them, and where these are in the order of a scene.

export const LAYERS = ["all", "Gaussians", "convexes", "dynamic", "static"];

// [from, to) of the numbers of primitives in a layer.
export function rangesOf({ gaussians: [still, moving], convexes: [stiff, bending] }, layer) {
  const g = still + moving, total = g + stiff + bending;
  return {
    all: [[0, total]],
    Gaussians: [[0, g]],
    convexes: [[g, total]],
    dynamic: [[still, g], [g + stiff, total]],
    static: [[0, still], [g, g + stiff]],
  }[layer];
}

// The layers that are neither empty nor all there is, after "all".
export function layersOf(header) {
  const size = (layer) => rangesOf(header, layer).reduce((sum, [from, to]) => sum + to - from, 0);
  return LAYERS.filter((layer) => layer === "all" || (size(layer) > 0 && size(layer) < size("all")));
}
