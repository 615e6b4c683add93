/* Level sets -> closed, decimated loops. Composed after isoline.cl, whose cases and edges it follows. */

/* Mark the places where a contour crosses a row of pixels upwards (inside left, outside right): every loop has one.
 * seeds[slot * 16 + r] bit i; crossings[image] bounds the points of the undecimated contours, corners included. levels: part, scaffold. */
__kernel void find_seeds(__global const int *map, __global const short *pool, __global const int *owner, int tiles_x,
                         int tiles_y, int layers, int2 levels, __global ushort *seeds, volatile __global int *crossings,
                         volatile __global int *starts)
{
    int low[17], high[17], slot = (int)get_global_id(0) >> 4, image = owner[slot] / (tiles_x * tiles_y);
    int level = image < layers ? levels.x : levels.y;
    load_cells(map, pool, owner[slot], (int)get_global_id(0) & 15, tiles_x, tiles_y, low, high);
    uint a = 0, b = 0;
    for (int i = 0; i < 17; i++) {
        a |= (uint)(low[i] < level) << i;
        b |= (uint)(high[i] < level) << i;
    }
    uint up = a & ~(a >> 1) & 0xffffu;
    int n = popcount((a ^ (a >> 1)) & 0xffffu) + popcount((a ^ b) & 0xffffu);
    seeds[get_global_id(0)] = (ushort)up;
    if (n) atomic_add(&crossings[image], 2 * n);
    if (up) atomic_add(&starts[image], (int)popcount(up));
}

/* Keeps a point only where the ones before it no longer lie within `tolerance` of a chord from the last kept point. */
typedef struct {
    float2 anchor, last, left, right; /* left, right: the cone of chords that is still allowed, unit vectors */
    float tolerance, spacing, farthest;
    int wide, late; /* wide: no cone yet; late: the cone broke before the spacing was reached */
    int count;
} Sleeve;

inline float turn(float2 a, float2 b) { return a.x * b.y - a.y * b.x; }

inline void keep(Sleeve *s, float2 p, __global float2 *out)
{
    out[s->count++] = p;
    s->anchor = p;
    s->farthest = 0.0f;
    s->wide = 1;
    s->late = 0;
}

/* Whether a chord to p passes all points since the anchor; narrows the cone if so. */
inline int fits(Sleeve *s, float2 p)
{
    float2 d = p - s->anchor;
    float far = sqrt(d.x * d.x + d.y * d.y);
    if (far <= s->tolerance) return s->farthest <= 2.0f * s->tolerance;
    float2 u = d / far;
    if (!s->wide && (turn(s->right, u) < 0.0f || turn(u, s->left) < 0.0f || u.x * (s->left.x + s->right.x) + u.y * (s->left.y + s->right.y) < 0.0f))
        return 0;
    if (far < s->farthest - s->tolerance) return 0;
    float sine = s->tolerance / far, cosine = sqrt(1.0f - sine * sine);
    float2 l = (float2)(u.x * cosine - u.y * sine, u.x * sine + u.y * cosine);
    float2 r = (float2)(u.x * cosine + u.y * sine, u.y * cosine - u.x * sine);
    if (s->wide || turn(l, s->left) > 0.0f) s->left = l;
    if (s->wide || turn(s->right, r) > 0.0f) s->right = r;
    s->wide = 0;
    s->farthest = fmax(s->farthest, far);
    return 1;
}

inline void feed(Sleeve *s, float2 p, __global float2 *out)
{
    if (!s->late && !fits(s, p)) {
        if (distance(s->last, s->anchor) >= s->spacing) {
            keep(s, s->last, out);
            fits(s, p);
        } else s->late = 1;
    }
    if (s->late && distance(p, s->anchor) >= s->spacing) keep(s, p, out);
    s->last = p;
}

/* Distance of p from the chord a - b. */
inline float astray(float2 p, float2 a, float2 b)
{
    float2 d = b - a;
    float t = clamp(dot(p - a, d) / fmax(dot(d, d), 1e-12f), 0.0f, 1.0f);
    return distance(p, a + d * t);
}

/* A corner is kept even if it comes too soon after the last kept point, when that one lies near the new chord. */
inline void feed_corner(Sleeve *s, float2 p, __global float2 *out)
{
    int n = s->count;
    if (distance(p, s->anchor) >= s->spacing
        || (n > 1 && (distance(p, out[n - 2]) < s->spacing || astray(s->anchor, out[n - 2], p) > s->tolerance))) {
        feed(s, p, out);
        return;
    }
    s->count--;
    keep(s, p, out);
    s->last = p;
}

/* Drop the last points, or move the first ones up, until the loop closes with a chord of at least `spacing`; what lies
 * nearer to its chord goes. Returns what is left. */
inline int close_loop(__global float2 *out, int n, float spacing)
{
    while (n > 2 && distance(out[n - 1], out[0]) < spacing) {
        if (astray(out[0], out[n - 1], out[1]) < astray(out[n - 1], out[n - 2], out[0])
            && distance(out[n - 1], out[1]) >= spacing)
            for (int i = 1; i < n; i++) out[i - 1] = out[i];
        n--;
    }
    return n < 3 ? 0 : n;
}

