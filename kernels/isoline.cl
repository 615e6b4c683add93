/* The pieces of a level set. One work-item per stored tile; on a GPU, one per row of it. */

/* count[key]: room for the pieces of a tile, two for each cell that the level crosses. */
__kernel void count_isoline(int items, __global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                            int tiles_y, int level, volatile __global int *count)
{
    if (ITEM >= items) return;
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    int n = 0;
    uint a, b = first_bits(pool, &t, level);
    ROWS_OF_TILE(r) {
        NEXT_BITS(a, b, pool, &t, r, level);
        n += 2 * popcount(crossed_cells(a, b));
    }
    if (n) atomic_add(&count[t.key], n);
}

#define NEXT_PIECE pieces[LANES == 1 ? n++ : atomic_inc(&cursor[t.key])]

/* Place the pieces of a tile from cursor[key] on, which is moved to their end. */
__kernel void place_isoline(int items, __global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                            int tiles_y, int level, float quantum, float cosine_least, volatile __global int *cursor,
                            __global float4 *pieces)
{
    if (ITEM >= items) return;
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    int low[2], high[2], n = cursor[t.key];
    uint a, b = first_bits(pool, &t, level);
    ROWS_OF_TILE(r) {
        NEXT_BITS(a, b, pool, &t, r, level);
        for (uint left = crossed_cells(a, b); left; left &= left - 1) {
            int i = popcount((left & -left) - 1), row = t.y + r, column = t.x + i;
            load_cell(pool, &t, i, r, low, high);
            int c = case_of(low, high, level), from = enter_edge[c], to = leave_edge[c];
            float x = (float)column, y = (float)row;
            if (c == 5 || c == 10) { /* two pieces; which corners they cut off depends on the centre */
                int joined = centre_inside(low, high, level) == (c == 5);
                from = 0, to = joined ? 1 : 3;
                NEXT_PIECE = (float4)(edge_point(low, high, 2, level, x, y), edge_point(low, high, joined ? 3 : 1, level, x, y));
            }
            float2 p = edge_point(low, high, from, level, x, y), q = edge_point(low, high, to, level, x, y), corner = q;
            if (c != 5 && c != 10 && creased(low, high, quantum)
                && corner_of(map, pool, t.base, tiles_x, tiles_y, column, row, from, to, level, quantum, cosine_least, 0.3f, &p, &q, &corner))
                NEXT_PIECE = (float4)(corner, q);
            NEXT_PIECE = (float4)(p, corner);
        }
    }
    if (LANES == 1) cursor[t.key] = n;
}
