/* Whether any two pieces of a layer cross or touch: where none do, all of them are boundary. */

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
 * and above. Tiles are those of a window, `corner` its first. */
__kernel void find_contacts(int items, __global const float4 *pieces, __global const int *start, int2 corner, int tiles_x, int tiles_y,
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
        float x = (float)((corner.x + tx) * TILE), right = GREATER(p.x, p.z) - x, left = LESSER(p.x, p.z) - x;
        int last = right + 4.0f >= 16.0f && tx + 1 < tiles_x ? start[tile + 2] : end;
        int hit = touch_any(p, pieces, i + 1, last);
        if (GREATER(p.y, p.w) - (float)((corner.y + ty) * TILE) + 4.0f >= 16.0f) {
            int2 run = run_of(start, base, tx - (left < 4.0f), tx + (right + 4.0f >= 16.0f), ty + 1, tiles_x, tiles_y);
            hit |= touch_any(p, pieces, run.x, run.y);
        }
        if (hit) tangled[layer] = 1;
    }
}
