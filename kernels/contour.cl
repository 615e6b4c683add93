/* Level sets -> closed, decimated loops. Composed after cells.cl, whose cases and edges it follows, crease.cl and sleeve.cl. */

/* Mark the places where a contour crosses a row of pixels upwards (inside left, outside right): every loop has one.
 * seeds[n * 16 + r] bit i, of stored tile n, counted from `first`: stored[n] is its key, number[key] is n. crossings[image] bounds the points of the undecimated contours, corners included; starts[image] counts the
 * seeds. levels: part, scaffold. A group adds up what its tiles of an image have: processors would wait for each other's sums. */
__kernel void find_seeds(int items, __global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                         int tiles_y, int first, int layers, int2 levels, __global ushort *seeds, __global int *stored,
                         __global int *number, volatile __global int *crossings, volatile __global int *starts)
{
    __local int images[SHARERS], edges[SHARERS], ups[SHARERS];
    int image = -1, n = 0, loops = 0, own = (int)get_local_id(0);
    if (ITEM < items) {
        Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
        image = t.key / (tiles_x * tiles_y);
        int level = image < layers ? levels.x : levels.y;
        uint a, b = first_bits(pool, &t, level);
        ROWS_OF_TILE(r) {
            NEXT_BITS(a, b, pool, &t, r, level);
            uint up = a & ~(a >> 1) & 0xffffu;
            n += popcount((a ^ (a >> 1)) & 0xffffu) + popcount((a ^ b) & 0xffffu);
            loops += popcount(up);
            seeds[(first + ITEM) * TILE + r] = (ushort)up;
        }
        if (LANE == 0) stored[first + ITEM] = t.key, number[t.key] = first + ITEM;
    }
    images[own] = image, edges[own] = n, ups[own] = loops;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (own) return;
    n = loops = 0;
    for (int i = 0; i < (int)get_local_size(0); i++) {
        n += edges[i], loops += ups[i];
        if (i + 1 < (int)get_local_size(0) && images[i + 1] == images[i]) continue;
        if (n) atomic_add(&crossings[images[i]], 2 * n);
        if (loops) atomic_add(&starts[images[i]], loops);
        n = loops = 0;
    }
}

/* Follow one contour from the cell above seed (x, y) and write what is left of it; returns the number of points.
 * The first point that is kept for its own sake becomes the start, so that a loop does not begin amid a straight side. */
