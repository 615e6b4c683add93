/* The chords of traced contours as pieces sorted by tile, as in bins.cl. One work-item per image: nobody else counts its tiles. */

inline void bin_chords(__global const float2 *points, __global const int *next, int first, int n, int base, int tiles_x,
                       __global int *count, __global float4 *pieces)
{
    for (int i = first; i < first + n; i++) {
        float4 s = (float4)(points[i], points[next[i]]);
        int parts = pieces_of(s);
        for (int k = 0; k < parts; k++) {
            float4 piece = (float4)(point_on(s, k, parts), point_on(s, k + 1, parts));
            int place = count[base + tile_of(piece, (int2)(0, 0), tiles_x)]++;
            if (pieces) pieces[place] = piece;
        }
    }
}

/* count[key] pieces in each tile of the images. */
__kernel void count_chords(__global const float2 *points, __global const int *next, __global const int *place,
                           __global const int4 *totals, int tiles_x, int tiles_y, __global int *count)
{
    int image = (int)get_global_id(0), tiles = tiles_x * tiles_y;
    for (int i = image * tiles; i < (image + 1) * tiles; i++) count[i] = 0;
    bin_chords(points, next, place[image], totals[image].x, image * tiles, tiles_x, count, 0);
}

__kernel void place_chords(__global const float2 *points, __global const int *next, __global const int *place,
                           __global const int4 *totals, int tiles_x, int tiles_y, __global int *cursor,
                           __global float4 *pieces)
{
    int image = (int)get_global_id(0);
    bin_chords(points, next, place[image], totals[image].x, image * tiles_x * tiles_y, tiles_x, cursor, pieces);
}

/* The area of the part that no bead reaches: farther from the traced contour (pieces) than half a width.
 * A pixel counts by the part of it that is inside; `slack` pixels are forgiven to curvature. */
__kernel void lost_area(int items, __global const float4 *pieces, __global const int *start, __global const short *pool,
                        __global const int *owner, int tiles_x, int tiles_y, int reach, float half_width, float slack,
                        int inset, float scale, __global int *lost)
{
    if (ITEM >= items) return;
    __local int shared[1];
    int key = owner[ITEM], tiles = tiles_x * tiles_y, tile = key % tiles, base = key - tile;
    int ty = tile / tiles_x, tx = tile - ty * tiles_x;
    float x = (float)(tx * TILE), y = (float)(ty * TILE), far = half_width + slack + 1.0f;
    __global const short *mine = pool + ITEM * PIXELS;
    int rim = 0, high = convert_int_rtp(0.5f * scale); /* whether any pixel is inside, but not in the inset */
    ROWS(r) {
        VI q = LOAD(mine, r);
        rim = max(rim, row_max(select((VI)0, (VI)1, (VI)((q >= inset) & (q < high)))));
    }
    if (!all_max(rim, shared)) {
        if (LANE == 0) lost[key] = 0;
        return;
    }
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
        V inside = LESSER(GREATER((V)0.5f - (TO_F(q) + 0.5f) / scale, (V)0.0f), (V)1.0f);
        V missed = LESSER(GREATER(sqrt(acc[OWN(r)]) - (half_width + slack), (V)0.0f), (V)1.0f);
        sum += row_sum(select(TO_I(inside * missed * 65536.0f), (VI)0, (VI)(q < inset)));
    }
    sum = all_sum(sum, shared);
    if (LANE == 0) lost[key] = sum;
}
