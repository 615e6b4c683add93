/* The area that a level set encloses: of its cells, tile by tile, and of whole images. */

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

/* Area inside the level in the cells of a row of pixels: distances to the level at b0, b1, b2 and b3, none of them 0. */
inline V cell_areas(V p0, V p1, V p2, V p3, float bend)
{
    VI in0 = p0 < 0.0f, in1 = p1 < 0.0f, in2 = p2 < 0.0f, in3 = p3 < 0.0f;
    V e0 = p0 / (p0 - p1), e1 = p1 / (p1 - p2), e2 = p3 / (p3 - p2), e3 = p0 / (p0 - p3);
    V t0 = 0.5f * e0 * e3 + bend, t1 = 0.5f * (1.0f - e0) * e1 + bend; /* triangles at the corners */
    V t2 = 0.5f * (1.0f - e2) * (1.0f - e1) + bend, t3 = 0.5f * e2 * (1.0f - e3) + bend;
    VI odd0 = in0 ^ in1, odd1 = in1 ^ in2, odd2 = in2 ^ in3, odd3 = in3 ^ in0; /* which edges are crossed */
    /* Two edges that face each other, inside at b0; else one corner that differs from the others. */
    V part = select(0.5f * (e0 + e2), 0.5f * (e3 + e1), odd1);
    VI inside = in0;
    part = select(part, t0, odd0 & odd3), inside = select(inside, in0, odd0 & odd3);
    part = select(part, t1, odd0 & odd1), inside = select(inside, in1, odd0 & odd1);
    part = select(part, t2, odd1 & odd2), inside = select(inside, in2, odd1 & odd2);
    part = select(part, t3, odd2 & odd3), inside = select(inside, in3, odd2 & odd3);
    VI saddle = odd0 & odd1 & odd2 & odd3, joined = p0 + p1 + p2 + p3 < 0.0f; /* joined: its middle is inside */
    part = select(part, select(t1 + t3, t0 + t2, joined ^ in0), saddle), inside = select(inside, joined == 0, saddle);
    return select(1.0f - part, part, inside);
}

/* What the corners of the contour in cells add, in 1/65536 px^2; where bit k of `held` is set, cell k may hold one. cell[k], the only
 * one of a GPU's lane, is its column + 16 * row. */
inline int corner_areas(__global const int *map, __global const short *pool, Tile *t, int tiles_x, int tiles_y, const int *cell, uint held,
                        int level, float quantum, float bend)
{
    int low[2], high[2], sum = 0;
    for (; held; held &= held - 1) {
        int own = cell[LANES == 1 ? popcount((held & -held) - 1) : 0], i = own & 15, r = own >> 4;
        load_cell(pool, t, i, r, low, high);
        int c = case_of(low, high, level), from = enter_edge[c], to = leave_edge[c];
        if (c == 5 || c == 10) continue;
        sum += convert_int_rte(65536.0f * corner_area(map, pool, t->base, tiles_x, tiles_y, t->x + i, t->y + r, from, to, level, quantum,
                               bend, edge_point(low, high, from, level, 0.0f, 0.0f), edge_point(low, high, to, level, 0.0f, 0.0f)));
    }
    return sum;
}

/* Area inside the level in those of some cells that are `crossed`, in 1/65536 px^2; q: their pixels b0, b1, b2, b3. */
INLINE int crossed_areas(__global const int *map, __global const short *pool, Tile *t, int tiles_x, int tiles_y, VI *q, const int *cell,
                         VI crossed, int level, float quantum, float bend)
{
    V p0 = TO_F(q[0] - level) + 0.5f, p1 = TO_F(q[1] - level) + 0.5f, p2 = TO_F(q[2] - level) + 0.5f, p3 = TO_F(q[3] - level) + 0.5f;
    int sum = row_sum(select((VI)0, TO_NEAREST(cell_areas(p0, p1, p2, p3, bend) * 65536.0f), crossed));
    uint held = lane_bits(crossed & CREASED(p0, p1, p2, p3, quantum));
    return held ? sum + corner_areas(map, pool, t, tiles_x, tiles_y, cell, held, level, quantum, bend) : sum;
}

