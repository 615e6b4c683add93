/* The union of the slices above, its growth by the buffer, and the scaffold: grown union minus part. */

inline int tallest(VI *d)
{
    int most = -FAR;
    ROWS(r) most = max(most, row_max(d[OWN(r)]));
    return most;
}

inline int deepest(VI *d)
{
    int most = -FAR;
    ROWS(r) most = max(most, row_max(-d[OWN(r)]));
    return most;
}

/* As run_of, of pieces in the tiles of a window, `corner` its first, and nowhere else. */
inline int2 run_within(__global const int *start, int layer, int tx0, int tx1, int ty, int2 corner, int2 window)
{
    tx0 -= corner.x, tx1 -= corner.x;
    if (tx1 < 0 || tx0 >= window.x) return (int2)(0, 0);
    return run_of(start, layer * window.x * window.y, tx0, tx1, ty - corner.y, window.x, window.y);
}

/* One tile of the running union goes down through all layers of the batch. `level` is the buffer, in quanta (1 / scale).
 *
 * shape[tile * 256 + ..] keeps min(distance, bound) of the union; state[tile]: 0 untouched, 1 has pixels, 2 wholly
 * inside the grown union, for good. Before (or, with own, after) a layer is added, tiles that the level may cross are
 * copied; a tile that is as it was above takes the slot of the layer above.
 */
__kernel void grow_union(int items, __global const float4 *near, __global const int *start, int2 corner, int2 window,
                         __global const int *part_map, __global const short *part_pool, int layers, int tiles_x, int tiles_y, int reach, int own,
                         float bound, float scale, int level, int slack, int shift, __global short *shape,
                         __global int *state, __global int *map, __global short *pool, __global int *owner,
                         volatile __global int *slots)
{
    int tile = spread_item();
    if (tile >= items) return;
    __local int shared[1];
    int tiles = tiles_x * tiles_y, ty = tile / tiles_x, tx = tile - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE);
    __global short *mine = shape + tile * PIXELS;
    int now = state[tile], limit = convert_int_rtn(bound * scale), shown = OUTSIDE;
    VI d[OWNED];
    ROWS(r) d[OWN(r)] = now == 1 ? LOAD(mine, r) : (VI)limit;
    int low = limit, high = limit;
    if (now == 1) {
        high = all_max(tallest(d), shared);
        low = -all_max(deepest(d), shared);
    }

    for (int step = 0; step < 2 * layers; step++) {
        int layer = step >> 1, key = layer * tiles + tile;
        if ((step & 1) == own) { /* show this layer's union */
            int at = now == 2 ? INSIDE : OUTSIDE;
            if (now == 1 && low < level + slack) {
                at = shown;
                if (at < 0) {
                    at = take_slot(slots, shared);
                    ROWS(r) STORE(d[OWN(r)], pool + at * PIXELS, r);
                    if (LANE == 0) owner[at] = key;
                }
            }
            shown = at;
            if (LANE == 0) map[key] = at;
            continue;
        }
        if (now == 2) continue;
        int part = part_map[key], close = 0;
        if (part == INSIDE) {
            now = 2;
            continue;
        }
        VI moved = (VI)0;
        if (part >= 0)
            ROWS(r) {
                VI p = LOAD(part_pool + part * PIXELS, r), u = d[OWN(r)];
                d[OWN(r)] = select(u, min(u, p >> shift), (VI)(p < 0));
                moved |= u ^ d[OWN(r)];
            }
        float far = now == 0 ? bound : ((float)high + 1.0f) / scale; /* nothing beyond it can lower a pixel */
        V acc[OWNED];
        for (int v = ty - reach; v <= ty + reach; v++) {
            int2 run = run_within(start, layer, tx - reach, tx + reach, v, corner, window);
            for (int i = run.x; i < run.y; i++) {
                if (box_gap2(near[i], x, y) >= far * far) continue;
                if (!close) ROWS(r) acc[OWN(r)] = (V)(bound * bound);
                close = 1;
                lower_to(acc, near[i], x, y, far);
            }
        }
        if (close)
            ROWS(r) {
                VI u = d[OWN(r)];
                d[OWN(r)] = min(u, TO_I(sqrt(acc[OWN(r)]) * scale));
                moved |= u ^ d[OWN(r)];
            }
        if (now == 0 && (close || part >= 0)) now = 1;
        if (!all_max(row_max(select((VI)0, (VI)1, (VI)(moved != 0))), shared)) continue;
        shown = OUTSIDE;
        high = all_max(tallest(d), shared);
        low = -all_max(deepest(d), shared);
        if (high < level - slack) now = 2;
    }
    if (now == 1) ROWS(r) STORE(d[OWN(r)], mine, r);
    if (LANE == 0) state[tile] = now;
}

