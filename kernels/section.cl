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

/* First plane k with z <= plane[k] (all planes are sorted), given a good guess. */
inline int first_above(__global const float *plane, int n, float z, float z0, float per_mm)
{
    int k = clamp((int)((z - z0) * per_mm), 0, n);
    while (k > 0 && plane[k - 1] >= z) k--;
    while (k < n && plane[k] < z) k++;
    return k;
}

__kernel void count_segments(__global const float *vertices, int triangles, int per_chunk,
                             __global const float *plane, int slices, float z0, float per_mm,
                             __global int *counts)
{
    int c = (int)get_global_id(0);
    __global int *mine = counts + c * slices;
    for (int k = 0; k < slices; k++) mine[k] = 0;
    int end = min(triangles, (c + 1) * per_chunk);
    for (int i = c * per_chunk; i < end; i++) {
        __global const float *v = vertices + 9 * i;
        float low = LESSER(v[2], LESSER(v[5], v[8])), high = GREATER(v[2], GREATER(v[5], v[8]));
        int k = first_above(plane, slices, low, z0, per_mm);
        for (; k < slices && plane[k] < high; k++) mine[k]++;
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

/* balance[k] sums +hash at the start of each segment and -hash at its end: 0 when every point that is left is reached. */
__kernel void emit_segments(__global const float *vertices, int triangles, int per_chunk,
                            __global const float *plane, int slices, float z0, float per_mm,
                            __global int *places, __global float4 *segments, __global int *slice_of,
                            volatile __global int *balance, int first_slice)
{
    int c = (int)get_global_id(0);
    __global int *mine = places + c * slices;
    int end = min(triangles, (c + 1) * per_chunk);
    for (int i = c * per_chunk; i < end; i++) {
        __global const float *v = vertices + 9 * i;
        float low = LESSER(v[2], LESSER(v[5], v[8])), high = GREATER(v[2], GREATER(v[5], v[8]));
        int k = first_above(plane, slices, low, z0, per_mm);
        for (; k < slices && plane[k] < high; k++) {
            float h = plane[k];
            int a = v[2] > h, b = v[5] > h, d = v[8] > h;
            int lone = a == b ? 2 : a == d ? 1 : 0; /* the vertex that is alone on its side */
            int up = lone == 0 ? a : lone == 1 ? b : d;
            __global const float *p = v + 3 * lone;
            __global const float *q = v + 3 * ((lone + 1) % 3), *r = v + 3 * ((lone + 2) % 3);
            float2 s = up ? cut(q, p, h) : cut(p, r, h);
            float2 e = up ? cut(r, p, h) : cut(p, q, h);
            int place = mine[k]++;
            segments[place] = (float4)(s, e);
            slice_of[place] = first_slice + k;
            uint difference = point_hash(s) - point_hash(e);
            if (difference) atomic_add(&balance[k], (int)difference);
        }
    }
}
