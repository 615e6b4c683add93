/* Parallel lines clipped to closed paths. One work-item per filling f of image[f]: its chords cross each line an even number of times.
 *
 * frame[f] = (cos, sin, v of line 0, spacing) in pixels: u runs along the lines, v across them.
 */

inline float2 turned(float2 p, float4 frame)
{
    return (float2)(p.x * frame.x + p.y * frame.y, p.y * frame.x - p.x * frame.y);
}

/* Lines crossed by a chord, half open, so that a vertex on a line counts once. */
inline int2 lines_of(float a, float b, float4 frame)
{
    return (int2)(ceil_of((LESSER(a, b) - frame.z) / frame.w), ceil_of((GREATER(a, b) - frame.z) / frame.w));
}

/* count[f * lines + line] crossings; used[..]: 0. */
__kernel void count_crossings(__global const float2 *points, __global const int *next, __global const int *place,
                              __global const int4 *totals, __global const int *image, __global const float4 *frame, int lines,
                              __global int *count, __global int *used)
{
    int f = (int)get_global_id(0), from = place[image[f]], end = from + totals[image[f]].x;
    for (int j = f * lines; j < (f + 1) * lines; j++) count[j] = used[j] = 0;
    for (int i = from; i < end; i++) {
        int2 hit = lines_of(turned(points[i], frame[f]).y, turned(points[next[i]], frame[f]).y, frame[f]);
        for (int j = max(hit.x, 0); j < min(hit.y, lines); j++) count[f * lines + j]++;
    }
}

/* fill[k] = (u0, u1) and line[k], packed per filling from start[f * lines] / 2; made[f] lines are left. */
__kernel void fill_lines(__global const float2 *points, __global const int *next, __global const int *place,
                         __global const int4 *totals, __global const int *image, __global const float4 *frame, int lines,
                         __global const int *start, __global int *used, float inset, float shortest,
                         __global float *crossing, __global float2 *fill, __global int *line, __global int *made)
{
    int f = (int)get_global_id(0), from = place[image[f]], end = from + totals[image[f]].x;
    for (int i = from; i < end; i++) {
        float2 a = turned(points[i], frame[f]), b = turned(points[next[i]], frame[f]);
        int2 hit = lines_of(a.y, b.y, frame[f]);
        for (int j = max(hit.x, 0); j < min(hit.y, lines); j++) {
            float v = frame[f].z + (float)j * frame[f].w;
            float u = a.x + (v - a.y) * ((b.x - a.x) / (b.y - a.y));
            __global float *row = crossing + start[f * lines + j];
            int n = used[f * lines + j]++;
            for (; n > 0 && row[n - 1] > u; n--) row[n] = row[n - 1];
            row[n] = u;
        }
    }
    int n = 0, first = start[f * lines] / 2;
    for (int j = 0; j < lines; j++)
        for (int k = start[f * lines + j]; k + 1 < start[f * lines + j + 1]; k += 2) {
            float a = crossing[k] + inset, b = crossing[k + 1] - inset;
            if (b - a < shortest) continue;
            fill[first + n] = (float2)(a, b);
            line[first + n++] = j;
        }
    made[f] = n;
}
