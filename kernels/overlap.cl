/* Which pieces, or parts of pieces, are boundary of the union of overlapping shells.
 *
 * A piece is split where others cross or touch it; a part is boundary when the rule differs between its two sides.
 * The winding number is asked for a hair (SIDE) left and right of the middle of the part: it is known at the first pixel of each
 * tile row, and changes by the pieces that a path from there along the row, then across the rows, meets. Parts shorter than
 * LEAST are left out: what they miss is far below a quantum.
 * A work-item takes pieces of one tile; all pieces that matter to them lie in the 3 x 3 tiles around it.
 */
#define SIDE 0.004f
#define LEAST 0.016f
#define TOUCH 0.001f
#define CUT 1
#define SHORT 4

/* Where piece q splits piece p: the smallest parameter above `after`, or 1. */
inline float split_by(float4 p, float4 q, float after)
{
    float2 d = p.zw - p.xy, e = q.zw - q.xy, o = q.xy - p.xy;
    float length2 = dot(d, d), length = sqrt(length2), end = 1.0f - 0.25f * LEAST / length;
    float best = 1.0f, across = d.x * e.y - d.y * e.x;
    float2 t = (float2)(dot(o, d), dot(o + e, d)) / length2;
    float2 off = (float2)(o.y * d.x - o.x * d.y, (o.y + e.y) * d.x - (o.x + e.x) * d.y) / length;
    if (fabs(off.x) <= TOUCH && t.x > after && t.x < end) best = t.x;
    if (fabs(off.y) <= TOUCH && t.y > after && t.y < LESSER(best, end)) best = t.y;
    if (off.x * off.y < 0.0f && across != 0.0f) {
        float at = (o.x * e.y - o.y * e.x) / across;
        if (at > after && at < LESSER(best, end)) best = at;
    }
    return best;
}

/* What piece q adds to the winding number on the way from (0, row) along the row to x, then to y. */
inline int met(float4 q, float x, float y, float row)
{
    int w = 0;
    if (LESSER(q.y, q.w) <= row && row < GREATER(q.y, q.w)) {
        float at = clamp(q.x + (row - q.y) * ((q.z - q.x) / (q.w - q.y)), LESSER(q.x, q.z), GREATER(q.x, q.z));
        w += ((at <= x) - (at <= 0.0f)) * turn_of(q);
    }
    if (LESSER(q.x, q.z) <= x && x < GREATER(q.x, q.z)) {
        float at = clamp(q.y + (x - q.x) * ((q.w - q.y) / (q.z - q.x)), LESSER(q.y, q.w), GREATER(q.y, q.w));
        w += ((at <= y) - (at <= row)) * (q.z > q.x ? 1 : -1);
    }
    return w;
}

typedef struct {
    float end;       /* parameter of the next split, or 1 */
    int left, right; /* winding numbers beside the middle of (from, to) */
} Sides;

/* Look at part (from, to) of piece `self`; coordinates are taken relative to the tile, where floats are finest. */
inline Sides look(__global const float4 *pieces, __global const int *start, __global const int *wind, int base, int tx,
                  int ty, int tiles_x, int tiles_y, int self, float from, float to)
{
    float4 shift = (float4)(tx * TILE, ty * TILE, tx * TILE, ty * TILE), p = pieces[self] - shift;
    float2 d = p.zw - p.xy, middle = p.xy + d * (0.5f * (from + to));
    float2 side = (float2)(-d.y, d.x) * (SIDE / sqrt(dot(d, d))), l = middle + side, r = middle - side;
    float row = clamp(floor(middle.y + 0.5f), (float)(-ty * TILE), (float)((tiles_y - ty) * TILE - 1));
    float4 box = (float4)(LESSER(p.xy, p.zw) - TOUCH, GREATER(p.xy, p.zw) + TOUCH);
    float2 low = (float2)(LESSER(-1.0f, middle.x - 1.0f), LESSER(middle.y, row) - 1.0f);
    float2 high = (float2)(GREATER(0.0f, middle.x) + 1.0f, GREATER(middle.y, row) + 1.0f);
    float after = from + 0.25f * LEAST / sqrt(dot(d, d));
    int known = wind[(base / tiles_x * TILE + ty * TILE + (int)row) * tiles_x + tx];
    Sides s = {1.0f, known, known};
    int right = GREATER(high.x, box.z) + 4.0f >= 16.0f, down = LESSER(low.y, box.y) - 4.0f < 0.0f;
    int up = GREATER(high.y, box.w) + 4.0f >= 16.0f; /* a piece reaches at most 4 pixels out of its tile */
    for (int v = ty - down; v <= ty + up; v++) {
        int2 run = run_of(start, base, tx - 1, tx + right, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++) {
            float4 q = pieces[i] - shift;
            float2 least = LESSER(q.xy, q.zw), most = GREATER(q.xy, q.zw);
            if (i != self && least.x <= box.z && most.x >= box.x && least.y <= box.w && most.y >= box.y)
                s.end = LESSER(s.end, split_by(p, q, after));
            if (least.x <= high.x && most.x >= low.x && least.y <= high.y && most.y >= low.y) {
                s.left += met(q, l.x, l.y, row);
                s.right += met(q, r.x, r.y, row);
            }
        }
    }
    return s;
}

