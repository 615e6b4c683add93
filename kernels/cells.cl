/* Marching squares on the stored tiles of a map.
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
