// What both kinds of primitive need: where numbers lie in textures, the camera, rotations, spherical harmonics. docs/maths.md has the formulas.
const int WIDTH = 4096;  // of every texture of numbers, in texels

uniform mat3 uRotation;  // of cam_from_world
uniform vec3 uEye;  // camera centre, world
uniform vec4 uLens;  // fx, fy, cx, cy, px
uniform vec2 uSize;  // of the picture, px
uniform float uNear;
uniform vec3 uLight;  // courses of light at this time
uniform float uFrame;  // fractional frame of the capture, for lives
uniform float uBetween;  // share of the way from one key of paths to the next

uniform int uFirst;  // of the texels: number of the first primitive
uniform int uCount;
uniform int uStill;  // primitives that do not move; they come first
uniform highp sampler2D uSh;
#ifdef LIGHT
uniform highp sampler2D uShades;
#endif
#ifdef LIVES
uniform highp sampler2D uLives;  // two texels: middle, 1 / span, velocity (over both), spin
#endif
#ifdef NODES
uniform highp sampler2D uLinks;  // a texel for each Gaussian, or for each point of a convex
uniform highp sampler2D uWeights;
#endif
#ifdef PATHS
uniform highp sampler2D uKey;  // at the key before: shift, turn, growth of a Gaussian, or the shift of each point of a convex
uniform highp sampler2D uNextKey;  // and at the key after
#endif

const float LEAST_ALPHA = 1.0 / 255.0;
const float LOG2_E = 1.4426950408889634;
const float SH_C0 = 0.28209479177387814;

ivec2 place(int at) { return ivec2(at % WIDTH, at / WIDTH); }

vec3 rotated(vec4 quat, vec3 v) {  // quat: w x y z in x y z w of the vector
    vec3 twice = 2.0 * cross(quat.yzw, v);
    return v + quat.x * twice + cross(quat.yzw, twice);
}

vec4 composed(vec4 a, vec4 b) {  // first b, then a
    return vec4(a.x * b.x - dot(a.yzw, b.yzw), a.x * b.yzw + b.x * a.yzw + cross(a.yzw, b.yzw));
}

vec4 turnedBy(vec3 turn) {  // radians
    vec3 halved = 0.5 * turn;
    float angle = max(length(halved), 1e-8);
    return vec4(cos(angle), halved * (sin(angle) / angle));
}

// Opacity close to the camera in the antialiased mode: 0 at the near plane, 1 from twice as far on.
float fade(float z) {
    float t = clamp((z - uNear) / uNear, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

#ifdef LIVES
// Moves and fades what life `at` belongs to, and returns its turn.
vec4 lived(int at, inout vec3 mean, inout float opacity) {
    vec4 life = texelFetch(uLives, place(2 * at), 0), spin = texelFetch(uLives, place(2 * at + 1), 0);
    float age = uFrame - life.x, shares = age * life.y;
    opacity *= exp(-0.5 * shares * shares);
    mean += age * vec3(life.zw, spin.x);
    return turnedBy(age * spin.yzw);
}
#endif

// Colour of primitive i in the direction d, from a texture with one texel for each coefficient.
vec3 colourOf(int i, vec3 d) {
    int at = i * COEFFICIENTS;
    float gain = 0.0;
#ifdef LIGHT
    gain = dot(texelFetch(uShades, place(i), 0).xyz, uLight);
#endif
#define SH(k) texelFetch(uSh, place(at + k), 0).rgb
    vec3 dc = SH(0), sum = SH_C0 * (dc + gain * (dc + 0.5 / SH_C0));
#if COEFFICIENTS > 1
    sum += 0.4886025119029199 * (d.z * SH(2) - d.y * SH(1) - d.x * SH(3));
#endif
#if COEFFICIENTS > 4
    vec3 dd = d * d;
    sum += 1.0925484305920792 * (d.x * d.y * SH(4) - d.y * d.z * SH(5) - d.x * d.z * SH(7) + 0.5 * (dd.x - dd.y) * SH(8));
    sum += 0.31539156525252005 * (2.0 * dd.z - dd.x - dd.y) * SH(6);
#endif
#if COEFFICIENTS > 9
    sum -= 0.5900435899266435 * (d.y * (3.0 * dd.x - dd.y) * SH(9) + d.x * (dd.x - 3.0 * dd.y) * SH(15));
    sum += 2.890611442640554 * d.x * d.y * d.z * SH(10) + 1.445305721320277 * d.z * (dd.x - dd.y) * SH(14);
    sum -= 0.4570457994644658 * (4.0 * dd.z - dd.x - dd.y) * (d.y * SH(11) + d.x * SH(13));
    sum += 0.3731763325901154 * d.z * (2.0 * dd.z - 3.0 * dd.x - 3.0 * dd.y) * SH(12);
#endif
    return max(sum + 0.5, 0.0);
}

#ifdef NODES
uniform highp sampler2D uPoses;  // three texels a node: turn, home, where home is now

vec3 carried(vec4 links, vec4 weights, vec3 point) {
    vec3 sum = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        int node = 3 * int(links[k]);
        vec3 home = texelFetch(uPoses, place(node + 1), 0).xyz;
        vec3 now = texelFetch(uPoses, place(node + 2), 0).xyz;
        sum += weights[k] * (rotated(texelFetch(uPoses, place(node), 0), point - home) + now);
    }
    return sum;
}

vec4 blended(vec4 links, vec4 weights) {
    vec4 first = texelFetch(uPoses, place(3 * int(links.x)), 0), sum = vec4(0.0);
    for (int k = 0; k < 4; ++k) {
        vec4 turn = texelFetch(uPoses, place(3 * int(links[k])), 0);
        sum += weights[k] * (dot(turn, first) < 0.0 ? -turn : turn);  // q and -q are one rotation
    }
    return normalize(sum);
}
#endif
