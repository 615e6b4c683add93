/* Marching squares on the stored tiles of a map: the pieces of a level set, and the area that it encloses.
 *
 *      b3 --e2-- b2       Cell (x, y) has pixel (x, y) at b0; bit i of a case is set where b_i is inside (q < level).
 *      |          |       The level is a whole number and a pixel stands for q + 0.5, so a crossing is never at a pixel.
 *     e3          e1      A crossed cell lies within sqrt(2) pixels of the level, so all its tiles are stored.
 *      |          |
 *      b0 --e0-- b1       One work-item per stored row of 16 cells.
 */

/* Edges from and to which the contour runs, inside on its left, by case; saddles (5, 10) aside. */
__constant char enter_edge[16] = {-1, 0, 1, 1, 2, -1, 2, 2, 3, 0, -1, 1, 3, 0, 3, -1};
__constant char leave_edge[16] = {-1, 3, 0, 3, 1, -1, 0, 3, 2, 2, -1, 2, 1, 1, 0, -1};

/* Pixels 0..16 of rows r and r + 1 of a stored tile, its neighbours included. */
inline void load_cells(__global const int *map, __global const short *pool, int key, int r, int tiles_x, int tiles_y,
                       int *low, int *high)
{
    int tiles = tiles_x * tiles_y, tile = key % tiles, base = key - tile;
    int x = (tile % tiles_x) * TILE, y = (tile / tiles_x) * TILE + r;
    __global const short *row = pool + map[key] * PIXELS + r * 16;
    int right = x + 16 < tiles_x * TILE, above = y + 1 < tiles_y * TILE;
    for (int i = 0; i < 16; i++) low[i] = row[i];
    low[16] = right ? pixel(map, pool, base, tiles_x, x + 16, y) : FAR;
    if (r < 15)
        for (int i = 0; i < 16; i++) high[i] = row[16 + i];
    else
        for (int i = 0; i < 16; i++) high[i] = above ? pixel(map, pool, base, tiles_x, x + i, y + 1) : FAR;
    high[16] = right && above ? pixel(map, pool, base, tiles_x, x + 16, y + 1) : FAR;
}

inline int case_of(const int *low, const int *high, int i, int level)
{
    return (low[i] < level) | (low[i + 1] < level) << 1 | (high[i + 1] < level) << 2 | (high[i] < level) << 3;
}

/* Where the level lies between two pixels, as a fraction. */
inline float between(int a, int b, int level)
{
    float p = (float)(a - level) + 0.5f, q = (float)(b - level) + 0.5f;
    return p / (p - q);
}

inline int centre_inside(const int *low, const int *high, int i, int level)
{
    return low[i] + low[i + 1] + high[i] + high[i + 1] + 2 < 4 * level;
}

/* Point on edge e of cell i of a row that starts at (x, y). */
inline float2 edge_point(const int *low, const int *high, int i, int e, int level, float x, float y)
{
    if (e == 0) return (float2)(x + i + between(low[i], low[i + 1], level), y);
    if (e == 1) return (float2)(x + i + 1, y + between(low[i + 1], high[i + 1], level));
    if (e == 2) return (float2)(x + i + between(high[i], high[i + 1], level), y + 1.0f);
    return (float2)(x + i, y + between(low[i], high[i], level));
}

__kernel void count_isoline(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                            int tiles_y, int level, volatile __global int *count)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, n = 0;
    load_cells(map, pool, owner[slot], (int)get_global_id(0) & 15, tiles_x, tiles_y, low, high);
    for (int i = 0; i < 16; i++) {
        int c = case_of(low, high, i, level);
        n += (c == 5 || c == 10) ? 2 : (c != 0 && c != 15);
    }
    if (n) atomic_add(&count[owner[slot]], n);
}

__kernel void place_isoline(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                            int tiles_y, int level, volatile __global int *cursor, __global float4 *pieces)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, r = (int)get_global_id(0) & 15;
    int key = owner[slot], tile = key % (tiles_x * tiles_y);
    float x = (float)(tile % tiles_x * TILE), y = (float)(tile / tiles_x * TILE + r);
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
        pieces[atomic_inc(&cursor[key])] = (float4)(edge_point(low, high, i, from, level, x, y),
                                                    edge_point(low, high, i, to, level, x, y));
    }
}

/* area[key]: area inside the level in each stored tile, in 1/65536 px^2. Each quarter turn of the contour is given `bend`
 * back: marching squares cut that much off a circle, whatever its radius (docs/accuracy.md). */
__kernel void isoline_area(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                           int tiles_y, int level, float bend, volatile __global int *area)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4;
    float sum = 0.0f;
    load_cells(map, pool, owner[slot], (int)get_global_id(0) & 15, tiles_x, tiles_y, low, high);
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
    }
    if (sum != 0.0f) atomic_add(&area[owner[slot]], convert_int_rte(sum * 65536.0f));
}

/* Add the area of the part that no bead reaches: farther from the inset contour (pieces) than half a width.
 * A pixel counts by the part of it that is inside; `slack` pixels are forgiven to curvature. */
__kernel void lost_area(__global const float4 *pieces, __global const int *start, __global const short *pool,
                        __global const int *owner, int tiles_x, int tiles_y, int reach, float half_width, float slack,
                        int inset, float scale, __global int *lost)
{
    __local int shared[1];
    int key = owner[ITEM], tiles = tiles_x * tiles_y, tile = key % tiles, base = key - tile;
    int ty = tile / tiles_x, tx = tile - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE), far = half_width + slack + 1.0f;
    __global const short *mine = pool + ITEM * PIXELS;
    V acc[OWNED];
    ROWS(r) acc[OWN(r)] = (V)(far * far);
    for (int v = ty - reach; v <= ty + reach; v++) {
        int2 run = run_of(start, base, tx - reach, tx + reach, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++)
            if (box_gap2(pieces[i], x, y) < far * far) lower_to(acc, pieces[i], x, y, far);
    }
    int sum = 0;
    ROWS(r) {
        VI q = LOAD(mine, r);
        V inside = fmin(fmax((V)0.5f - (TO_F(q) + 0.5f) / scale, (V)0.0f), (V)1.0f);
        V missed = fmin(fmax(sqrt(acc[OWN(r)]) - (half_width + slack), (V)0.0f), (V)1.0f);
        sum += row_sum(select(TO_I(inside * missed * 65536.0f), (VI)0, (VI)(q < inset)));
    }
#ifdef WIDE
    SYNC;
    if (LANE == 0) *shared = 0;
    SYNC;
    atomic_add(shared, sum);
    SYNC;
    if (LANE == 0) lost[key] = *shared;
#else
    lost[key] = sum;
#endif
}
