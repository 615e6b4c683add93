/* Parallel lines clipped to closed paths. One work-item per image: its chords cross each line an even number of times.
 *
 * frame[image] = (cos, sin, v of line 0 of the image, spacing) in pixels: u runs along the lines, v across them.
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

/* count[image * lines + line] crossings. */
__kernel void count_crossings(__global const float2 *points, __global const int *next, __global const int *place,
                              __global const int4 *totals, __global const float4 *frame, int lines, __global int *count)
{
    int image = (int)get_global_id(0);
    for (int i = place[image]; i < place[image] + totals[image].x; i++) {
        int2 hit = lines_of(turned(points[i], frame[image]).y, turned(points[next[i]], frame[image]).y, frame[image]);
        for (int j = max(hit.x, 0); j < min(hit.y, lines); j++) count[image * lines + j]++;
    }
}

/* fill[k] = (u0, u1) and line[k], packed per image from start[image * lines] / 2; made[image] lines are left. */
__kernel void fill_lines(__global const float2 *points, __global const int *next, __global const int *place,
                         __global const int4 *totals, __global const float4 *frame, int lines,
                         __global const int *start, __global int *used, float inset, float shortest,
                         __global float *crossing, __global float2 *fill, __global int *line, __global int *made)
{
    int image = (int)get_global_id(0);
    for (int i = place[image]; i < place[image] + totals[image].x; i++) {
        float2 a = turned(points[i], frame[image]), b = turned(points[next[i]], frame[image]);
        int2 hit = lines_of(a.y, b.y, frame[image]);
        for (int j = max(hit.x, 0); j < min(hit.y, lines); j++) {
            float v = frame[image].z + (float)j * frame[image].w;
            float u = a.x + (v - a.y) * ((b.x - a.x) / (b.y - a.y));
            __global float *row = crossing + start[image * lines + j];
            int n = used[image * lines + j]++;
            for (; n > 0 && row[n - 1] > u; n--) row[n] = row[n - 1];
            row[n] = u;
        }
    }
    int n = 0, first = start[image * lines] / 2;
    for (int j = 0; j < lines; j++)
        for (int k = start[image * lines + j]; k + 1 < start[image * lines + j + 1]; k += 2) {
            float a = crossing[k] + inset, b = crossing[k + 1] - inset;
            if (b - a < shortest) continue;
            fill[first + n] = (float2)(a, b);
            line[first + n++] = j;
        }
    made[image] = n;
}
