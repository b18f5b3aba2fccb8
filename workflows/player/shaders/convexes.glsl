// A smooth convex seen by the camera (Edge4DGS, Eq. 3-7, as in rasterizer/math/convex.h): the hull of its projected points, with a plane for
// each edge. One pass finds the hull, and writes where the convex is and how it looks; the other finds one edge a texel, and writes its line
// L(pixel) = log2(w exp(tau H)) = a dx + b dy + c, where (dx, dy) is counted from the corner of the convex's box. The part of c that is the
// same for all edges, log2(CORNERS / perimeter), is added to their sum only.
uniform highp sampler2D uPoints;  // a texel for each point: xyz
uniform highp sampler2D uShapes;  // tau, kappa, opacity

const float DEGENERATE = 1e-5;  // least area of a hull, of its squared extent
const float FLAT = 1e-6;  // of the squared extent; smaller turns may be rounding and make no corner
const float PIXEL_EDGE = 0.18204784532536746;  // 0.8 / (2 ln 9): kappa of a sharp edge seen through a pixel's box
const float WIDE = 6.579736267392906, THIN = 2.705808084277845;  // of the integral of M, docs/maths.md
const float NO_EDGE = -1e30;

vec3 meanPoint;  // world, before clipping
vec3 centre;  // camera, after clipping
vec2 q[CORNERS];  // points in the plane (x/z, y/z), relative to the centre
vec3 shape;  // tau, kappa, opacity

// Twice the area of the triangle of corners a, b, c, which lie at A, B, C: to the bit the same (but for the sign) for every order of them, so
// that all tests agree.
float turn(int a, vec2 A, int b, vec2 B, int c, vec2 C) {
    bool odd = false;
    int t;
    vec2 T;
    if (a > b) t = a, a = b, b = t, T = A, A = B, B = T, odd = !odd;
    if (b > c) t = b, b = c, c = t, T = B, B = C, C = T, odd = !odd;
    if (a > b) t = a, a = b, b = t, T = A, A = B, B = T, odd = !odd;
    vec2 u = B - A, v = C - A;
    float doubled = u.x * v.y - u.y * v.x;
    return odd ? -doubled : doubled;
}

bool placed(int i) {  // fills in the points; false if nothing is in front of the camera
    vec3 p[CORNERS];
    shape = texelFetch(uShapes, place(i), 0).xyz;
    meanPoint = vec3(0.0);
    for (int k = 0; k < CORNERS; ++k) {
        p[k] = texelFetch(uPoints, place(i * CORNERS + k), 0).xyz;
#ifdef NODES
        if (i >= uStill) {
            int at = (i - uStill) * CORNERS + k;
            p[k] = carried(texelFetch(uLinks, place(at), 0), texelFetch(uWeights, place(at), 0), p[k]);
        }
#endif
#ifdef PATHS
        if (i >= uStill) {
            int at = (i - uStill) * CORNERS + k;
            p[k] += mix(texelFetch(uKey, place(at), 0).xyz, texelFetch(uNextKey, place(at), 0).xyz, uBetween);
        }
#endif
        meanPoint += p[k] / float(CORNERS);
    }
    vec3 moved = meanPoint;
    vec4 quat = vec4(1.0, 0.0, 0.0, 0.0);
#ifdef LIVES
    if (i >= uStill) quat = lived(i - uStill, moved, shape.z);
#endif
    if (shape.z < LEAST_ALPHA) return false;
    vec3 arm[CORNERS];  // from the centre
    centre = uRotation * (moved - uEye);
    float least = centre.z;
    for (int k = 0; k < CORNERS; ++k) {
        arm[k] = uRotation * rotated(quat, p[k] - meanPoint);
        least = min(least, centre.z + arm[k].z);
    }
    meanPoint = moved;
    if (least < uNear) {
#ifdef ANTIALIASED
        // A point that is too near moves to the near plane, towards the mean of those in front, weighted by their distance from that plane.
        float weight = 0.0;
        vec3 front = vec3(0.0), sum = vec3(0.0);
        for (int k = 0; k < CORNERS; ++k) {
            p[k] = centre + arm[k];
            float w = max(p[k].z - uNear, 0.0);
            weight += w, front += w * p[k];
        }
        if (!(weight > 0.0)) return false;
        front /= weight;
        for (int k = 0; k < CORNERS; ++k) {
            if (p[k].z < uNear) p[k] = vec3(p[k].xy + (uNear - p[k].z) / (front.z - p[k].z) * (front.xy - p[k].xy), uNear);
            sum += p[k];
        }
        centre = sum / float(CORNERS);
        for (int k = 0; k < CORNERS; ++k) arm[k] = p[k] - centre;
#else
        return false;
#endif
    }
    for (int k = 0; k < CORNERS; ++k) q[k] = (arm[k].xy * centre.z - centre.xy * arm[k].z) / ((centre.z + arm[k].z) * centre.z);
    return true;
}

