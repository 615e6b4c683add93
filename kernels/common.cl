/* Shared by every stage. Lengths are pixels, images are cut into tiles of 16 x 16 pixels.
 *
 * A tile is worked on by one work-item that holds rows of 16 pixels in vectors (a CPU), or by a
 * group of 64 work-items that hold one pixel of every fourth row each (WIDE, a GPU). V is one row
 * as a work-item sees it; ROWS runs over the rows that it owns and OWN(r) numbers them.
 *
 * map[image * tiles + tile] says where a tile lives: its slot in the pool, or OUTSIDE or INSIDE
 * when all its pixels are farther from the boundary than the band. A stored pixel q stands for the
 * distance (q + 0.5) / scale, so that no pixel ever lies on a level that is a whole number.
 */
#pragma OPENCL FP_CONTRACT OFF

#define OUTSIDE (-1)
#define INSIDE (-2)
#define FAR 32767
#define TILE 16
#define PIXELS 256
#define BIG 3.0e38f
#define SHARERS 64 /* work-items of a group, at most: TILE_GROUP and WIDE_GROUP in device.py */

/* Rows of tiles are aligned: one instruction, where vload16 takes seven. */
#define ROW(p, r) (((__global const short16 *)(p))[r])

#ifdef WIDE
typedef float V;
typedef int VI;
#define LANES 64
#define LANE ((int)get_local_id(0))
#define ITEM ((int)get_group_id(0))
#define XS (LANE & 15)
#define ROWS(r) for (int r = LANE >> 4; r < 16; r += 4)
#define OWN(r) ((r) >> 2)
#define OWNED 4
#define LOAD(p, r) ((int)(p)[(r) * 16 + (LANE & 15)])
#define STORE(v, p, r) (p)[(r) * 16 + (LANE & 15)] = (short)(v)
#define TO_F(v) ((float)(v))
#define TO_I(v) floor_of(v)
#define AS_I(v) as_int(v)
#define SUM(v) (v)
#define SYNC barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE)
#else
typedef float16 V;
typedef int16 VI;
#define LANES 1
#define LANE 0
#define ITEM ((int)get_global_id(0))
#define XS ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#define ROWS(r) for (int r = 0; r < 16; r++)
#define OWN(r) (r)
#define OWNED 16
#define LOAD(p, r) convert_int16(ROW(p, r))
#define STORE(v, p, r) ((__global short16 *)(p))[r] = convert_short16(v)
#define TO_F(v) convert_float16(v)
#define TO_I(v) (convert_int16(v) + (convert_float16(convert_int16(v)) > (v)))
#define AS_I(v) as_int16(v)
#define SYNC
#endif

/* As ITEM, in an order in which neighbours of a group are far away. Processors take long runs of groups; where a hundred
 * of them go down through a batch, those that have much to do lie side by side, and one processor would get them all.
 */
inline int spread_item()
{
    int groups = (int)get_num_groups(0), stride = groups % 37 ? 37 : groups % 41 ? 41 : 1; /* without common divisor */
    int group = (int)get_group_id(0) * stride % groups;
#ifdef WIDE
    return group;
#else
    return group * (int)get_local_size(0) + (int)get_local_id(0);
#endif
}

/* Nearest whole number, for less than 2^22: compilers make a dozen instructions of convert_int_rte. */
#define TO_NEAREST(v) (AS_I((v) + 12582912.0f) - 0x4B400000)

/* Whole numbers below and above, of what an int holds; floor and ceil mind what it does not. */
inline int floor_of(float v)
{
    int i = (int)v;
    return i - ((float)i > v);
}
inline int ceil_of(float v)
{
    int i = (int)v;
    return i + ((float)i < v);
}

#define INLINE inline __attribute__((always_inline))

/* One instruction each, where fmin and fmax have to mind NaN. */
#define LESSER(a, b) ((a) < (b) ? (a) : (b))
#define GREATER(a, b) ((a) > (b) ? (a) : (b))

/* Combine one value of each lane; every lane gets the result. shared is __local int[1]. */
inline int all_max(int v, __local int *shared)
{
#ifdef WIDE
    SYNC;
    if (LANE == 0) *shared = INT_MIN;
    SYNC;
    atomic_max(shared, v);
    SYNC;
    return *shared;
#else
    return v;
#endif
}

inline int all_sum(int v, __local int *shared)
{
#ifdef WIDE
    SYNC;
    if (LANE == 0) *shared = 0;
    SYNC;
    atomic_add(shared, v);
    SYNC;
    return *shared;
#else
    return v;
#endif
}

#ifndef WIDE
inline int row_max(int16 v)
{
    int8 a = max(v.lo, v.hi);
    int4 b = max(a.lo, a.hi);
    int2 c = max(b.lo, b.hi);
    return max(c.x, c.y);
}
inline int row_sum(int16 v)
{
    int8 a = v.lo + v.hi;
    int4 b = a.lo + a.hi;
    int2 c = b.lo + b.hi;
    return c.x + c.y;
}
#else
#define row_max(v) (v)
#define row_sum(v) (v)
#endif

/* Bit i: v[i] is inside the level. */
inline uint inside_bits(short16 v, int level)
{
#if defined(__SSE2__) && !defined(WIDE) && defined(__clang__)
    typedef char bytes __attribute__((__vector_size__(16)));
    char16 inside = convert_char16(v < (short16)(short)level);
    return (uint)__builtin_ia32_pmovmskb128(*(bytes *)&inside);
#else
    short16 b = (v < (short16)(short)level) & (short16)(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, -32768);
    short8 c = b.lo | b.hi;
    short4 d = c.lo | c.hi;
    short2 e = d.lo | d.hi;
    return (uint)(ushort)(e.x | e.y);
#endif
}

