/* Add the turns of a piece to the winding numbers of the pixels to its right, in the owned rows of the tile at (left, low). */
INLINE void wind_by(VI *w, float4 s, int left, int low)
{
    float x = (float)left, y = (float)low;
    if ((GREATER(s.x, s.z) <= x) | (LESSER(s.x, s.z) > x + 15.0f) | (GREATER(s.y, s.w) <= y) | (LESSER(s.y, s.w) > y + 15.0f)) return;
    int2 rows = rows_of(s) - low;
    for (int r = max(0, rows.x); r < min(16, rows.y); r++) {
        int first = first_right(s, r + low) - left;
        if (first < 1 || first > 15) continue;
#ifdef WIDE
        if (r % 4 != LANE >> 4) continue;
#endif
        w[OWN(r)] += select((VI)0, (VI)turn_of(s), (VI)(XS >= first));
    }
}

/* Pieces -> signed distance of the part, in the tiles that come within `band` of the boundary.
 *
 * near/near_start: the pieces that are boundary (distance); all/all_start: every piece (winding). They are the same
 * list unless shells overlap: tangled[layer] gets the bit WOUND where a winding
 * number is neither 0 nor 1. Tiles of the pieces are those of a window, `corner` its first; the map is that of the whole grid, in which
 * all others are OUTSIDE. pool[slot * 256 + y * 16 + x] = floor(d * scale), owner[slot] = layer * tiles + tile.
 */
__kernel void part_distance(int items, __global const float4 *near, __global const int *near_start,
                            __global const float4 *all, __global const int *all_start, __global const int *wind,
                            int2 corner, int tiles_x, int tiles_y, int2 grid, float band, int reach, float scale, int rule,
                            __global int *map, __global short *pool, __global int *owner, volatile __global int *slots,
                            volatile __global int *tangled)
{
    if (ITEM >= items) return;
    __local int shared[1];
    int tile = ITEM, tiles = tiles_x * tiles_y;
    int layer = tile / tiles, ty = (tile - layer * tiles) / tiles_x, tx = tile - layer * tiles - ty * tiles_x;
    int left = (corner.x + tx) * TILE, low = (corner.y + ty) * TILE, key = (layer * grid.y + corner.y + ty) * grid.x + corner.x + tx;
    float x = (float)left, y = (float)low;
    __global const int *wind_row = wind + (layer * tiles_y * TILE + ty * TILE) * tiles_x + tx;

    int close = 0;
    for (int v = ty - reach; v <= ty + reach; v++) {
        int2 run = run_of(near_start, layer * tiles, tx - reach, tx + reach, v, tiles_x, tiles_y);
        for (int i = run.x + LANE; i < run.y && !close; i += LANES) close = box_gap2(near[i], x, y) < band * band;
    }
    if (!all_max(close, shared)) {
        if (LANE == 0) map[key] = RULE(wind_row[0], rule) ? INSIDE : OUTSIDE;
        if (LANE == 0 && (wind_row[0] < 0 || wind_row[0] > 1)) atomic_or(&tangled[layer], WOUND);
        return;
    }

    V acc[OWNED];
    VI w[OWNED];
    ROWS(r) {
        acc[OWN(r)] = (V)(band * band);
        w[OWN(r)] = (VI)(wind_row[r * tiles_x]);
    }
    for (int v = ty - reach; v <= ty + reach; v++) {
        int2 run = run_of(near_start, layer * tiles, tx - reach, tx + reach, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++) {
            float gap2 = box_gap2(near[i], x, y);
            if (gap2 >= band * band) continue;
            lower_to(acc, near[i], x, y, band);
            if (gap2 == 0.0f && near == all) wind_by(w, near[i], left, low);
        }
    }
    for (int v = ty - 1; v <= ty + 1 && near != all; v++) {
        int2 run = run_of(all_start, layer * tiles, tx - 1, tx + 1, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++) wind_by(w, all[i], left, low);
    }

    VI odd = (VI)0;
    ROWS(r) odd = max(odd, max(w[OWN(r)] - 1, -w[OWN(r)]));
    if (row_max(odd) > 0) atomic_or(&tangled[layer], WOUND);
    int slot = take_slot(slots, shared);
    __global short *out = pool + slot * PIXELS;
    ROWS(r) {
        VI in = rule == NONZERO ? (VI)(w[OWN(r)] != 0) : rule == POSITIVE ? (VI)(w[OWN(r)] > 0) : (VI)((w[OWN(r)] & 1) != 0);
        V d = sqrt(acc[OWN(r)]);
        STORE(TO_I(select(d, -d, in) * scale), out, r);
    }
    if (LANE == 0) {
        map[key] = slot;
        owner[slot] = key;
    }
}