/* Whether pieces p and q touch elsewhere than in an end that they share, or are the same piece. */
inline int touch(float4 p, float4 q)
{
    if (all(p.xy == q.xy) ? all(p.zw == q.zw) : all(p.xy == q.zw) && all(p.zw == q.xy)) return 1;
    float2 d = p.zw - p.xy, e = q.zw - q.xy;
    if ((all(p.zw == q.xy) || all(q.zw == p.xy)) && dot(d, e) >= 0.0f) return 0; /* one goes on where the other ends */
    float a = 0.25f * LEAST / GREATER(sqrt(dot(d, d)), LEAST), b = 0.25f * LEAST / GREATER(sqrt(dot(e, e)), LEAST);
    return (dot(d, d) > 0.0f && split_by(p, q, a) < 1.0f) || (dot(e, e) > 0.0f && split_by(q, p, b) < 1.0f);
}

inline int boxes_meet(float4 p, float4 q)
{
    return LESSER(p.x, p.z) <= GREATER(q.x, q.z) + TOUCH && LESSER(q.x, q.z) <= GREATER(p.x, p.z) + TOUCH
        && LESSER(p.y, p.w) <= GREATER(q.y, q.w) + TOUCH && LESSER(q.y, q.w) <= GREATER(p.y, p.w) + TOUCH;
}

/* Whether p touches any of the pieces from `i` to `end`. */
inline int touch_any(float4 p, __global const float4 *pieces, int i, int end)
{
    int hit = 0;
    for (; i < end; i++)
        if (boxes_meet(p, pieces[i])) hit |= touch(p, pieces[i]);
    return hit;
}

#ifndef WIDE
#define LISTED 128

/* Pieces that may meet those of a tile: their boxes, in rows of sixteen, and their places. */
typedef struct {
    float16 left[LISTED / 16], right[LISTED / 16], low[LISTED / 16], high[LISTED / 16];
    int at[LISTED], count;
} Nearby;
#define NUMBER(rows, n) (((__private float *)(rows))[n])

/* List the pieces from `i` to `end` of which the boxes meet `around` (left, low, right, high); 0 when there are too many. */
inline int list_pieces(Nearby *list, __global const float4 *pieces, int i, int end, float4 around)
{
    if (list->count + end - i > LISTED) return 0;
    int n = list->count;
    for (; i < end; i++) { /* written first, kept if it is near: no branch to guess wrong */
        float4 q = pieces[i];
        float left = LESSER(q.x, q.z), right = GREATER(q.x, q.z), low = LESSER(q.y, q.w), high = GREATER(q.y, q.w);
        NUMBER(list->left, n) = left, NUMBER(list->right, n) = right, NUMBER(list->low, n) = low, NUMBER(list->high, n) = high;
        list->at[n] = i;
        n += (left <= around.z) & (right >= around.x) & (low <= around.w) & (high >= around.y);
    }
    list->count = n;
    return 1;
}

/* Whether any of the first `own` pieces of a list touches one after it. */
inline int touch_listed(Nearby *list, int own, __global const float4 *pieces)
{
    int hit = 0;
    for (int k = list->count; k & 15; k++) NUMBER(list->left, k) = BIG; /* lanes without a piece meet none */
    for (int k = 0; k < own; k++) {
        float left = NUMBER(list->left, k) - TOUCH, right = NUMBER(list->right, k) + TOUCH;
        float low = NUMBER(list->low, k) - TOUCH, high = NUMBER(list->high, k) + TOUCH;
        for (int v = (k + 1) >> 4; v << 4 < list->count; v++) {
            uint meet = lane_bits((list->left[v] <= right) & (list->right[v] >= left) & (list->low[v] <= high) & (list->high[v] >= low));
            if (v << 4 <= k) meet &= 0xfffeu << (k & 15);
            for (; meet; meet &= meet - 1)
                hit |= touch(pieces[list->at[k]], pieces[list->at[(v << 4) + (int)popcount((meet & -meet) - 1)]]);
        }
    }
    return hit;
}
#endif

