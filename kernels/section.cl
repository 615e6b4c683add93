/* Triangles x planes -> oriented segments, bucketed by slice.
 *
 * Count, scan (host), emit: chunk c of the triangles owns places[c * slices + k] .. of slice k, so
 * the order is (slice, triangle) on every device and nothing is overrun.
 * A vertex with z <= plane is below. Each edge is cut from its lower vertex to its upper one, so two
 * facets that share an edge give the same bits.
 */

/* xy of the corner a -> b edge (a below, b above) at height h; vertices are x, y, z triples. */
inline float2 cut(__global const float *a, __global const float *b, float h)
{
    float t = (h - a[2]) / (b[2] - a[2]);
    return (float2)(a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t);
}

/* level[v]: how many planes (which ascend) lie below vertex v; guessed first, planes are nearly even. */
__kernel void find_levels(__global const float *vertices, int count, __global const float *plane, int slices, float z0,
                          float per_mm, __global int *level)
{
    int v = (int)get_global_id(0);
    if (v >= count) return;
    float z = vertices[3 * v + 2];
    int k = clamp((int)((z - z0) * per_mm), 0, slices);
    while (k > 0 && plane[k - 1] >= z) k--;
    while (k < slices && plane[k] < z) k++;
    level[v] = k;
}

/* Numbers of the corners of facet i: three of a list, or every three vertices are one. */
inline int3 corners_of(__global const int *faces, int listed, int i)
{
    return listed ? vload3(i, faces) : (int3)(3 * i, 3 * i + 1, 3 * i + 2);
}

__kernel void count_segments(__global const int *level, __global const int *faces, int listed, int triangles, int per_chunk,
                             int slices, __global int *counts)
{
    int c = (int)get_global_id(0);
    __global int *mine = counts + c * slices;
    for (int k = 0; k < slices; k++) mine[k] = 0;
    int end = min(triangles, (c + 1) * per_chunk);
    for (int i = c * per_chunk; i < end; i++) {
        int3 v = corners_of(faces, listed, i);
        int k1 = level[v.x], k2 = level[v.y], k3 = level[v.z], high = max(k1, max(k2, k3));
        for (int k = min(k1, min(k2, k3)); k < high; k++) mine[k]++;
    }
}

inline uint mix(uint h)
{
    h ^= h >> 16;
    h *= 0x7feb352du;
    h ^= h >> 15;
    h *= 0x846ca68bu;
    return h ^ (h >> 16);
}

/* A number that depends on every bit of a point (0 and -0 are one point). */
inline uint point_hash(float2 p) { return mix(as_uint(p.x + 0.0f) * 0x9e3779b9u + mix(as_uint(p.y + 0.0f) + 0x632be5abu)); }

/* Slices first .. last - 1. balance[k - first] sums +hash at the start of each segment and -hash at its end: 0 when every
 * point that is left is reached. */
__kernel void emit_segments(__global const float *vertices, __global const int *level, __global const int *faces, int listed,
                            int triangles, int per_chunk, __global const float *plane, int first, int last,
                            __global int *places, __global float4 *segments, __global int *slice_of,
                            volatile __global int *balance)
{
    int c = (int)get_global_id(0);
    __global int *mine = places + c * (last - first);
    int end = min(triangles, (c + 1) * per_chunk);
    for (int i = c * per_chunk; i < end; i++) {
        int3 v = corners_of(faces, listed, i);
        int k1 = level[v.x], k2 = level[v.y], k3 = level[v.z], high = min(last, max(k1, max(k2, k3)));
        for (int k = max(first, min(k1, min(k2, k3))); k < high; k++) {
            int a = k1 > k, b = k2 > k, d = k3 > k; /* above the plane */
            int3 turned = a == b ? v.zxy : a == d ? v.yzx : v; /* the vertex that is alone on its side comes first */
            int up = a == b ? d : a == d ? b : a;
            __global const float *p = vertices + 3 * turned.x, *q = vertices + 3 * turned.y, *r = vertices + 3 * turned.z;
            float2 s = up ? cut(q, p, plane[k]) : cut(p, r, plane[k]);
            float2 e = up ? cut(r, p, plane[k]) : cut(p, q, plane[k]);
            int place = mine[k - first]++;
            segments[place] = (float4)(s, e);
            slice_of[place] = k;
            uint difference = point_hash(s) - point_hash(e);
            if (difference) atomic_add(&balance[k - first], (int)difference);
        }
    }
}