/* Bit i: lane i of a row is true; a GPU's lane knows its own. */
inline uint lane_bits(VI v)
{
#ifdef WIDE
    return v ? 1u << XS : 0u;
#else
    return inside_bits(convert_short16(v), 0);
#endif
}

/* One slot of a pool for this tile, the same on every lane. */
inline int take_slot(volatile __global int *counter, __local int *shared)
{
#ifdef WIDE
    SYNC;
    if (LANE == 0) *shared = atomic_inc(counter);
    SYNC;
    return *shared;
#else
    return atomic_inc(counter);
#endif
}

/* Pieces of a row of tiles, clamped to the image: sorted by tile, so they are one run. */
inline int2 run_of(__global const int *start, int base, int tx0, int tx1, int ty, int tiles_x, int tiles_y)
{
    if (ty < 0 || ty >= tiles_y) return (int2)(0, 0);
    int row = base + ty * tiles_x;
    return (int2)(start[row + max(tx0, 0)], start[row + min(tx1, tiles_x - 1) + 1]);
}

/* Squared distance between the box of a piece and the box of the pixels of a tile. */
inline float box_gap2(float4 s, float x, float y)
{
    float right = LESSER(s.x, s.z) - (x + 15.0f), left = x - GREATER(s.x, s.z), dx = GREATER(right, left);
    float above = LESSER(s.y, s.w) - (y + 15.0f), below = y - GREATER(s.y, s.w), dy = GREATER(above, below);
    dx = GREATER(dx, 0.0f), dy = GREATER(dy, 0.0f);
    return dx * dx + dy * dy;
}

#if defined(FP_FAST_FMAF) || defined(__FMA__)
#define MAD(a, b, c) fma(a, b, c)
#else
#define MAD(a, b, c) ((a) * (b) + (c))
#endif

/* Lower acc (squared distances of the owned rows of the tile at x, y) to the piece s.
 * Halves of the tile that are farther than `reach` from the piece are left out. */
INLINE void lower_to(V *acc, float4 s, float x, float y, float reach)
{
    float dx = s.z - s.x, dy = s.w - s.y, inv = 1.0f / GREATER(dx * dx + dy * dy, 1e-20f), climb = dy * inv;
    V px = TO_F(XS) + (x - s.x), along = px * (dx * inv);
    float low = LESSER(s.y, s.w) - reach - y, high = GREATER(s.y, s.w) + reach - y;
#ifdef WIDE
    ROWS(r) if ((float)r >= low && (float)r <= high) {
        float py = (float)r + (y - s.y);
        V t = LESSER(GREATER(along + py * climb, 0.0f), 1.0f);
        V ex = MAD(-t, dx, px), ey = MAD(-t, dy, py);
        acc[OWN(r)] = LESSER(MAD(ex, ex, ey * ey), acc[OWN(r)]);
    }
#else
    for (int from = 0; from < 16; from += 4) {
        if (high < (float)from || low > (float)from + 3.0f) continue;
#pragma unroll
        for (int r = 0; r < 4; r++) {
            float py = (float)(from + r) + (y - s.y);
            V t = LESSER(GREATER(along + py * climb, (V)0.0f), (V)1.0f);
            V ex = MAD(-t, (V)dx, px), ey = MAD(-t, (V)dy, (V)py);
            V e = MAD(ex, ex, ey * ey);
            acc[from + r] = LESSER(e, acc[from + r]);
        }
    }
#endif
}

/* Twice the area between two vectors: positive where b turns left of a. */
inline float cross2(float2 a, float2 b) { return a.x * b.y - a.y * b.x; }

/* Rows that an edge crosses: y0 <= row < y1 in either direction; half open, so that a vertex on a row counts once. */
inline int2 rows_of(float4 s)
{
    return (int2)(ceil_of(LESSER(s.y, s.w)), ceil_of(GREATER(s.y, s.w)));
}

/* First pixel of row j at or right of the crossing. Every kernel asks this one function, so they all agree. */
inline int first_right(float4 s, int j)
{
    float x = s.x + ((float)j - s.y) * ((s.z - s.x) / (s.w - s.y));
    float left = LESSER(s.x, s.z), right = GREATER(s.x, s.z);
    x = x < left ? left : x;
    return ceil_of(LESSER(x, right));
}

/* The solid lies left of a piece: a downward piece opens it for the pixels to its right. */
inline int turn_of(float4 s) { return s.w < s.y ? 1 : -1; }

#define WOUND 2
#define NONZERO 0
#define POSITIVE 1
#define EVENODD 2
#define RULE(w, rule) ((rule) == NONZERO ? (w) != 0 : (rule) == POSITIVE ? (w) > 0 : ((w) & 1) != 0)

/* One pixel through the map, FAR or -FAR where the tile has no slot. */
inline int pixel(__global const int *map, __global const short *pool, int base, int tiles_x, int x, int y)
{
    int slot = map[base + (y >> 4) * tiles_x + (x >> 4)];
    return slot >= 0 ? pool[slot * PIXELS + (y & 15) * 16 + (x & 15)] : slot == INSIDE ? -FAR : FAR;
}
