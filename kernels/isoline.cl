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

/* ---- creases: where two regions of different slope meet, a straight line between two pixels says nothing ---- */

#define SMOOTH 0.25f /* second difference that a pixel on one side of a crease may have, pixels */
#define STRAY 0.7f  /* farthest that a crossing may lie from the line that it is moved to, pixels */
#define REACH 3.5f   /* farthest corner from the middle of its cell, pixels */

/* One-sided derivative from five pixels in a row, from the side that bends less; adds how much that bends. */
inline float slope(float a, float b, float c, float d, float e, float *bends)
{
    float before = a - 2.0f * b + c, middle = b - 2.0f * c + d, after = c - 2.0f * d + e;
    float least = fmin(fabs(middle), fmin(fabs(before), fabs(after)));
    *bends += least;
    if (least == fabs(middle)) return 0.5f * (d - b);
    return least == fabs(before) ? c - b + 0.5f * before : d - c - 0.5f * after;
}

/* (gradient, distance to the level) at a pixel; w = 0 where no side of it is smooth. */
inline float4 plane_at(__global const int *map, __global const short *pool, int base, int tiles_x, int x, int y, int level,
                       float quantum)
{
    float u[5], v[5], bends = 0.0f;
    for (int i = 0; i < 5; i++) {
        u[i] = pixel(map, pool, base, tiles_x, x + i - 2, y) * quantum;
        v[i] = pixel(map, pool, base, tiles_x, x, y + i - 2) * quantum;
    }
    float2 g = (float2)(slope(u[0], u[1], u[2], u[3], u[4], &bends), slope(v[0], v[1], v[2], v[3], v[4], &bends));
    float size = sqrt(dot(g, g));
    int good = bends < SMOOTH && fabs(size - 1.0f) < SMOOTH;
    return (float4)(g / fmax(size, 0.1f), u[2] + (0.5f - (float)level) * quantum, (float)good);
}

/* Whether a cell may hold a crease: its slope is not 1, or it is twisted. */
inline int creased(const int *low, const int *high, int i, float quantum)
{
    float a = low[i], b = low[i + 1], c = high[i + 1], d = high[i];
    float gx = 0.5f * (b - a + c - d) * quantum, gy = 0.5f * (d - a + c - b) * quantum, twist = (a + c - b - d) * quantum;
    return gx * gx + gy * gy < 0.97f || fabs(twist) > 0.06f;
}

/* Whether a place, relative to a cell, lies on the far side of one of its edges. */
inline int beyond(float2 c, int e, float margin)
{
    return (e == 0 ? -c.y : e == 1 ? c.x - 1.0f : e == 2 ? c.y - 1.0f : -c.x) > margin;
}

/* The corner of the contour in cell (x, y) between the crossings p (on edge `from`) and q (on edge `to`): where the lines of
 * two pixels meet that lie on different sides of a crease (after Kobbelt et al., Feature sensitive surface extraction, 2001).
 * p and q are moved onto their lines. Returns 0 where there is none, or where it lies more than `margin` in the cell that the
 * contour comes from or goes to. */
inline int corner_of(__global const int *map, __global const short *pool, int base, int tiles_x, int tiles_y, int x, int y,
                     int from, int to, int level, float quantum, float margin, float2 *p, float2 *q, float2 *corner)
{
    if (x < 2 || y < 2 || x + 3 >= tiles_x * TILE || y + 3 >= tiles_y * TILE) return 0;
    float4 plane[4];
    for (int i = 0; i < 4; i++)
        plane[i] = plane_at(map, pool, base, tiles_x, x + (i == 1 || i == 2), y + (i >> 1), level, quantum);
    int best = -1;
    float sharpest = 0.94f; /* cosine of 20 degrees */
    for (int k = 0; k < 4; k++) {
        int a = (from + (k & 1)) & 3, b = (to + (k >> 1)) & 3; /* edge e joins corners e and e + 1 */
        float cosine = dot(plane[a].xy, plane[b].xy);
        if (plane[a].w > 0.0f && plane[b].w > 0.0f && cosine < sharpest) {
            sharpest = cosine;
            best = a * 4 + b;
        }
    }
    if (best < 0) return 0;
    int a = best >> 2, b = best & 3;
    float2 at_a = (float2)(x + (a == 1 || a == 2), y + (a >> 1)), at_b = (float2)(x + (b == 1 || b == 2), y + (b >> 1));
    float2 m = plane[a].xy, n = plane[b].xy, origin = (float2)(x, y);
    float r = dot(m, at_a - origin) - plane[a].z, s = dot(n, at_b - origin) - plane[b].z, det = m.x * n.y - m.y * n.x;
    if (fabs(det) < 0.2f) return 0;
    float2 c = origin + (float2)(r * n.y - s * m.y, s * m.x - r * n.x) / det;
    float2 on_p = *p - m * (dot(m, *p - origin) - r), on_q = *q - n * (dot(n, *q - origin) - s);
    if (distance(c, origin + 0.5f) > REACH || distance(on_p, *p) > STRAY || distance(on_q, *q) > STRAY) return 0;
    if (distance(c, on_p) < 1e-3f || distance(c, on_q) < 1e-3f) return 0;
    if (beyond(c - origin, from, margin) || beyond(c - origin, to, margin)) return 0; /* the next cell's */
    float2 in = c - on_p, out = on_q - c; /* inside lies left: right of the way is up the slope */
    if (m.x * in.y - m.y * in.x < 0.0f || n.x * out.y - n.y * out.x < 0.0f) return 0;
    *p = on_p, *q = on_q, *corner = c;
    return 1;
}

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
                            int tiles_y, int level, float quantum, volatile __global int *cursor,
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
            corner_of(map, pool, key - tile, tiles_x, tiles_y, left + i, row, from, to, level, quantum, 0.3f, &p, &q, &corner);
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
    if (!corner_of(map, pool, base, tiles_x, tiles_y, x + i, y, from, to, level, quantum, 0.0f, &on_p, &on_q, &c)) return 0.0f;
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
