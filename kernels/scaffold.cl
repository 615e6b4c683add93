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

/* One tile of the running union goes down through all layers of the batch. `level` is the buffer, in quanta (1 / scale).
 *
 * shape[tile * 256 + ..] keeps min(distance, bound) of the union; state[tile]: 0 untouched, 1 has pixels, 2 wholly
 * inside the grown union, for good. Before (or, with own, after) a layer is added, tiles that the level may cross are copied.
 */
__kernel void grow_union(__global const float4 *near, __global const int *start, __global const int *part_map,
                         __global const short *part_pool, int layers, int tiles_x, int tiles_y, int reach, int own,
                         float bound, float scale, int level, int slack, int shift, __global short *shape,
                         __global int *state, __global int *map, __global short *pool, __global int *owner,
                         volatile __global int *slots)
{
    __local int shared[1];
    int tile = ITEM, tiles = tiles_x * tiles_y, ty = tile / tiles_x, tx = tile - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE);
    __global short *mine = shape + tile * PIXELS;
    int now = state[tile], limit = convert_int_rtn(bound * scale);
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
                at = take_slot(slots, shared);
                ROWS(r) STORE(d[OWN(r)], pool + at * PIXELS, r);
                if (LANE == 0) owner[at] = key;
            }
            if (LANE == 0) map[key] = at;
            continue;
        }
        if (now == 2) continue;
        int part = part_map[key], changed = 0;
        if (part == INSIDE) {
            now = 2;
            continue;
        }
        if (part >= 0) {
            ROWS(r) {
                VI p = LOAD(part_pool + part * PIXELS, r);
                d[OWN(r)] = select(d[OWN(r)], min(d[OWN(r)], p >> shift), (VI)(p < 0));
            }
            changed = 1;
        }
        float far = now == 0 ? bound : ((float)high + 1.0f) / scale; /* nothing beyond it can lower a pixel */
        V acc[OWNED];
        for (int v = ty - reach; v <= ty + reach; v++) {
            int2 run = run_of(start, layer * tiles, tx - reach, tx + reach, v, tiles_x, tiles_y);
            for (int i = run.x; i < run.y; i++) {
                if (box_gap2(near[i], x, y) >= far * far) continue;
                if (changed < 2) ROWS(r) acc[OWN(r)] = (V)(bound * bound);
                changed = 2;
                lower_to(acc, near[i], x, y, far);
            }
        }
        if (changed == 2) ROWS(r) d[OWN(r)] = min(d[OWN(r)], TO_I(sqrt(acc[OWN(r)]) * scale));
        if (changed) {
            now = 1;
            high = all_max(tallest(d), shared);
            low = -all_max(deepest(d), shared);
            if (high < level - slack) now = 2;
        }
    }
    if (now == 1) ROWS(r) STORE(d[OWN(r)], mine, r);
    if (LANE == 0) state[tile] = now;
}

/* The scaffold's own sdf: max(distance to the grown union, -part), to `band` inside and `outer` outside. grown: pieces of the
 * union's contour at the buffer.
 * Layers are stored as images layers .. 2 * layers - 1 of the same map and pool as the part. */
__kernel void scaffold_distance(__global const float4 *grown, __global const int *start, __global const int *union_map,
                                __global const short *union_pool, int level, int layers, int tiles_x, int tiles_y,
                                float band, float outer, int reach, float scale, __global int *map,
                                __global short *pool, __global int *owner, volatile __global int *slots)
{
    __local int shared[1];
    int tile = ITEM, tiles = tiles_x * tiles_y, here = layers * tiles + tile;
    int layer = tile / tiles, ty = (tile - layer * tiles) / tiles_x, tx = tile - layer * tiles - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE);
    int part = map[tile], above = union_map[tile];
    if (part == INSIDE) {
        if (LANE == 0) map[here] = OUTSIDE;
        return;
    }
    int close = 0;
    float far = above == OUTSIDE ? outer : band;
    for (int v = ty - reach; v <= ty + reach; v++) {
        int2 run = run_of(start, layer * tiles, tx - reach, tx + reach, v, tiles_x, tiles_y);
        for (int i = run.x + LANE; i < run.y && !close; i += LANES) close = box_gap2(grown[i], x, y) < far * far;
    }
    close = all_max(close, shared);
    int in = above == INSIDE || (above >= 0 && union_pool[above * PIXELS] < level);
    if (!close && (!in || part == OUTSIDE)) {
        if (LANE == 0) map[here] = in ? INSIDE : OUTSIDE;
        return;
    }

    V acc[OWNED];
    ROWS(r) acc[OWN(r)] = (V)(band * band);
    for (int v = ty - reach; close && v <= ty + reach; v++) {
        int2 run = run_of(start, layer * tiles, tx - reach, tx + reach, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++)
            if (box_gap2(grown[i], x, y) < band * band) lower_to(acc, grown[i], x, y, band);
    }
    int slot = take_slot(slots, shared);
    ROWS(r) {
        V d = sqrt(acc[OWN(r)]);
        VI u = above >= 0 ? LOAD(union_pool + above * PIXELS, r) : above == INSIDE ? (VI)(-FAR) : (VI)FAR;
        VI s = TO_I(select(d, -d, (VI)(u < level)) * scale);
        if (part >= 0) s = max(s, -1 - LOAD(pool + part * PIXELS, r));
        STORE(s, pool + slot * PIXELS, r);
    }
    if (LANE == 0) {
        map[here] = slot;
        owner[slot] = here;
    }
}