inline int follow(__global const int *map, __global const short *pool, int base, int tiles_x, int level, int x, int y,
                  int tiles_y, float quantum, __global ushort *seeds, __global const int *number, float tolerance, float spacing,
                  __global float2 *out)
{
    int sx = x, sy = y, e = 0, low[2], high[2], steps = 0, all = 0, begun = 0;
    Sleeve s;
    s.tolerance = tolerance, s.spacing = spacing, s.count = 0;
    low[0] = pixel(map, pool, base, tiles_x, x, y);
    low[1] = pixel(map, pool, base, tiles_x, x + 1, y);
    float2 first = edge_point(low, low, 0, level, (float)x, (float)y);
    keep(&s, first, out);
    s.last = first;
    float2 made = (float2)(-BIG, 0.0f);
    high[0] = pixel(map, pool, base, tiles_x, x, y + 1);
    high[1] = pixel(map, pool, base, tiles_x, x + 1, y + 1);
    do {
        if (e == 0) {
            seeds[number[base + (y >> 4) * tiles_x + (x >> 4)] * 16 + (y & 15)] &= (ushort)~(1u << (x & 15));
        }
        int c = case_of(low, high, level), to = leave_edge[c];
        if (c == 5) to = centre_inside(low, high, level) ? e + 1 : 3 - e; /* 0 -> 1, 2 -> 3 or 0 -> 3, 2 -> 1 */
        if (c == 10) to = centre_inside(low, high, level) ? (e == 3 ? 0 : 2) : (e == 1 ? 0 : 2);
        float2 p = edge_point(low, high, to, level, (float)x, (float)y);
        if (quantum > 0.0f && c != 5 && c != 10 && creased(low, high, quantum)) {
            float2 last = s.last, corner;
            if (corner_of(map, pool, base, tiles_x, tiles_y, x, y, e, to, level, quantum, SHARP, 0.3f, &last, &p, &corner)
                && distance(corner, made) > 0.35f) { /* two cells may see one corner */
                if (distance(s.last, s.anchor) > 0.0f) s.last = last;
                feed_corner(&s, corner, out);
                made = corner;
            }
        }
        if (to & 1) { /* the next cell shares the two pixels of the edge: only the others are read */
            int side = to == 1, new_x = side ? x + 2 : x - 1;
            low[!side] = low[side], high[!side] = high[side];
            low[side] = pixel(map, pool, base, tiles_x, new_x, y);
            high[side] = pixel(map, pool, base, tiles_x, new_x, y + 1);
            x += side ? 1 : -1;
        } else {
            int *from = to == 2 ? high : low, *gone = to == 2 ? low : high, new_y = to == 2 ? y + 2 : y - 1;
            gone[0] = from[0], gone[1] = from[1];
            from[0] = pixel(map, pool, base, tiles_x, x, new_y);
            from[1] = pixel(map, pool, base, tiles_x, x + 1, new_y);
            y += to == 2 ? 1 : -1;
        }
        e = to ^ 2;
        steps++;
        if (x == sx && y == sy && e == 0 && !all) {
            all = steps;
            if (!begun) break; /* the seed stays the start */
        }
        if (all && steps >= all + begun) break;
        feed(&s, p, out);
        if (!begun && s.count > 1) { /* start again at the point just kept */
            begun = steps;
            out[0] = s.anchor;
            s.count = 1;
        }
    } while (1);
    if (!begun && distance(s.last, s.anchor) >= spacing && !fits(&s, first)) keep(&s, s.last, out);
    return close_loop(out, s.count, spacing);
}

/* All loops of one image, in the order of their seeds. Image i writes points from place[i] and loops from loop_place[i];
 * mode[loop] 0: as asked, 1: a finer tolerance, 2: every point (for loops that crossed something). quantum (part, scaffold):
 * pixels per quantum, or 0 to leave creases as marching squares cuts them. */
__kernel void follow_contours(__global const int *map, __global const short *pool, int tiles_x, int tiles_y, int layers,
                              int2 levels, __global ushort *seeds, __global const int *stored,
                              __global const int *begin, __global const int *number, __global const int *place,
                              __global const int *loop_place, __global const uchar *mode, float tolerance, float spacing,
                              float2 quantum, __global float2 *points, __global int *next, __global int *loop_of,
                              __global int *loop_end, __global int4 *totals, int images)
{
    int image = (int)get_global_id(0), base = image * tiles_x * tiles_y;
    int level = image < layers ? levels.x : levels.y;
    int n = place[image], loop = loop_place[image], dropped = 0;
    for (int own = begin[image]; own < begin[image + 1]; own++) {
        if (!any(vload16(own, seeds) != (ushort16)0)) continue;
        int tile = stored[own] - base;
        for (int r = 0; r < 16; r++) {
            while (seeds[own * 16 + r]) {
                int i = 31 - (int)clz((uint)(seeds[own * 16 + r] & -seeds[own * 16 + r]));
                int how = mode[loop];
                int kept = follow(map, pool, base, tiles_x, level, (tile % tiles_x) * TILE + i, (tile / tiles_x) * TILE + r,
                                  tiles_y, how ? 0.0f : image < layers ? quantum.x : quantum.y, seeds, number, how == 0 ? tolerance : how == 1 ? 0.125f * tolerance : 0.0f,
                                  how == 2 ? 0.0f : spacing, points + n);
                for (int k = n; k < n + kept; k++) {
                    next[k] = k + 1 < n + kept ? k + 1 : n;
                    loop_of[k] = loop;
                }
                n += kept;
                dropped += kept == 0;
                loop_end[loop++] = n;
            }
        }
    }
    totals[image] = (int4)(n - place[image], loop - loop_place[image], dropped, 0);
}
