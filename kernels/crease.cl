/* Corners of a level set: where two regions of different slope meet, a straight line between two pixels says nothing. */

#define SHARP 0.82f  /* cosine of 35 degrees: an arc of a few pixels turns by less in a cell, and is no corner */
#define SMOOTH 0.25f /* second difference that a pixel on one side of a crease may have, pixels */
#define STRAY 0.7f  /* farthest that a crossing may lie from the line that it is moved to, pixels */
#define REACH 3.5f   /* farthest corner from the middle of its cell, pixels */

/* One-sided derivatives from five pixels in a row, from the side that bends less; and how much that bends. */
inline float8 slopes(float8 a, float8 b, float8 c, float8 d, float8 e, float8 *bends)
{
    float8 before = a - 2.0f * b + c, middle = b - 2.0f * c + d, after = c - 2.0f * d + e;
    *bends = LESSER(fabs(middle), LESSER(fabs(before), fabs(after)));
    float8 beside = select(d - c - 0.5f * after, c - b + 0.5f * before, *bends == fabs(before));
    return select(beside, 0.5f * (d - b), *bends == fabs(middle));
}

/* Pixels `column` to `column + 5` of a row of a tile, which may go on in the next; two more follow that mean nothing. `at` is the row's
 * place in its tiles. */
inline short8 six_of_row(__global const short *pool, int slot, int next, int at, int column)
{
    short8 far = (short8)(short)FAR, left = slot == INSIDE ? -far : far, right = next == INSIDE ? -far : far;
    if (slot >= 0) left = vload8(0, pool + slot * PIXELS + at + column);
    if (column <= 10) return left;
    if (next >= 0) {
        if (next * PIXELS + at >= TILE) right = vload8(0, pool + next * PIXELS + at + column - TILE);
        else
            for (int i = TILE - column; i < 6; i++) right[i] = pool[column + i - TILE]; /* nothing lies before it */
    }
    return select(left, right, (short8)(0, 1, 2, 3, 4, 5, 6, 7) + (short)column >= (short8)(short)TILE);
}

/* Planes through the distances at the pixels b0, b1, b2, b3 of a cell: gradient (x, y), distance to the level; good where a side of
 * the pixel is smooth. */
typedef struct {
    float4 x, y, z;
    int4 good;
} Planes;

/* One of the five pixels in the row of each pixel of the cell, and in its column: sides i and j of rows 2 and 3, and rows j and k. */
#define FIVES(p, i, j, low, high) convert_float8((short8)((p)[2].i, (p)[2].j, (p)[3].j, (p)[3].i, (p)[low].s23, (p)[high].s32))

/* The planes of cell (x, y) of an image. around[j].i is pixel (x + i - 2, y + j - 2), i and j from 0 to 5. */
inline Planes planes_at(__global const int *map, __global const short *pool, int base, int tiles_x, int x, int y, int level, float quantum)
{
    short8 around[6];
    int left = x - 2, column = left & 15;
#pragma unroll
    for (int j = 0; j < 6; j++) {
        int row = y - 2 + j, key = base + (row >> 4) * tiles_x + (left >> 4);
        around[j] = six_of_row(pool, map[key], column > 10 ? map[key + 1] : OUTSIDE, (row & 15) * TILE, column);
    }
    Planes planes;
    float8 bends, middle = FIVES(around, s2, s3, 2, 3) * quantum;
    float8 g = slopes(FIVES(around, s0, s1, 0, 1) * quantum, FIVES(around, s1, s2, 1, 2) * quantum, middle,
                      FIVES(around, s3, s4, 3, 4) * quantum, FIVES(around, s4, s5, 4, 5) * quantum, &bends);
    float4 size = sqrt(g.lo * g.lo + g.hi * g.hi), divisor = GREATER(size, 0.1f);
    planes.good = (bends.lo + bends.hi < SMOOTH) & (fabs(size - 1.0f) < SMOOTH);
    planes.x = g.lo / divisor, planes.y = g.hi / divisor;
    planes.z = middle.lo + (0.5f - (float)level) * quantum;
    return planes;
}

/* Whether any two good planes turn by more than the angle of a cosine. */
inline int any_turn(Planes *p, float cosine)
{
    float4 beside = p->x * p->x.yzwx + p->y * p->y.yzwx, across = p->x * p->x.zwxy + p->y * p->y.zwxy;
    return any((p->good & p->good.yzwx & (beside < cosine)) | (p->good & p->good.zwxy & (across < cosine)));
}

/* Whether a cell with a, b, c, d at b0, b1, b2, b3, floats or vectors of them, may hold a crease: its slope is not 1, or it is twisted. */
#define SLOPE_X(a, b, c, d, quantum) (0.5f * ((b) - (a) + (c) - (d)) * (quantum))
#define SLOPE_Y(a, b, c, d, quantum) (0.5f * ((d) - (a) + (c) - (b)) * (quantum))
#define SQUARED(v) ((v) * (v))
#define CREASED(a, b, c, d, quantum) \
    ((SQUARED(SLOPE_X(a, b, c, d, quantum)) + SQUARED(SLOPE_Y(a, b, c, d, quantum)) < 0.97f) \
     | (fabs(((a) + (c) - (b) - (d)) * (quantum)) > 0.06f))

inline int creased(const int *low, const int *high, float quantum)
{
    return CREASED((float)low[0], (float)low[1], (float)high[1], (float)high[0], quantum);
}

/* Whether a place, relative to a cell, lies on the far side of one of its edges. */
inline int beyond(float2 c, int e, float margin)
{
    return (e == 0 ? -c.y : e == 1 ? c.x - 1.0f : e == 2 ? c.y - 1.0f : -c.x) > margin;
}

/* The corner of the contour in cell (x, y) between the crossings p (on edge `from`) and q (on edge `to`): where the lines of
 * two pixels meet that lie on different sides of a crease (after Kobbelt et al., Feature sensitive surface extraction, 2001).
 * It must turn by more than the angle of cosine_least. p and q are moved onto their lines. Returns 0 where there is none, or where it lies more than `margin` in the cell that the
 * contour comes from or goes to. */
inline int corner_of(__global const int *map, __global const short *pool, int base, int tiles_x, int tiles_y, int x, int y,
                     int from, int to, int level, float quantum, float cosine_least, float margin, float2 *p, float2 *q, float2 *corner)
{
    if (x < 2 || y < 2 || x + 3 >= tiles_x * TILE || y + 3 >= tiles_y * TILE) return 0;
    Planes planes = planes_at(map, pool, base, tiles_x, x, y, level, quantum);
    if (!any_turn(&planes, cosine_least)) return 0;
    float4 plane[4];
    for (int i = 0; i < 4; i++) plane[i] = (float4)(planes.x[i], planes.y[i], planes.z[i], planes.good[i] ? 1.0f : 0.0f);
    int best = -1;
    float sharpest = cosine_least;
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
