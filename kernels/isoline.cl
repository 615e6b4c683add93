/* The pieces of a level set, and the area that it encloses. One work-item per stored row of 16 cells. */

__kernel void count_isoline(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                            int tiles_y, int level, float quantum, volatile __global int *count)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, n = 0;
    load_cells(map, pool, owner[slot], (int)get_global_id(0) & 15, tiles_x, tiles_y, low, high);
    for (int i = 0; i < 16; i++) {
        int c = case_of(low, high, i, level);
        if (c == 0 || c == 15) continue;
        n += c == 5 || c == 10 || creased(low, high, i, quantum) ? 2 : 1;
    }
    if (n) atomic_add(&count[owner[slot]], n);
}

__kernel void place_isoline(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                            int tiles_y, int level, float quantum, float cosine_least, volatile __global int *cursor,
                            __global float4 *pieces)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, r = (int)get_global_id(0) & 15;
    int key = owner[slot], tile = key % (tiles_x * tiles_y);
    int left = tile % tiles_x * TILE, row = tile / tiles_x * TILE + r;
    float x = (float)left, y = (float)row;
    load_cells(map, pool, key, r, tiles_x, tiles_y, low, high);
    for (int i = 0; i < 16; i++) {
        int c = case_of(low, high, i, level);
        if (c == 0 || c == 15) continue;
        int from = enter_edge[c], to = leave_edge[c];
        if (c == 5 || c == 10) { /* two pieces; which corners they cut off depends on the centre */
            int joined = centre_inside(low, high, i, level) == (c == 5);
            from = 0, to = joined ? 1 : 3;
            pieces[atomic_inc(&cursor[key])] = (float4)(edge_point(low, high, i, 2, level, x, y),
                                                        edge_point(low, high, i, joined ? 3 : 1, level, x, y));
        }
        float2 p = edge_point(low, high, i, from, level, x, y), q = edge_point(low, high, i, to, level, x, y), corner = q;
        if (c != 5 && c != 10 && creased(low, high, i, quantum)) { /* counted as two pieces, whether it has a corner or not */
            corner_of(map, pool, key - tile, tiles_x, tiles_y, left + i, row, from, to, level, quantum, cosine_least, 0.3f, &p, &q, &corner);
            pieces[atomic_inc(&cursor[key])] = (float4)(corner, q);
        }
        pieces[atomic_inc(&cursor[key])] = (float4)(p, corner);
    }
}

/* What a corner adds to the area left of the chord p - q, less the bend that it does not need. */
inline float corner_area(__global const int *map, __global const short *pool, int base, int tiles_x, int tiles_y, int x, int y,
                         int i, int from, int to, int level, float quantum, float bend, float2 p, float2 q)
{
    float2 origin = (float2)(x, y), on_p = p + origin, on_q = q + origin, c;
    if (!corner_of(map, pool, base, tiles_x, tiles_y, x + i, y, from, to, level, quantum, SHARP, 0.0f, &on_p, &on_q, &c)) return 0.0f;
    float2 a = on_p - origin - p, b = c - origin - p, d = on_q - origin - p, e = q - p, in = b - a, out = d - b;
    float turns = atan2(in.x * out.y - in.y * out.x, dot(in, out)) * (2.0f / M_PI_F); /* in quarters of a circle */
    return 0.5f * (a.x * b.y - a.y * b.x + b.x * d.y - b.y * d.x + d.x * e.y - d.y * e.x) - turns * bend;
}

/* area[key]: area inside the level in each stored tile, in 1/65536 px^2. Each quarter turn of the contour is given `bend`
 * back: marching squares cut that much off a circle, whatever its radius (docs/accuracy.md). */
__kernel void isoline_area(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                           int tiles_y, int level, float quantum, float bend, volatile __global int *area)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, r = (int)get_global_id(0) & 15;
    int key = owner[slot], tile = key % (tiles_x * tiles_y);
    float sum = 0.0f;
    load_cells(map, pool, key, r, tiles_x, tiles_y, low, high);
    for (int i = 0; i < 16; i++) {
        int c = case_of(low, high, i, level);
        if (c == 0 || c == 15) {
            sum += c == 15;
            continue;
        }
        float e0 = between(low[i], low[i + 1], level), e1 = between(low[i + 1], high[i + 1], level);
        float e2 = between(high[i], high[i + 1], level), e3 = between(low[i], high[i], level);
        float b0 = 0.5f * e0 * e3, b1 = 0.5f * (1.0f - e0) * e1; /* triangles at the corners */
        float b2 = 0.5f * (1.0f - e2) * (1.0f - e1), b3 = 0.5f * e2 * (1.0f - e3);
        int joined = centre_inside(low, high, i, level);
        sum += c == 1 ? b0 + bend : c == 2 ? b1 + bend : c == 4 ? b2 + bend : c == 8 ? b3 + bend
             : c == 14 ? 1.0f - b0 - bend : c == 13 ? 1.0f - b1 - bend
             : c == 11 ? 1.0f - b2 - bend : c == 7 ? 1.0f - b3 - bend
             : c == 3 ? 0.5f * (e3 + e1) : c == 12 ? 1.0f - 0.5f * (e3 + e1)
             : c == 9 ? 0.5f * (e0 + e2) : c == 6 ? 1.0f - 0.5f * (e0 + e2)
             : c == 5 ? (joined ? 1.0f - b1 - b3 - 2.0f * bend : b0 + b2 + 2.0f * bend)
                      : (joined ? 1.0f - b0 - b2 - 2.0f * bend : b1 + b3 + 2.0f * bend);
        if (c == 5 || c == 10 || !creased(low, high, i, quantum)) continue;
        float2 p = edge_point(low, high, i, enter_edge[c], level, 0.0f, 0.0f), q = edge_point(low, high, i, leave_edge[c], level, 0.0f, 0.0f);
        sum += corner_area(map, pool, key - tile, tiles_x, tiles_y, tile % tiles_x * TILE, tile / tiles_x * TILE + r, i,
                           enter_edge[c], leave_edge[c], level, quantum, bend, p, q);
    }
    if (sum != 0.0f) atomic_add(&area[key], convert_int_rte(sum * 65536.0f));
}
