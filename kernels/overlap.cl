/* Which pieces, or parts of pieces, are boundary of the union of overlapping shells.
 *
 * A piece is split where others cross or touch it; a part is boundary when the rule differs between its two sides.
 * The winding number is asked for a hair (SIDE) left and right of the middle of the part: it is known at the first pixel of each
 * tile row, and changes by the pieces that a path from there along the row, then across the rows, meets. Parts shorter than
 * LEAST are left out: what they miss is far below a quantum.
 * A work-item takes pieces of one tile; all pieces that matter to them lie in the 3 x 3 tiles around it. Tiles are those of a window,
 * `corner` its first.
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
inline Sides look(__global const float4 *pieces, __global const int *start, __global const int *wind, int2 corner, int base, int tx,
                  int ty, int tiles_x, int tiles_y, int self, float from, float to)
{
    float2 origin = (float2)((corner.x + tx) * TILE, (corner.y + ty) * TILE);
    float4 shift = (float4)(origin, origin), p = pieces[self] - shift;
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

/* place == 0: count[tile] parts that are boundary, and mark tangled[layer] where they are not simply all the
 * pieces: CUT where some are no boundary, SHORT where some are left out for being short.
 * place == 1: write them from cursor[tile] on. Layers that are not suspect keep all their pieces. */
__kernel void find_boundary(int items, __global const float4 *pieces, __global const int *start, __global const int *wind,
                            int2 corner, int tiles_x, int tiles_y, int rule, __global const int *suspect, int place,
                            volatile __global int *count, volatile __global int *tangled, __global float4 *boundary)
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
                Sides s = look(pieces, start, wind, corner, base, tx, ty, tiles_x, tiles_y, i, from, 1.0f);
                float to = s.end;
                if (to < 1.0f) {
                    atomic_or(&tangled[layer], CUT);
                    s = look(pieces, start, wind, corner, base, tx, ty, tiles_x, tiles_y, i, from, to);
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