/* Whether a piece of the grown union's contour, which cells of the tiles around this one made, comes nearer than `far`. */
inline int any_near(__global const float4 *grown, __global const int *start, __global const int *end, __global const int *source, int base,
                    int tx, int ty, int reach, int tiles_x, int tiles_y, float far)
{
    int close = 0;
    float x = (float)(tx * TILE), y = (float)(ty * TILE);
    for (int v = max(ty - reach, 0); v <= min(ty + reach, tiles_y - 1); v++)
        for (int u = max(tx - reach, 0); u <= min(tx + reach, tiles_x - 1); u++) {
            int key = source[base + v * tiles_x + u];
            for (int i = start[key] + LANE; i < end[key] && !close; i += LANES)
                close = box_gap2(grown[i], x, y) < far * far;
        }
    return close;
}

/* One tile of the scaffold's own sdf goes down through all layers of the batch: max(distance to the grown union, -part),
 * to `band` inside and `outer` outside. grown: pieces of the union's contour at the buffer; those of a key are
 * start[source[key]] .. end[source[key]]. fresh[key]: the union near the tile differs from that of the layer above.
 * Layers are stored as images layers .. 2 * layers - 1 of the same map and pool as the part; a tile that is as it was above, takes
 * the slot of the layer above.
 */
__kernel void scaffold_distance(int items, __global const float4 *grown, __global const int *start, __global const int *end,
                                __global const int *source, __global const uchar *fresh, __global const int *union_map,
                                __global const short *union_pool, int level, int layers, int tiles_x, int tiles_y,
                                float band, float outer, int reach, float scale, __global int *map,
                                __global short *pool, __global int *owner, volatile __global int *slots)
{
    int tile = spread_item();
    if (tile >= items) return;
    __local int shared[1];
    int tiles = tiles_x * tiles_y, ty = tile / tiles_x, tx = tile - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE);
    VI d[OWNED];
    int known = 0, close = 0, in = 0, shown = OUTSIDE; /* known: close, in and d are those of this layer */
    for (int layer = 0; layer < layers; layer++) {
        int key = layer * tiles + tile, here = layers * tiles + key, part = map[key], above = union_map[key];
        if (fresh[key]) known = 0, shown = OUTSIDE;
        if (part == INSIDE) {
            if (LANE == 0) map[here] = OUTSIDE;
            continue;
        }
        if (!known) {
            known = 1;
            close = all_max(any_near(grown, start, end, source, layer * tiles, tx, ty, reach, tiles_x, tiles_y,
                                     above == OUTSIDE ? outer : band), shared);
            in = above == INSIDE || (above >= 0 && union_pool[above * PIXELS] < level);
            V acc[OWNED];
            ROWS(r) acc[OWN(r)] = (V)(band * band);
            for (int v = max(ty - reach, 0); close && v <= min(ty + reach, tiles_y - 1); v++)
                for (int u = max(tx - reach, 0); u <= min(tx + reach, tiles_x - 1); u++) {
                    int from = source[layer * tiles + v * tiles_x + u];
                    for (int i = start[from]; i < end[from]; i++)
                        if (box_gap2(grown[i], x, y) < band * band) lower_to(acc, grown[i], x, y, band);
                }
            ROWS(r) {
                V e = sqrt(acc[OWN(r)]);
                VI u = above >= 0 ? LOAD(union_pool + above * PIXELS, r) : above == INSIDE ? (VI)(-FAR) : (VI)FAR;
                d[OWN(r)] = TO_I(select(e, -e, (VI)(u < level)) * scale);
            }
        }
        if (!close && (!in || part == OUTSIDE)) {
            if (LANE == 0) map[here] = in ? INSIDE : OUTSIDE;
            continue;
        }
        int slot = part == OUTSIDE ? shown : OUTSIDE;
        if (slot < 0) {
            slot = take_slot(slots, shared);
            ROWS(r) STORE(part >= 0 ? max(d[OWN(r)], -1 - LOAD(pool + part * PIXELS, r)) : d[OWN(r)], pool + slot * PIXELS, r);
            if (LANE == 0) owner[slot] = here;
            if (part == OUTSIDE) shown = slot;
        }
        if (LANE == 0) map[here] = slot;
    }
}