#ifndef WIDE
/* Cells of a tile side by side, with room for sixteen behind: their pixels b0, b1, b2, b3, and column + 16 * row. */
typedef struct {
    int q[4][PIXELS + 16], cell[PIXELS + 16], number;
} Cells;

/* Add those cells of row r whose bit is set. */
INLINE void gather_cells(__global const short *pool, Tile *t, int r, uint bits, Cells *cells)
{
#if defined(__AVX512F__) && defined(__clang__)
    typedef int ints __attribute__((__vector_size__(64)));
    VI q[5];
    load_row(pool, t, r, q);
    q[4] = XS + 16 * r;
#pragma unroll
    for (int k = 0; k < 5; k++) {
        ints side_by_side = __builtin_ia32_compresssi512_mask(*(ints *)&q[k], *(ints *)&q[k], (ushort)bits);
        vstore16(*(VI *)&side_by_side, 0, (k < 4 ? cells->q[k] : cells->cell) + cells->number);
    }
    cells->number += popcount(bits);
#else
    for (; bits; bits &= bits - 1) {
        int i = popcount((bits & -bits) - 1), n = cells->number++, low[2], high[2];
        load_cell(pool, t, i, r, low, high);
        cells->q[0][n] = low[0], cells->q[1][n] = low[1], cells->q[2][n] = high[1], cells->q[3][n] = high[0];
        cells->cell[n] = i + 16 * r;
    }
#endif
}
#endif

/* area[key]: area inside the level in each stored tile, in 1/65536 px^2. Each quarter turn of the contour is given `bend`
 * back: marching squares cut that much off a circle, whatever its radius (docs/accuracy.md). */
__kernel void isoline_area(int items, __global const int *map, __global const short *pool, __global const int *keys, int tiles_x,
                           int tiles_y, int level, float quantum, float bend, __global int *area)
{
    if (ITEM >= items) return;
    __local int shared[1];
    Tile t = tile_at(map, keys[ITEM], tiles_x, tiles_y);
    VI q[4];
    int sum = 0;
#ifdef WIDE
    ROWS(r) {
        int cell = XS + 16 * r;
        load_row(pool, &t, r, q);
        int inside = (q[0] < level) + (q[1] < level) + (q[2] < level) + (q[3] < level);
        if (inside == 4) sum += 65536;
        else if (inside) sum += crossed_areas(map, pool, &t, tiles_x, tiles_y, q, &cell, -1, level, quantum, bend);
    }
#else
    Cells cells;
    cells.number = 0;
    uint below, above = row_bits(pool, &t, 0, level);
    for (int r = 0; r < TILE; r++) {
        below = above, above = row_bits(pool, &t, r + 1, level);
        sum += (int)popcount(below & (below >> 1) & above & (above >> 1) & 0xffffu) << 16;
        uint crossed = crossed_cells(below, above);
        if (crossed) gather_cells(pool, &t, r, crossed, &cells);
    }
    for (int n = 0; n < cells.number; n += 16) {
        VI crossed = XS < cells.number - n;
        for (int k = 0; k < 4; k++) q[k] = select((VI)level, vload16(0, cells.q[k] + n), crossed);
        sum += crossed_areas(map, pool, &t, tiles_x, tiles_y, q, cells.cell + n, crossed, level, quantum, bend);
    }
#endif
    sum = all_sum(sum, shared);
    if (LANE == 0) area[t.key] = sum;
}

/* total[i]: area of image first + i in 1/65536 px^2: `inside` for each of its tiles that lie wholly inside, and for those with pixels
 * what `area` holds: for the tile itself, or where given for its tile `source`, counted from the first image. A group for each image. */
__kernel void sum_areas(int tiles, int first, __global const int *map, __global const int *source, __global const int *area,
                        int inside, __global long *total)
{
    __local long sums[LANES];
    int image = (int)get_group_id(0), at = image * tiles;
    __global const int *slots = map + first * tiles + at, *own = area + first * tiles;
    long sum = 0;
    for (int t = LANE; t < tiles; t += LANES)
        sum += slots[t] >= 0 ? own[source ? source[at + t] : at + t] : slots[t] == INSIDE ? inside : 0;
    sums[LANE] = sum;
    SYNC;
    if (LANE) return;
    for (int l = 1; l < LANES; l++) sum += sums[l];
    total[image] = sum;
}
