// Vectors and quaternions of one thread, in registers.
#pragma once
#include "device.cuh"

namespace e4dgs {

struct Vec {
    float x, y, z;
};
__device__ __forceinline__ Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
__device__ __forceinline__ Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
__device__ __forceinline__ Vec operator*(float s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
__device__ __forceinline__ float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
__device__ __forceinline__ Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
__device__ __forceinline__ Vec load_vec(const float* p) { return {p[0], p[1], p[2]}; }
__device__ __forceinline__ void store_vec(float* p, Vec a) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }

struct Quat {  // w x y z
    float w;
    Vec v;
};
__device__ __forceinline__ Quat operator+(Quat a, Quat b) { return {a.w + b.w, a.v + b.v}; }
__device__ __forceinline__ Quat operator-(Quat a, Quat b) { return {a.w - b.w, a.v - b.v}; }
__device__ __forceinline__ Quat operator*(float s, Quat a) { return {s * a.w, s * a.v}; }
__device__ __forceinline__ Quat operator*(Quat a, Quat b) { return {a.w * b.w - dot(a.v, b.v), a.w * b.v + b.w * a.v + cross(a.v, b.v)}; }
__device__ __forceinline__ Quat conjugate(Quat a) { return {a.w, -1.0f * a.v}; }
__device__ __forceinline__ float dot(Quat a, Quat b) { return a.w * b.w + dot(a.v, b.v); }
__device__ __forceinline__ Quat load_quat(const float* p) { return {p[0], load_vec(p + 1)}; }
__device__ __forceinline__ void store_quat(float* p, Quat q) { p[0] = q.w, store_vec(p + 1, q.v); }

// By how much a rotation by the unit quaternion q moves a.
__device__ __forceinline__ Vec moved_by(Quat q, Vec a) {
    const Vec twice = 2.0f * cross(q.v, a);
    return q.w * twice + cross(q.v, twice);
}

// From the gradient g of moved_by(q, a) to that of q.
__device__ __forceinline__ Quat unmoved(Quat q, Vec a, Vec g) {
    const Vec v = 2.0f * q.w * cross(a, g) + 2.0f * (dot(g, q.v) * a + dot(q.v, a) * g - 2.0f * dot(g, a) * q.v);
    return {2.0f * dot(g, cross(q.v, a)), v};
}

// Of an incoming gradient, row i; zero if there is none.
__device__ __forceinline__ Vec vec_or_zero(const float* g, int64 i) { return g ? load_vec(g + 3 * i) : Vec{0.0f, 0.0f, 0.0f}; }
__device__ __forceinline__ Quat quat_or_zero(const float* g, int64 i) { return g ? load_quat(g + 4 * i) : Quat{0.0f, {0.0f, 0.0f, 0.0f}}; }

}  // namespace e4dgs
