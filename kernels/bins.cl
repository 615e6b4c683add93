/* Segments -> pieces of at most 8 pixels, sorted by (layer, tile of their midpoint); winding at the start of each tile row.
 *
 * The order of the pieces of one tile is left open: everything made of them is a min or an integer sum.
 */
#define PIECE 8.0f

inline int pieces_of(float4 s)
{
    return max(1, ceil_of(GREATER(fabs(s.z - s.x), fabs(s.w - s.y)) * (1.0f / PIECE)));
}

inline float2 point_on(float4 s, int i, int n)
{
    float t = (float)i / (float)n;
    return i == n ? s.zw : s.xy + (s.zw - s.xy) * t;
}

/* The tile of a window of tiles_x columns, `corner` its first. */
inline int tile_of(float4 s, int2 corner, int tiles_x)
{
    int x = (int)(0.5f * (s.x + s.z)) >> 4, y = (int)(0.5f * (s.y + s.w)) >> 4;
    return (y - corner.y) * tiles_x + x - corner.x;
}

/* Tiles and rows are those of a window that holds all pieces.
 * count[layer * tiles + tile] pieces; wind[(layer * height + row) * tiles_x + tx] turns of pieces left of the
 * first pixel of tile tx and right of the one before. Layer 0 of a batch is its top slice. */
__kernel void count_pieces(__global const float4 *segments, __global const int *slice_of, int first, int last, int top,
                           int2 corner, int tiles_x, int tiles_y, volatile __global int *count, volatile __global int *wind)
{
    int i = first + (int)get_global_id(0);
    if (i >= last) return;
    float4 s = segments[i];
    int layer = top - slice_of[i], n = pieces_of(s);
    for (int p = 0; p < n; p++) {
        float4 piece = (float4)(point_on(s, p, n), point_on(s, p + 1, n));
        atomic_inc(&count[layer * tiles_x * tiles_y + tile_of(piece, corner, tiles_x)]);
        int2 rows = rows_of(piece);
        for (int j = rows.x; j < rows.y; j++) {
            int tx = ((first_right(piece, j) + 15) >> 4) - corner.x, row = (layer * tiles_y - corner.y) * TILE + j;
            if (tx < tiles_x) atomic_add(&wind[row * tiles_x + tx], turn_of(piece));
        }
    }
}

/* cursor starts as the first place of each tile. */
__kernel void place_pieces(__global const float4 *segments, __global const int *slice_of, int first, int last, int top,
                           int2 corner, int tiles_x, int tiles_y, volatile __global int *cursor, __global float4 *pieces)
{
    int i = first + (int)get_global_id(0);
    if (i >= last) return;
    float4 s = segments[i];
    int layer = top - slice_of[i], n = pieces_of(s);
    for (int p = 0; p < n; p++) {
        float4 piece = (float4)(point_on(s, p, n), point_on(s, p + 1, n));
        pieces[atomic_inc(&cursor[layer * tiles_x * tiles_y + tile_of(piece, corner, tiles_x)])] = piece;
    }
}