float extent, tiny;  // of the points; turns below this may be rounding
int firsts;  // a bit for each point; 0 where it coincides with one before it

bool apartFrom(int k, int m) { return m != k && (firsts >> m & 1) == 1; }

void compared() {  // fills in the three above
    vec2 low = q[0], high = q[0];
    for (int k = 1; k < CORNERS; ++k) low = min(low, q[k]), high = max(high, q[k]);
    extent = max(high.x - low.x, high.y - low.y), tiny = FLAT * extent * extent;
    firsts = (1 << CORNERS) - 1;
    for (int k = 1; k < CORNERS; ++k) {
        vec2 at = q[k];
        for (int m = 0; m < k; ++m) {
            vec2 apart = q[m] - at;
            if (!(dot(apart, apart) > FLAT * tiny)) firsts &= ~(1 << k);
        }
    }
}

// The corner after corner k; -1 if k is none. The point with all others to its left is sought as a string is wound around a parcel; if k lies
// inside, some are to its right.
int after(int k) {
    int found = -1;
    vec2 from = q[k], to = from;
    for (int j = 0; j < CORNERS; ++j) {
        if (!apartFrom(k, j)) continue;
        vec2 at = q[j];
        float side = found < 0 ? -1e30 : turn(k, from, found, to, j, at);
        if (side < -tiny || (side <= tiny && dot(at - from, at - to) > 0.0)) found = j, to = at;
    }
    bool edge = (firsts >> k & 1) == 1;
    for (int m = 0; m < CORNERS; ++m) {
        if (m == found || !apartFrom(k, m)) continue;
        vec2 at = q[m];
        float side = turn(k, from, found, to, m, at);
        edge = edge && (side > tiny || (side >= -tiny && dot(at - from, at - to) <= 0.0));
    }
    return edge ? found : -1;
}

// a, b, c of the edge from corner k to `to`, less the part of c that all edges share; dx and dy are counted from the
// projected centre.
vec3 lineOf(int k, int to) {
    vec2 from = q[k], along = q[to] - from, absolute = from + centre.xy / centre.z;
    float size = length(along);
    vec2 e = along / size;
    float lift = absolute.y * e.x - absolute.x * e.y;
    float strength = shape.x * centre.z * LOG2_E * inversesqrt(1.0 + lift * lift);
    return vec3(strength * e.y / uLens.x, -strength * e.x / uLens.y, strength * (from.y * e.x - from.x * e.y) + log2(size));
}

#ifdef EDGES
uniform highp usampler2D uPlace;  // what the other pass has written
layout(location = 0) out highp uvec4 oLine;

