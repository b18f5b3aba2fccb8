"""The data of a scene as the web player reads them: quantised, compressed, and with stated errors (docs/player.md).

A file is little-endian: `E4DW`, the version (uint32, 1), the length of the header (uint32), the header in JSON, and one zlib stream with
the bytes of all arrays in the order of the header.

An array has a `name`, a `shape` [n, m, c] and `planes`, the bytes of a number (1 to 4; 0: float32). A number of column k is `low[k] +
step[k] q` with an unsigned q. With `delta`, the difference d from the row before (along n) is stored, as 2d for d >= 0 and -2d - 1 below.
Bytes are ordered by column, then plane (the least significant first), then n, then m.

Fields of the header:
- gaussians, convexes: [static, moving]; the static ones come first
- corners, sh_degree: points of a convex; 0 to 3
- motion: static, lives, nodes, paths
- frames, seconds: times of the capture, and how long it took; 0 if unknown
- keys, nodes, modes, light: of the motion, see below
- near, background, antialiased: as the model was trained
- windows (lives): [from, to, Gaussians, convexes] of each further file beside this one, in order of time: what moves and is seen from
  `from` to `to` in [0, 1] alone (`windows.split`); missing in a scene of one file
- up, target, cameras: for the camera; a camera has name, time, width, height, cam_from_world (16), K (9)

Arrays, their shapes, and in brackets the step of a number:
- g_means, c_points: [n, 1, 3], [n, corners, 3]: positions at rest (0.06 px of the capture)
- g_turns: [n, 1, 3]: x y z of a unit quaternion, w >= 0 follows; of the 24 ways to name a Gaussian's axes, the one with the largest w
  (0.004)
- g_scales: [n, 1, 3]: ln of standard deviations (0.02)
- c_shape: [n, 1, 2]: ln tau, ln kappa (0.02)
- g_opacity, c_opacity: [n, 1, 1]: at most, in [0, 1] (1/300)
- g_color, g_sh1, ...: [n, 1, 3 (2d + 1)]: SH by bands, coefficient by coefficient; c_ likewise (0.008 to 0.02)
- g_shades, c_shades, light: [n, 1, 3], [keys, 1, 3]: how far a colour follows the three courses of light (1/300 of the strongest)
- g_life (lives): [moving, 1, 2]: middle in frames, ln of the span in frames (0.02)
- g_drift, g_spin: [moving, 1, 3]: way, and turn in radians, over three spans, which are at least a frame and at most the clip (that of
  positions; 0.01)
- node_homes (nodes): [nodes, 1, 3]: where nodes rest (that of positions)
- node_modes, node_courses: [modes, nodes, 7], [keys, 1, modes]: turn minus (1, 0, 0, 0) and shift of a node at a key are the sum of modes
  times courses (a quarter of that of positions)
- g_links, g_weights: [moving, 1, 4], [moving, 1, 3]: nodes that carry a point, and their weights, of which the fourth makes the sum 1 (1;
  1/340 to 1/765)
- g_path_means, _turns, _scales (paths): [keys, moving, 3 or 4]: shift, turn (a quaternion after that at rest), growth of ln scales (that
  of positions; 0.002; 0.02)
- c_path_points: [keys, moving corners, 3]: shifts of a convex's points (that of positions)

Keys are evenly spaced over [0, 1], with straight lines between them. There are as many as it takes to follow the model within a step
(nodes: at most 1,025; paths: within four steps, at most four keys for each time of the capture, and 100 million numbers together).
"""
