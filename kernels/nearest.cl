/* Signed distance of single points from sorted pieces: exact, not sampled.
 *
 * near/near_start: the pieces that bound the solid; all/all_start/wind: every piece, for the winding number. A point
 * farther than `reach` tiles from every piece gets the distance to which the search is complete. Where the sign is not
 * asked for, the rule is UNSIGNED.
 */
#define UNSIGNED (-1)
#define OUT 4.0f /* pixels that a piece reaches beyond its tile, at most */

/* Winding number at p: from the first pixel of its row of its tile, right along the row, then up. */
inline int winding_at(float2 p, int layer, __global const float4 *all, __global const int *all_start,
                      __global const int *wind, int tiles_x, int tiles_y)
{
    p += (float2)(0.00371f, 0.00193f); /* off the pixels, where corners like to lie */
    if (p.x < 0 || p.y < 0 || p.x >= tiles_x * TILE || p.y >= tiles_y * TILE) return 0;
    int tx = (int)p.x >> 4, ty = (int)p.y >> 4, j = (int)p.y;
    float left = (float)(tx * TILE), row = (float)j, low = row - (float)(ty * TILE);
    int w = wind[(layer * tiles_y * TILE + j) * tiles_x + tx];
    /* The path is at most 16 pixels long and one high; a piece reaches at most 4 pixels out of its tile. */
    int right = p.x - left > 11.5f, down = low < 4.5f, up = low > 10.5f;
    for (int v = ty - down; v <= ty + up; v++) {
        int2 run = run_of(all_start, layer * tiles_x * tiles_y, tx - 1, tx + right, v, tiles_x, tiles_y);
        for (int i = run.x; i < run.y; i++) {
            float4 s = all[i];
            if (LESSER(s.y, s.w) <= row && row < GREATER(s.y, s.w)) {
                float x = s.x + (row - s.y) * ((s.z - s.x) / (s.w - s.y));
                x = clamp(x, LESSER(s.x, s.z), GREATER(s.x, s.z));
                if (x > left && x <= p.x) w += turn_of(s);
            }
            if ((s.x <= p.x) != (s.z <= p.x)) {
                float y = s.y + (p.x - s.x) * ((s.w - s.y) / (s.z - s.x));
                if (y > row && y <= p.y) w += s.z > s.x ? 1 : -1;
            }
        }
    }
    return w;
}

inline float gap2(float4 s, float2 p)
{
    float2 d = s.zw - s.xy, q = p - s.xy;
    float t = clamp(dot(q, d) / GREATER(dot(d, d), 1e-20f), 0.0f, 1.0f);
    q -= t * d;
    return dot(q, q);
}

__kernel void nearest(__global const float2 *points, __global const int *layer_of, int count,
                      __global const float4 *near, __global const int *near_start,
                      __global const float4 *all, __global const int *all_start, __global const int *wind,
                      int tiles_x, int tiles_y, int reach, int rule, __global float *distance)
{
    int n = (int)get_global_id(0);
    if (n >= count) return;
    float2 p = points[n];
    int layer = layer_of[n], base = layer * tiles_x * tiles_y;
    int tx = clamp(floor_of(p.x / TILE), 0, tiles_x - 1), ty = clamp(floor_of(p.y / TILE), 0, tiles_y - 1);
    float best = BIG, done = 0;
    for (int r = 0; r <= reach; r++) {
        for (int v = ty - r; v <= ty + r; v++) {
            /* Tiles of this row that can hold anything nearer than the best. */
            float away = GREATER(GREATER(v * TILE - p.y, p.y - (v + 1) * TILE) - OUT, 0.0f);
            if (away * away >= best) continue;
            float wide = sqrt(best - away * away) + OUT;
            int left = LESSER(p.x - wide, 0.0f) < 0.0f ? 0 : (int)(p.x - wide) / TILE;
            int right = (int)LESSER(p.x + wide, (float)(tiles_x * TILE)) / TILE;
            int whole = v == ty - r || v == ty + r;
            for (int side = 0; side < (whole ? 1 : 2); side++) { /* the left and the right tile of a row of the ring */
                int first = side ? tx + r : tx - r, last = whole ? tx + r : first;
                first = max(first, left), last = min(last, right);
                if (last < 0 || first >= tiles_x || first > last) continue;
                int2 run = run_of(near_start, base, first, last, v, tiles_x, tiles_y);
                for (int i = run.x; i < run.y; i++) best = LESSER(best, gap2(near[i], p));
            }
        }
        /* Whatever was not seen is at least this far. */
        float2 low = p - (float2)((tx - r) * TILE, (ty - r) * TILE);
        float2 high = (float2)((tx + r + 1) * TILE, (ty + r + 1) * TILE) - p;
        done = LESSER(LESSER(low.x, low.y), LESSER(high.x, high.y)) - OUT;
        if (done > 0 && best <= done * done) break;
    }
    float d = best < BIG ? sqrt(best) : GREATER(done, reach * (float)TILE - OUT);
    if (rule != UNSIGNED && RULE(winding_at(p, layer, all, all_start, wind, tiles_x, tiles_y), rule)) d = -d;
    distance[n] = d;
}