void main() {
    oLine = floatBitsToUint(vec4(0.0, 0.0, NO_EDGE, 0.0));
    ivec2 texel = ivec2(gl_FragCoord.xy);
    int at = texel.y * WIDTH + texel.x, i = at / CORNERS, k = at - i * CORNERS;
    if (i >= uCount) return;
    vec4 box = uintBitsToFloat(texelFetch(uPlace, place(uFirst + i), 0));
    if (!(box.z > box.x) || !placed(i)) return;
    compared();
    int to = after(k);
    if (to < 0) return;
    vec3 line = lineOf(k, to);
    vec2 start = box.xy - (uLens.xy * centre.xy / centre.z + uLens.zw);
    oLine = floatBitsToUint(vec4(line.xy, line.z + dot(line.xy, start), 0.0));
}
#else
layout(location = 0) out highp uvec4 oPlace;  // box px: left, top, right, bottom
layout(location = 1) out highp uvec4 oLook;  // kappa / tau, opacity, colour, what all lines share

int next[CORNERS];  // the corner after a corner; -1 for points that are none
float area, perimeter;

bool hulled() {  // finds the edges; false if the hull is a point, a line or a sliver
    compared();
    area = perimeter = 0.0;
    for (int k = 0; k < CORNERS; ++k) {
        next[k] = after(k);
        if (next[k] < 0) continue;
        vec2 to = q[next[k]];
        area += 0.5 * (q[k].x * to.y - q[k].y * to.x);
        perimeter += length(to - q[k]);
    }
    return area > DEGENERATE * extent * extent;
}

void main() {
    oPlace = oLook = uvec4(0u);
    ivec2 texel = ivec2(gl_FragCoord.xy);
    int i = texel.y * WIDTH + texel.x - uFirst;
    if (i < 0 || i >= uCount) discard;
    if (!placed(i) || !hulled()) return;
    float kappa = shape.y, opacity = shape.z;
#ifdef ANTIALIASED
    float deep = kappa * centre.z, pixel = deep * PIXEL_EDGE, inner = deep * 2.0 * area / perimeter;
    float t = 1.0 / (1.0 + pixel * pixel / (uLens.x * uLens.y)), r = t * inner * inner;
    opacity *= sqrt((r * r + WIDE * t * r + THIN * t * t) / (r * r + WIDE * r + THIN)) * fade(centre.z);
    kappa *= sqrt(t);
#endif
    if (!(opacity > LEAST_ALPHA)) return;
    // alpha is above the least where log2 sum 2^L <= limit, and so inside of all lines L = limit.
    float rho = kappa / shape.x, limit = log2(opacity / LEAST_ALPHA - 1.0) / rho;
    float shared_ = log2(float(CORNERS) / perimeter);
    limit += 3e-3 + 1e-3 * abs(shared_) + 1e-4 * abs(limit) - shared_;
    vec2 middle = uLens.xy * centre.xy / centre.z + uLens.zw;
    vec4 box = vec4(-middle, uSize - middle);
    vec3 line[CORNERS];
    for (int k = 0; k < CORNERS; ++k) line[k] = next[k] < 0 ? vec3(0.0) : lineOf(k, next[k]);
    for (int i = 0; i < CORNERS; ++i)
        for (int j = 0; j < CORNERS; ++j) {
            vec3 u = line[i], v = line[j];
            float det = u.x * v.y - v.x * u.y;
            if (next[i] < 0 || next[j] < 0 || !(det > 0.0)) continue;
            vec2 meet = vec2((limit - u.z) * v.y - (limit - v.z) * u.y, u.x * (limit - v.z) - v.x * (limit - u.z)) / det;
            if (u.y <= 0.0 && v.y > 0.0) box.z = min(box.z, meet.x + 0.01);
            if (u.y >= 0.0 && v.y < 0.0) box.x = max(box.x, meet.x - 0.01);
            if (u.x >= 0.0 && v.x < 0.0) box.w = min(box.w, meet.y + 0.01);
            if (u.x <= 0.0 && v.x > 0.0) box.y = max(box.y, meet.y - 0.01);
        }
    box += middle.xyxy;
    if (!(box.z > box.x) || !(box.w > box.y)) return;
    vec3 colour = colourOf(i, normalize(meanPoint - uEye + 1e-12));
    oPlace = floatBitsToUint(box);
    oLook = uvec4(floatBitsToUint(rho), floatBitsToUint(opacity), packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, shared_)));
}
#endif
