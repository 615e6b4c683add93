/* The pieces of a level set, and the area that it encloses. One work-item per stored tile; on a GPU, one per row of it. */

#define ROWS_OF_TILE(r) for (int r = LANE; r < TILE; r += LANES)

__kernel void count_isoline(__global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                            int tiles_y, int level, float quantum, volatile __global int *count)
{
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    int low[2], high[2], n = 0;
    ROWS_OF_TILE(r) {
        uint a = row_bits(pool, &t, r, level), b = row_bits(pool, &t, r + 1, level);
        for (uint left = crossed_cells(a, b); left; left &= left - 1) {
            load_cell(pool, &t, popcount((left & -left) - 1), r, low, high);
            int c = case_of(low, high, level);
            n += c == 5 || c == 10 || creased(low, high, quantum) ? 2 : 1;
        }
    }
    if (n) atomic_add(&count[t.key], n);
}

__kernel void place_isoline(__global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                            int tiles_y, int level, float quantum, float cosine_least, volatile __global int *cursor,
                            __global float4 *pieces)
{
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    int low[2], high[2];
    ROWS_OF_TILE(r) {
        uint a = row_bits(pool, &t, r, level), b = row_bits(pool, &t, r + 1, level);
        for (uint left = crossed_cells(a, b); left; left &= left - 1) {
            int i = popcount((left & -left) - 1), row = t.y + r, column = t.x + i;
            load_cell(pool, &t, i, r, low, high);
            int c = case_of(low, high, level), from = enter_edge[c], to = leave_edge[c];
            float x = (float)column, y = (float)row;
            if (c == 5 || c == 10) { /* two pieces; which corners they cut off depends on the centre */
                int joined = centre_inside(low, high, level) == (c == 5);
                from = 0, to = joined ? 1 : 3;
                pieces[atomic_inc(&cursor[t.key])] = (float4)(edge_point(low, high, 2, level, x, y),
                                                              edge_point(low, high, joined ? 3 : 1, level, x, y));
            }
            float2 p = edge_point(low, high, from, level, x, y), q = edge_point(low, high, to, level, x, y), corner = q;
            if (c != 5 && c != 10 && creased(low, high, quantum)) { /* counted as two, whether it has a corner or not */
                corner_of(map, pool, t.base, tiles_x, tiles_y, column, row, from, to, level, quantum, cosine_least, 0.3f,
                          &p, &q, &corner);
                pieces[atomic_inc(&cursor[t.key])] = (float4)(corner, q);
            }
            pieces[atomic_inc(&cursor[t.key])] = (float4)(p, corner);
        }
    }
}

/* What a corner adds to the area left of the chord p - q, less the bend that it does not need. */
inline float corner_area(__global const int *map, __global const short *pool, int base, int tiles_x, int tiles_y, int x, int y,
                         int from, int to, int level, float quantum, float bend, float2 p, float2 q)
{
    float2 origin = (float2)(x, y), on_p = p + origin, on_q = q + origin, c;
    if (!corner_of(map, pool, base, tiles_x, tiles_y, x, y, from, to, level, quantum, SHARP, 0.0f, &on_p, &on_q, &c)) return 0.0f;
    float2 a = on_p - origin - p, b = c - origin - p, d = on_q - origin - p, e = q - p, in = b - a, out = d - b;
    float turns = atan2(in.x * out.y - in.y * out.x, dot(in, out)) * (2.0f / M_PI_F); /* in quarters of a circle */
    return 0.5f * (a.x * b.y - a.y * b.x + b.x * d.y - b.y * d.x + d.x * e.y - d.y * e.x) - turns * bend;
}

/* Area inside the level in one cell. */
inline float cell_area(const int *low, const int *high, int c, int level, float bend)
{
    float e0 = between(low[0], low[1], level), e1 = between(low[1], high[1], level);
    float e2 = between(high[0], high[1], level), e3 = between(low[0], high[0], level);
    float b0 = 0.5f * e0 * e3 + bend, b1 = 0.5f * (1.0f - e0) * e1 + bend; /* triangles at the corners */
    float b2 = 0.5f * (1.0f - e2) * (1.0f - e1) + bend, b3 = 0.5f * e2 * (1.0f - e3) + bend;
    switch (c) {
    case 1: return b0;
    case 2: return b1;
    case 4: return b2;
    case 8: return b3;
    case 14: return 1.0f - b0;
    case 13: return 1.0f - b1;
    case 11: return 1.0f - b2;
    case 7: return 1.0f - b3;
    case 3: return 0.5f * (e3 + e1);
    case 12: return 1.0f - 0.5f * (e3 + e1);
    case 9: return 0.5f * (e0 + e2);
    case 6: return 1.0f - 0.5f * (e0 + e2);
    case 5: return centre_inside(low, high, level) ? 1.0f - b1 - b3 : b0 + b2;
    default: return centre_inside(low, high, level) ? 1.0f - b0 - b2 : b1 + b3;
    }
}

/* area[key]: area inside the level in each stored tile, in 1/65536 px^2. Each quarter turn of the contour is given `bend`
 * back: marching squares cut that much off a circle, whatever its radius (docs/accuracy.md). */
__kernel void isoline_area(__global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                           int tiles_y, int level, float quantum, float bend, volatile __global int *area)
{
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    int low[2], high[2], sum = 0;
    ROWS_OF_TILE(r) {
        uint a = row_bits(pool, &t, r, level), b = row_bits(pool, &t, r + 1, level);
        sum += (int)popcount(a & (a >> 1) & b & (b >> 1) & 0xffffu) << 16;
        for (uint left = crossed_cells(a, b); left; left &= left - 1) {
            int i = popcount((left & -left) - 1);
            load_cell(pool, &t, i, r, low, high);
            int c = case_of(low, high, level), from = enter_edge[c], to = leave_edge[c];
            float part = cell_area(low, high, c, level, bend);
            if (c != 5 && c != 10 && creased(low, high, quantum))
                part += corner_area(map, pool, t.base, tiles_x, tiles_y, t.x + i, t.y + r, from, to, level, quantum, bend,
                                    edge_point(low, high, from, level, 0.0f, 0.0f), edge_point(low, high, to, level, 0.0f, 0.0f));
            sum += convert_int_rte(part * 65536.0f);
        }
    }
    if (sum) atomic_add(&area[t.key], sum);
}