/* Follow one contour from the cell above seed (x, y) and write what is left of it; returns the number of points.
 * The first point that is kept for its own sake becomes the start, so that a loop does not begin amid a straight side. */
inline int follow(__global const int *map, __global const short *pool, int base, int tiles_x, int level, int x, int y,
                  int tiles_y, float quantum, __global ushort *seeds, float tolerance, float spacing,
                  __global float2 *out)
{
    int sx = x, sy = y, e = 0, low[2], high[2], steps = 0, all = 0, begun = 0;
    Sleeve s;
    s.tolerance = tolerance, s.spacing = spacing, s.count = 0;
    low[0] = pixel(map, pool, base, tiles_x, x, y);
    low[1] = pixel(map, pool, base, tiles_x, x + 1, y);
    float2 first = edge_point(low, low, 0, 0, level, (float)x, (float)y);
    keep(&s, first, out);
    s.last = first;
    float2 made = (float2)(-BIG, 0.0f);
    do {
        if (e == 0) {
            int slot = map[base + (y >> 4) * tiles_x + (x >> 4)];
            seeds[slot * 16 + (y & 15)] &= (ushort)~(1u << (x & 15));
        }
        low[0] = pixel(map, pool, base, tiles_x, x, y);
        low[1] = pixel(map, pool, base, tiles_x, x + 1, y);
        high[0] = pixel(map, pool, base, tiles_x, x, y + 1);
        high[1] = pixel(map, pool, base, tiles_x, x + 1, y + 1);
        int c = case_of(low, high, 0, level), to = leave_edge[c];
        if (c == 5) to = centre_inside(low, high, 0, level) ? e + 1 : 3 - e; /* 0 -> 1, 2 -> 3 or 0 -> 3, 2 -> 1 */
        if (c == 10) to = centre_inside(low, high, 0, level) ? (e == 3 ? 0 : 2) : (e == 1 ? 0 : 2);
        float2 p = edge_point(low, high, 0, to, level, (float)x, (float)y);
        if (quantum > 0.0f && c != 5 && c != 10 && creased(low, high, 0, quantum)) {
            float2 last = s.last, corner;
            if (corner_of(map, pool, base, tiles_x, tiles_y, x, y, e, to, level, quantum, 0.3f, &last, &p, &corner)
                && distance(corner, made) > 0.35f) { /* two cells may see one corner */
                if (distance(s.last, s.anchor) > 0.0f) s.last = last;
                feed_corner(&s, corner, out);
                made = corner;
            }
        }
        x += to == 1 ? 1 : to == 3 ? -1 : 0;
        y += to == 2 ? 1 : to == 0 ? -1 : 0;
        e = to ^ 2;
        steps++;
        if (x == sx && y == sy && e == 0 && !all) {
            all = steps;
            if (!begun) break; /* the seed stays the start */
        }
        if (all && steps >= all + begun) break;
        feed(&s, p, out);
        if (!begun && s.count > 1) { /* start again at the point just kept */
            begun = steps;
            out[0] = s.anchor;
            s.count = 1;
        }
    } while (1);
    if (!begun && distance(s.last, s.anchor) >= spacing && !fits(&s, first)) keep(&s, s.last, out);
    return close_loop(out, s.count, spacing);
}

/* All loops of one image, in the order of their seeds. Image i writes points from place[i] and loops from loop_place[i];
 * mode[loop] 0: as asked, 1: a finer tolerance, 2: every point (for loops that crossed something). quantum (part, scaffold):
 * pixels per quantum, or 0 to leave creases as marching squares cuts them. */
__kernel void follow_contours(__global const int *map, __global const short *pool, int tiles_x, int tiles_y, int layers,
                              int2 levels, __global ushort *seeds, __global const int *place,
                              __global const int *loop_place, __global const uchar *mode, float tolerance, float spacing,
                              float2 quantum, __global float2 *points, __global int *next, __global int *loop_of,
                              __global int *loop_end, __global int4 *totals)
{
    int image = (int)get_global_id(0), base = image * tiles_x * tiles_y;
    int level = image < layers ? levels.x : levels.y;
    int n = place[image], loop = loop_place[image], dropped = 0;
    for (int tile = 0; tile < tiles_x * tiles_y; tile++) {
        int slot = map[base + tile];
        if (slot < 0) continue;
        for (int r = 0; r < 16; r++) {
            while (seeds[slot * 16 + r]) {
                int i = 31 - (int)clz((uint)(seeds[slot * 16 + r] & -seeds[slot * 16 + r]));
                int how = mode[loop];
                int kept = follow(map, pool, base, tiles_x, level, (tile % tiles_x) * TILE + i, (tile / tiles_x) * TILE + r,
                                  tiles_y, how ? 0.0f : image < layers ? quantum.x : quantum.y, seeds, how == 0 ? tolerance : how == 1 ? 0.125f * tolerance : 0.0f,
                                  how == 2 ? 0.0f : spacing, points + n);
                for (int k = n; k < n + kept; k++) {
                    next[k] = k + 1 < n + kept ? k + 1 : n;
                    loop_of[k] = loop;
                }
                n += kept;
                dropped += kept == 0;
                loop_end[loop++] = n;
            }
        }
    }
    totals[image] = (int4)(n - place[image], loop - loop_place[image], dropped, 0);
}
