/* Marching squares on the stored tiles of a map.
 *
 *      b3 --e2-- b2       Cell (x, y) has pixel (x, y) at b0; bit i of a case is set where b_i is inside (q < level).
 *      |          |       The level is a whole number and a pixel stands for q + 0.5, so a crossing is never at a pixel.
 *     e3          e1      A crossed cell lies within sqrt(2) pixels of the level, so all its tiles are stored.
 *      |          |
 *      b0 --e0-- b1       One work-item per stored tile; on a GPU, one per row of it.
 */

/* Edges from and to which the contour runs, inside on its left, by case; saddles (5, 10) aside. */
__constant char enter_edge[16] = {-1, 0, 1, 1, 2, -1, 2, 2, 3, 0, -1, 1, 3, 0, 3, -1};
__constant char leave_edge[16] = {-1, 3, 0, 3, 1, -1, 0, 3, 2, 2, -1, 2, 1, 1, 0, -1};

/* The stored tile of a key (image * tiles + tile), and where its neighbours to the right, above and on the diagonal live. */
typedef struct {
    int slot, key, base, x, y, right, above, diagonal;
} Tile;

inline Tile tile_at(__global const int *map, int key, int tiles_x, int tiles_y)
{
    Tile t;
    int tiles = tiles_x * tiles_y, tile = key % tiles, tx = tile % tiles_x, ty = tile / tiles_x;
    int has_right = tx + 1 < tiles_x, has_above = ty + 1 < tiles_y;
    t.slot = map[key], t.key = key, t.base = t.key - tile, t.x = tx * TILE, t.y = ty * TILE;
    t.right = has_right ? map[t.key + 1] : OUTSIDE;
    t.above = has_above ? map[t.key + tiles_x] : OUTSIDE;
    t.diagonal = has_right && has_above ? map[t.key + tiles_x + 1] : OUTSIDE;
    return t;
}

inline int pixel_of(__global const short *pool, int slot, int at)
{
    return slot >= 0 ? pool[slot * PIXELS + at] : slot == INSIDE ? -FAR : FAR;
}

/* Bit i: pixel i of row r (0 .. 16) of a tile is inside the level; bit 16 is the first pixel of the next tile. */
inline uint row_bits(__global const short *pool, Tile *t, int r, int level)
{
    if (r < 16)
        return inside_bits(ROW(pool + t->slot * PIXELS, r), level) | (uint)(pixel_of(pool, t->right, r * 16) < level) << 16;
    uint row = t->above >= 0 ? inside_bits(ROW(pool + t->above * PIXELS, 0), level) : t->above == INSIDE ? 0xffffu : 0u;
    return row | (uint)(pixel_of(pool, t->diagonal, 0) < level) << 16;
}

/* The rows of a tile that this work-item has, and the bits of row r and the row above: one that has all rows, looks at each once. */
#define ROWS_OF_TILE(r) for (int r = LANE; r < TILE; r += LANES)
#define NEXT_BITS(a, b, pool, t, r, level) \
    do { \
        (a) = LANES == 1 ? (b) : row_bits(pool, t, r, level); \
        (b) = row_bits(pool, t, (r) + 1, level); \
    } while (0)
inline uint first_bits(__global const short *pool, Tile *t, int level)
{
    return LANES == 1 ? row_bits(pool, t, 0, level) : 0;
}

/* Cells of a row that the level crosses, from the bits of their lower and upper pixels. */
inline uint crossed_cells(uint a, uint b)
{
    return ((a ^ (a >> 1)) | (b ^ (b >> 1)) | (a ^ b)) & 0xffffu;
}

/* The four pixels of cell i of row r: low = b0, b1; high = b3, b2. */
inline void load_cell(__global const short *pool, Tile *t, int i, int r, int *low, int *high)
{
    low[0] = pool[t->slot * PIXELS + r * 16 + i];
    low[1] = i < 15 ? pool[t->slot * PIXELS + r * 16 + i + 1] : pixel_of(pool, t->right, r * 16);
    high[0] = r < 15 ? pool[t->slot * PIXELS + r * 16 + 16 + i] : pixel_of(pool, t->above, i);
    high[1] = i < 15 ? (r < 15 ? pool[t->slot * PIXELS + r * 16 + 17 + i] : pixel_of(pool, t->above, i + 1))
                     : (r < 15 ? pixel_of(pool, t->right, r * 16 + 16) : pixel_of(pool, t->diagonal, 0));
}

/* The pixels of all cells of row r, in the order b0, b1, b2, b3; a GPU's lane has one cell. */
inline void load_row(__global const short *pool, Tile *t, int r, VI *q)
{
#ifdef WIDE
    int low[2], high[2];
    load_cell(pool, t, XS, r, low, high);
    q[0] = low[0], q[1] = low[1], q[2] = high[1], q[3] = high[0];
#else
    __global const short *mine = pool + t->slot * PIXELS;
    short16 a = ROW(mine, r), b = (short16)(short)(t->above == INSIDE ? -FAR : FAR);
    if (r < 15) b = ROW(mine, r + 1);
    else if (t->above >= 0) b = ROW(pool + t->above * PIXELS, 0);
    short16 c = a.s123456789abcdeff, d = b.s123456789abcdeff;
    c.sf = (short)pixel_of(pool, t->right, r * 16);
    d.sf = (short)(r < 15 ? pixel_of(pool, t->right, r * 16 + 16) : pixel_of(pool, t->diagonal, 0));
    q[0] = convert_int16(a), q[1] = convert_int16(c), q[2] = convert_int16(d), q[3] = convert_int16(b);
#endif
}

inline int case_of(const int *low, const int *high, int level)
{
    return (low[0] < level) | (low[1] < level) << 1 | (high[1] < level) << 2 | (high[0] < level) << 3;
}

/* Where the level lies between two pixels, as a fraction. */
inline float between(int a, int b, int level)
{
    float p = (float)(a - level) + 0.5f, q = (float)(b - level) + 0.5f;
    return p / (p - q);
}

inline int centre_inside(const int *low, const int *high, int level)
{
    return low[0] + low[1] + high[0] + high[1] + 2 < 4 * level;
}

/* Point on edge e of the cell at (x, y). */
inline float2 edge_point(const int *low, const int *high, int e, int level, float x, float y)
{
    if (e == 0) return (float2)(x + between(low[0], low[1], level), y);
    if (e == 1) return (float2)(x + 1.0f, y + between(low[1], high[1], level));
    if (e == 2) return (float2)(x + between(high[0], high[1], level), y + 1.0f);
    return (float2)(x, y + between(low[0], high[0], level));
}
