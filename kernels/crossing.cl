/* Whether decimated loops stayed simple: chords of one image that meet. */

#define RUN 16

/* box[g]: what the chords of run g, which start at run_first[g], lie in. */
__kernel void find_boxes(__global const float2 *points, __global const int *next, __global const int *run_image,
                         __global const int *run_first, __global const int *place, __global const int4 *totals, int runs,
                         __global float4 *box)
{
    int g = (int)get_global_id(0);
    if (g >= runs) return;
    int image = run_image[g], from = run_first[g], to = min(from + RUN, place[image] + totals[image].x);
    float2 low = points[from], high = low;
    for (int i = from; i < to; i++) {
        low = LESSER(low, LESSER(points[i], points[next[i]]));
        high = GREATER(high, GREATER(points[i], points[next[i]]));
    }
    box[g] = (float4)(low, high);
}

/* Whether chords a-b and c-d meet; chords that share a vertex meet only when one runs back over the other. */
inline int chords_meet(float2 a, float2 b, float2 c, float2 d, int follows)
{
    if (follows) return fabs(cross2(b - a, d - c)) < 1e-5f && dot(b - a, d - c) < 0.0f;
    if (LESSER(a.x, b.x) > GREATER(c.x, d.x) || LESSER(c.x, d.x) > GREATER(a.x, b.x)) return 0;
    if (LESSER(a.y, b.y) > GREATER(c.y, d.y) || LESSER(c.y, d.y) > GREATER(a.y, b.y)) return 0;
    float p = cross2(b - a, c - a), q = cross2(b - a, d - a), r = cross2(d - c, a - c), s = cross2(d - c, b - c);
    return p * q <= 0.0f && r * s <= 0.0f;
}

/* Flag the loops of which a chord meets another chord of the image. A work-item takes one run of chords against all later. */
__kernel void find_crossings(__global const float2 *points, __global const int *next, __global const int *loop_of,
                             __global const int *run_image, __global const int *run_first, __global const int *place,
                             __global const int4 *totals, int runs, __global const float4 *box, __global uchar *crossed)
{
    int g = (int)get_global_id(0);
    if (g >= runs) return;
    int image = run_image[g], from = run_first[g];
    int end = place[image] + totals[image].x, to = min(from + RUN, end);
    float4 a = box[g];
    for (int h = g; h < runs && run_image[h] == image; h++) {
        float4 b = box[h];
        if (b.x > a.z || a.x > b.z || b.y > a.w || a.y > b.w) continue;
        int other = run_first[h], stop = min(other + RUN, end);
        for (int i = from; i < to; i++) {
            float2 p = points[i], q = points[next[i]];
            if (LESSER(p.x, q.x) > b.z || b.x > GREATER(p.x, q.x) || LESSER(p.y, q.y) > b.w || b.y > GREATER(p.y, q.y)) continue;
            for (int j = max(other, i + 1); j < stop; j++) {
                int follows = next[i] == j || next[j] == i;
                int meet = next[j] == i && next[i] != j ? chords_meet(points[j], points[i], points[i], points[next[i]], 1)
                                     : chords_meet(p, q, points[j], points[next[j]], follows);
                if (meet) crossed[loop_of[i]] = crossed[loop_of[j]] = 1;
            }
        }
    }
}