/* tangled[layer] = 1 where any two pieces cross or touch. Each pair is looked at once: within a tile, and with the tiles to the right
 * and above. */
__kernel void find_contacts(int items, __global const float4 *pieces, __global const int *start, int tiles_x, int tiles_y,
                            __global int *tangled)
{
    if (ITEM >= items) return;
    int tile = ITEM, tiles = tiles_x * tiles_y, layer = tile / tiles, base = layer * tiles;
    int first = start[tile], end = start[tile + 1], ty = (tile - base) / tiles_x, tx = tile - base - ty * tiles_x;
    if (first == end) return;
#ifndef WIDE
    Nearby list;
    list.count = 0;
    if (list_pieces(&list, pieces, first, end, (float4)(-BIG, -BIG, BIG, BIG))) {
        float4 around = (float4)(BIG, BIG, -BIG, -BIG);
        for (int k = 0; k < list.count; k++) {
            around.xy = LESSER(around.xy, (float2)(NUMBER(list.left, k), NUMBER(list.low, k)));
            around.zw = GREATER(around.zw, (float2)(NUMBER(list.right, k), NUMBER(list.high, k)));
        }
        around += (float4)(-TOUCH, -TOUCH, TOUCH, TOUCH);
        int2 above = run_of(start, base, tx - 1, tx + 1, ty + 1, tiles_x, tiles_y);
        if (list_pieces(&list, pieces, end, start[tile + 1 + (tx + 1 < tiles_x)], around)
            && list_pieces(&list, pieces, above.x, above.y, around)) {
            if (touch_listed(&list, end - first, pieces)) tangled[layer] = 1;
            return;
        }
    }
#endif
    for (int i = first + LANE; i < end; i += LANES) {
        float4 p = pieces[i];
        float right = GREATER(p.x, p.z) - (float)(tx * TILE), left = LESSER(p.x, p.z) - (float)(tx * TILE);
        int last = right + 4.0f >= 16.0f && tx + 1 < tiles_x ? start[tile + 2] : end;
        int hit = touch_any(p, pieces, i + 1, last);
        if (GREATER(p.y, p.w) - (float)(ty * TILE) + 4.0f >= 16.0f) {
            int2 run = run_of(start, base, tx - (left < 4.0f), tx + (right + 4.0f >= 16.0f), ty + 1, tiles_x, tiles_y);
            hit |= touch_any(p, pieces, run.x, run.y);
        }
        if (hit) tangled[layer] = 1;
    }
}

/* place == 0: count[tile] parts that are boundary, and mark tangled[layer] where they are not simply all the
 * pieces: CUT where some are no boundary, SHORT where some are left out for being short.
 * place == 1: write them from cursor[tile] on. Layers that are not suspect keep all their pieces. */
__kernel void find_boundary(int items, __global const float4 *pieces, __global const int *start, __global const int *wind, int tiles_x,
                            int tiles_y, int rule, __global const int *suspect, int place, volatile __global int *count, volatile __global int *tangled,
                            __global float4 *boundary)
{
    if (ITEM >= items) return;
    int tile = ITEM, tiles = tiles_x * tiles_y, layer = tile / tiles, base = layer * tiles;
    int ty = (tile - base) / tiles_x, tx = tile - base - ty * tiles_x, first = start[tile], end = start[tile + 1];
    if (!suspect[layer]) {
        if (place)
            for (int i = first + LANE; i < end; i += LANES) boundary[count[tile] + i - first] = pieces[i];
        else if (LANE == 0)
            count[tile] = end - first;
        return;
    }
    for (int i = first + LANE; i < end; i += LANES) {
        float4 p = pieces[i];
        float2 d = p.zw - p.xy;
        float from = 0.0f, least = LEAST / GREATER(sqrt(dot(d, d)), 1e-9f);
        int kept = 0;
        if (least >= 1.0f) atomic_or(&tangled[layer], SHORT);
        if (least < 1.0f)
            while (from < 1.0f) {
                Sides s = look(pieces, start, wind, base, tx, ty, tiles_x, tiles_y, i, from, 1.0f);
                float to = s.end;
                if (to < 1.0f) {
                    atomic_or(&tangled[layer], CUT);
                    s = look(pieces, start, wind, base, tx, ty, tiles_x, tiles_y, i, from, to);
                }
                if (to - from >= least && RULE(s.left, rule) != RULE(s.right, rule)) {
                    kept++;
                    if (place) boundary[atomic_inc(&count[tile])] = (float4)(p.xy + d * from, p.xy + d * to);
                } else if (to - from >= least) atomic_or(&tangled[layer], CUT);
                from = to;
            }
        if (!place && kept) atomic_add(&count[tile], kept);
    }
}
