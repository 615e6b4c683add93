/* Sixteen contours followed side by side, one in each lane of a vector: what contour.cl does with one, step for step, with the
 * same result. For a CPU; a single contour waits for memory and for guesses of its turns that go wrong. */
#ifndef WIDE
#define EACH_BIT(k, bits) for (uint k, rest_ = (bits); rest_ && (k = popcount((rest_ & -rest_) - 1), 1); rest_ &= rest_ - 1)
#define ITEM_OF(v, k) (((__private int *)&(v))[k])
#define FLOAT_OF(v, k) (((__private float *)&(v))[k])

/* A Sleeve in each lane; wide and late are masks. */
typedef struct {
    float16 anchor_x, anchor_y, last_x, last_y, left_x, left_y, right_x, right_y, farthest, tolerance, spacing;
    int16 wide, late, count;
} Sleeves;

/* Where the contour of each lane is: between pixel l, inside on its left, and r = l + (ay, -ax), outside, on its way (ax, ay). */
typedef struct {
    int16 alive, image, level, lx, ly, ax, ay, ql, qr, at, own; /* pixel l in the pool, and the number of its tile */
    int16 start_x, start_y, steps, all, begun;
    float16 first_x, first_y, made_x, made_y, quantum;
    Sleeves sleeve;
    int place[16], loop[16], next[16], end[16], dropped[16]; /* next, end: stored tiles of the image to look at */
} Walks;

/* What all lanes share: the arguments of the kernel. */
typedef struct {
    __global const int *map;
    __global const short *pool;
    int tiles_x, tiles_y, layers, level_x, level_y;
    __global ushort *seeds;
    __global const int *stored, *begin, *number, *place, *loop_place;
    __global const uchar *mode;
    float tolerance, spacing, quantum_x, quantum_y;
    __global float2 *points;
    __global int *next, *loop_of, *loop_end;
    __global int4 *totals;
    int image, step; /* the next image to take, and how far it is to the one after */
} Ground;

inline Sleeve sleeve_in(Sleeves *s, int k)
{
    Sleeve one;
    one.anchor = (float2)(FLOAT_OF(s->anchor_x, k), FLOAT_OF(s->anchor_y, k));
    one.last = (float2)(FLOAT_OF(s->last_x, k), FLOAT_OF(s->last_y, k));
    one.left = (float2)(FLOAT_OF(s->left_x, k), FLOAT_OF(s->left_y, k));
    one.right = (float2)(FLOAT_OF(s->right_x, k), FLOAT_OF(s->right_y, k));
    one.farthest = FLOAT_OF(s->farthest, k);
    one.tolerance = FLOAT_OF(s->tolerance, k), one.spacing = FLOAT_OF(s->spacing, k);
    one.wide = ITEM_OF(s->wide, k) != 0, one.late = ITEM_OF(s->late, k) != 0, one.count = ITEM_OF(s->count, k);
    return one;
}

inline void put_sleeve(Sleeves *s, int k, Sleeve one)
{
    FLOAT_OF(s->anchor_x, k) = one.anchor.x, FLOAT_OF(s->anchor_y, k) = one.anchor.y;
    FLOAT_OF(s->last_x, k) = one.last.x, FLOAT_OF(s->last_y, k) = one.last.y;
    FLOAT_OF(s->left_x, k) = one.left.x, FLOAT_OF(s->left_y, k) = one.left.y;
    FLOAT_OF(s->right_x, k) = one.right.x, FLOAT_OF(s->right_y, k) = one.right.y;
    FLOAT_OF(s->farthest, k) = one.farthest;
    FLOAT_OF(s->tolerance, k) = one.tolerance, FLOAT_OF(s->spacing, k) = one.spacing;
    ITEM_OF(s->wide, k) = -one.wide, ITEM_OF(s->late, k) = -one.late, ITEM_OF(s->count, k) = one.count;
}

/* As fits, of the lanes `who`: which chords pass all points since the anchor; their cones become narrower. */
inline int16 fits_lanes(Sleeves *s, float16 x, float16 y, int16 who)
{
    float16 dx = x - s->anchor_x, dy = y - s->anchor_y, far2 = dx * dx + dy * dy, far = sqrt(far2), sine = s->tolerance;
    int16 here = far <= s->tolerance, stays = s->farthest <= 2.0f * s->tolerance;
    int16 out = (s->right_x * dy - s->right_y * dx < 0.0f) | (dx * s->left_y - dy * s->left_x < 0.0f)
              | (dx * (s->left_x + s->right_x) + dy * (s->left_y + s->right_y) < 0.0f);
    int16 passes = ~((~s->wide & out) | (far < s->farthest - s->tolerance)), narrows = who & passes & ~here;
    float16 cosine = sqrt(far2 - sine * sine);
    float16 lx = dx * cosine - dy * sine, ly = dx * sine + dy * cosine, rx = dx * cosine + dy * sine, ry = dy * cosine - dx * sine;
    int16 left = narrows & (s->wide | (lx * s->left_y - ly * s->left_x > 0.0f));
    int16 right = narrows & (s->wide | (s->right_x * ry - s->right_y * rx > 0.0f));
    s->left_x = select(s->left_x, lx, left), s->left_y = select(s->left_y, ly, left);
    s->right_x = select(s->right_x, rx, right), s->right_y = select(s->right_y, ry, right);
    s->wide &= ~narrows;
    s->farthest = select(s->farthest, GREATER(s->farthest, far), narrows);
    return select(passes, stays, here);
}

/* As keep, of the lanes `who`. */
inline void keep_lanes(Walks *w, Ground *g, float16 x, float16 y, int16 who)
{
    Sleeves *s = &w->sleeve;
    EACH_BIT(k, lane_bits(who))
        g->points[w->place[k] + ITEM_OF(s->count, k)] = (float2)(FLOAT_OF(x, k), FLOAT_OF(y, k));
    s->count -= who;
    s->anchor_x = select(s->anchor_x, x, who), s->anchor_y = select(s->anchor_y, y, who);
    s->farthest = select(s->farthest, (float16)0.0f, who);
    s->wide |= who, s->late &= ~who;
}

/* As feed, of the lanes `who`. */
inline void feed_lanes(Walks *w, Ground *g, float16 x, float16 y, int16 who)
{
    Sleeves *s = &w->sleeve;
    int16 early = who & ~s->late, broke = early & ~fits_lanes(s, x, y, early);
    if (lane_bits(broke)) {
        float16 dx = s->last_x - s->anchor_x, dy = s->last_y - s->anchor_y;
        int16 kept = broke & (sqrt(dx * dx + dy * dy) >= s->spacing);
        keep_lanes(w, g, s->last_x, s->last_y, kept);
        fits_lanes(s, x, y, kept);
        s->late |= broke & ~kept;
    }
    if (lane_bits(who & s->late)) {
        float16 dx = x - s->anchor_x, dy = y - s->anchor_y;
        keep_lanes(w, g, x, y, who & s->late & (sqrt(dx * dx + dy * dy) >= s->spacing));
    }
    s->last_x = select(s->last_x, x, who), s->last_y = select(s->last_y, y, who);
}

/* Whether lane k finds another seed in its image, or in the next that nobody has taken; it is set to start there. */
inline int next_loop(Walks *w, Ground *g, int k)
{
    for (;; w->next[k]++) {
        int image = ITEM_OF(w->image, k), own = w->next[k];
        if (own == w->end[k]) {
            if (image >= 0)
                g->totals[image] = (int4)(w->place[k] - g->place[image], w->loop[k] - g->loop_place[image], w->dropped[k], 0);
            image = ITEM_OF(w->image, k) = g->image;
            if (image < 0) return 0;
            g->image -= g->step;
            w->next[k] = g->begin[image] - 1, w->end[k] = g->begin[image + 1];
            w->dropped[k] = 0, w->place[k] = g->place[image], w->loop[k] = g->loop_place[image];
            continue;
        }
        if (!any(vload16(own, g->seeds) != (ushort16)0)) continue;
        int key = g->stored[own], base = image * g->tiles_x * g->tiles_y, tile = key - base;
        for (int r = 0; r < TILE; r++) {
            uint seeds = g->seeds[own * TILE + r];
            if (!seeds) continue;
            int i = popcount((seeds & -seeds) - 1), how = g->mode[w->loop[k]], part = image < g->layers;
            int x = (tile % g->tiles_x) * TILE + i, y = (tile / g->tiles_x) * TILE + r;
            int level = part ? g->level_x : g->level_y, low[2];
            low[0] = pixel(g->map, g->pool, base, g->tiles_x, x, y), low[1] = pixel(g->map, g->pool, base, g->tiles_x, x + 1, y);
            float2 first = edge_point(low, low, 0, level, (float)x, (float)y);
            ITEM_OF(w->level, k) = level, ITEM_OF(w->ql, k) = low[0], ITEM_OF(w->qr, k) = low[1];
            ITEM_OF(w->lx, k) = ITEM_OF(w->start_x, k) = x, ITEM_OF(w->ly, k) = ITEM_OF(w->start_y, k) = y;
            ITEM_OF(w->ax, k) = 0, ITEM_OF(w->ay, k) = 1, ITEM_OF(w->at, k) = g->map[key] * PIXELS + r * TILE + i, ITEM_OF(w->own, k) = own;
            ITEM_OF(w->steps, k) = ITEM_OF(w->all, k) = ITEM_OF(w->begun, k) = 0;
            FLOAT_OF(w->first_x, k) = first.x, FLOAT_OF(w->first_y, k) = first.y;
            FLOAT_OF(w->made_x, k) = -BIG, FLOAT_OF(w->made_y, k) = 0.0f;
            FLOAT_OF(w->quantum, k) = how ? 0.0f : part ? g->quantum_x : g->quantum_y;
            Sleeve s;
            s.tolerance = how == 0 ? g->tolerance : how == 1 ? 0.125f * g->tolerance : 0.0f;
            s.spacing = how == 2 ? 0.0f : g->spacing, s.count = 0, s.left = s.right = (float2)(0.0f);
            keep(&s, first, g->points + w->place[k]);
            s.last = first;
            put_sleeve(&w->sleeve, k, s);
            return 1;
        }
    }
}

/* End the loop of lane k, and begin another, or none. */
inline void end_loop(Walks *w, Ground *g, int k)
{
    __global float2 *out = g->points + w->place[k];
    Sleeve s = sleeve_in(&w->sleeve, k);
    float2 first = (float2)(FLOAT_OF(w->first_x, k), FLOAT_OF(w->first_y, k));
    if (!ITEM_OF(w->begun, k) && distance(s.last, s.anchor) >= s.spacing && !fits(&s, first)) keep(&s, s.last, out);
    int n = w->place[k], kept = close_loop(out, s.count, s.spacing), loop = w->loop[k];
    for (int i = n; i < n + kept; i++) {
        g->next[i] = i + 1 < n + kept ? i + 1 : n;
        g->loop_of[i] = loop;
    }
    w->place[k] = n + kept;
    w->dropped[k] += kept == 0;
    g->loop_end[loop] = n + kept;
    w->loop[k] = loop + 1;
    if (!next_loop(w, g, k)) { /* stays on one pixel */
        ITEM_OF(w->alive, k) = ITEM_OF(w->ax, k) = ITEM_OF(w->ay, k) = ITEM_OF(w->at, k) = 0;
        ITEM_OF(w->lx, k) = ITEM_OF(w->ly, k) = 0;
    }
}

/* Look for a corner in the cell of lane k between two places; both are moved onto their lines. */
inline void look_for_corner(Walks *w, Ground *g, int k, int x, int y, int from, int to, float16 *px, float16 *py)
{
    Sleeve s = sleeve_in(&w->sleeve, k);
    float2 last = s.last, p = (float2)(FLOAT_OF(*px, k), FLOAT_OF(*py, k)), corner;
    float2 made = (float2)(FLOAT_OF(w->made_x, k), FLOAT_OF(w->made_y, k));
    if (!corner_of(g->map, g->pool, ITEM_OF(w->image, k) * g->tiles_x * g->tiles_y, g->tiles_x, g->tiles_y, x, y, from, to,
                   ITEM_OF(w->level, k), FLOAT_OF(w->quantum, k), SHARP, 0.3f, &last, &p, &corner))
        return;
    FLOAT_OF(*px, k) = p.x, FLOAT_OF(*py, k) = p.y;
    if (distance(corner, made) <= 0.35f) return; /* two cells may see one corner */
    if (distance(s.last, s.anchor) > 0.0f) s.last = last;
    feed_corner(&s, corner, g->points + w->place[k]);
    FLOAT_OF(w->made_x, k) = corner.x, FLOAT_OF(w->made_y, k) = corner.y;
    put_sleeve(&w->sleeve, k, s);
}

/* The edge of a cell through which a contour comes on its way. */
inline int edge_behind(int ax, int ay) { return ay ? 1 - ay : ax + 2; }

/* Ask for a tile before it is needed: contours jump about in memory, and waiting for it would take most of their time. */
inline void fetch_tile(Ground *g, int key)
{
#ifdef __clang__
    int slot = g->map[key];
    if (slot < 0) return;
    for (int i = 0; i < PIXELS; i += 32) __builtin_prefetch(g->pool + slot * PIXELS + i);
    __builtin_prefetch(g->number + key);
#endif
}

/* One step of all lanes: from the edge of a cell to the next. */
inline void step_lanes(Walks *w, Ground *g)
{
    int16 fx = w->lx + w->ax, fy = w->ly + w->ay, gx = fx + w->ay, gy = fy - w->ax, f, h; /* pixels ahead of l and of r */
    int16 ahead = w->ax + 16 * w->ay, across = w->ay - 16 * w->ax;
    int16 leaves = ((fx ^ w->lx) | (gx ^ w->lx) | (fy ^ w->ly) | (gy ^ w->ly)) > 15;
    int16 at_f = w->at + (ahead & ~leaves), at_h = at_f + (across & ~leaves);
    uint left_tile = lane_bits(leaves);
    for (int k = 0; k < 16; k++) ITEM_OF(f, k) = g->pool[ITEM_OF(at_f, k)], ITEM_OF(h, k) = g->pool[ITEM_OF(at_h, k)];
    EACH_BIT(k, left_tile) {
        int base = ITEM_OF(w->image, k) * g->tiles_x * g->tiles_y;
        ITEM_OF(f, k) = pixel(g->map, g->pool, base, g->tiles_x, ITEM_OF(fx, k), ITEM_OF(fy, k));
        ITEM_OF(h, k) = pixel(g->map, g->pool, base, g->tiles_x, ITEM_OF(gx, k), ITEM_OF(gy, k));
    }
    int16 row = w->own * TILE + ((w->at >> 4) & 15);
    EACH_BIT(k, lane_bits(w->alive & (w->ay == 1))) g->seeds[ITEM_OF(row, k)] &= (ushort)~(1u << (ITEM_OF(w->at, k) & 15));

    int16 in_f = f < w->level, in_h = h < w->level, saddle = in_h & ~in_f;
    int16 right = in_h & (in_f | (w->ql + w->qr + f + h + 2 < 4 * w->level)), left = ~(in_f | right), on = ~(right | left);
    float16 a = convert_float16(w->ql), b = convert_float16(w->qr), c = convert_float16(h), d = convert_float16(f);
    int16 creased = w->alive & ~saddle & (w->quantum > 0.0f) & CREASED(a, b, c, d, w->quantum);
    int16 cell_x = min(w->lx, gx), cell_y = min(w->ly, gy), was_x = w->ax, was_y = w->ay;

    w->ql = (w->ql & left) | (h & right) | (f & on);
    w->qr = (w->qr & right) | (f & left) | (h & on);
    w->lx += (was_x & ~left) + (was_y & right), w->ly += (was_y & ~left) - (was_x & right);
    w->at += (ahead & ~left) + (across & right);
    w->ax = (was_y & right) - (was_y & left) + (was_x & on);
    w->ay = (was_x & left) - (was_x & right) + (was_y & on);
    EACH_BIT(k, left_tile) {
        int x = ITEM_OF(w->lx, k), y = ITEM_OF(w->ly, k);
        int key = (ITEM_OF(w->image, k) * g->tiles_y + (y >> 4)) * g->tiles_x + (x >> 4);
        ITEM_OF(w->at, k) = g->map[key] * PIXELS + (y & 15) * TILE + (x & 15), ITEM_OF(w->own, k) = g->number[key];
        fetch_tile(g, key);
        fetch_tile(g, key + ITEM_OF(w->ax, k) + ITEM_OF(w->ay, k) * g->tiles_x); /* likely the next one */
    }

    int16 back = w->ay < w->ax; /* places are counted from the lower pixel of an edge, so that every cell finds the same */
    float16 p = convert_float16(select(w->ql, w->qr, back) - w->level) + 0.5f;
    float16 q = convert_float16(select(w->qr, w->ql, back) - w->level) + 0.5f, part = p / (p - q), none = (float16)0.0f;
    float16 x = convert_float16(w->lx + (w->ay & back)) + select(none, part, w->ay != 0);
    float16 y = convert_float16(w->ly - (w->ax & back)) + select(none, part, w->ax != 0);
    EACH_BIT(k, lane_bits(creased))
        look_for_corner(w, g, k, ITEM_OF(cell_x, k), ITEM_OF(cell_y, k), edge_behind(ITEM_OF(was_x, k), ITEM_OF(was_y, k)),
                        edge_behind(ITEM_OF(w->ax, k), ITEM_OF(w->ay, k)) ^ 2, &x, &y);

    w->steps += 1;
    int16 home = (w->lx == w->start_x) & (w->ly == w->start_y) & (w->ay == 1) & (w->all == 0);
    w->all = select(w->all, w->steps, home);
    int16 ends = w->alive & (w->all != 0) & (w->steps >= w->all + w->begun); /* begun 0: the seed stays the start */
    int16 goes_on = w->alive & ~ends;
    feed_lanes(w, g, x, y, goes_on);
    EACH_BIT(k, lane_bits(goes_on & (w->begun == 0) & (w->sleeve.count > 1))) { /* start again at the point just kept */
        ITEM_OF(w->begun, k) = ITEM_OF(w->steps, k);
        g->points[w->place[k]] = (float2)(FLOAT_OF(w->sleeve.anchor_x, k), FLOAT_OF(w->sleeve.anchor_y, k));
        ITEM_OF(w->sleeve.count, k) = 1;
    }
    EACH_BIT(k, lane_bits(ends)) end_loop(w, g, k);
}

/* As follow_contours, of all images: a work-item takes every get_global_size-th of them, from the last on, sixteen at a time. */
__kernel void follow_lanes(__global const int *map, __global const short *pool, int tiles_x, int tiles_y, int layers,
                           int2 levels, __global ushort *seeds, __global const int *stored,
                           __global const int *begin, __global const int *number, __global const int *place,
                           __global const int *loop_place, __global const uchar *mode, float tolerance, float spacing,
                           float2 quantum, __global float2 *points, __global int *next, __global int *loop_of,
                           __global int *loop_end, __global int4 *totals, int images)
{
    Ground g = {map, pool, tiles_x, tiles_y, layers, levels.x, levels.y, seeds, stored, begin, number, place, loop_place, mode, tolerance, spacing,
                quantum.x, quantum.y, points, next, loop_of, loop_end, totals,
                images - 1 - (int)get_global_id(0), (int)get_global_size(0)};
    Walks w;
    w.alive = (int16)0, w.image = (int16)-1, w.lx = w.ly = w.ax = w.ay = w.at = w.own = w.ql = w.qr = w.level = (int16)0;
    w.all = w.begun = w.steps = w.start_x = w.start_y = (int16)0;
    w.quantum = (float16)0.0f;
    w.sleeve.late = w.sleeve.wide = w.sleeve.count = (int16)0;
    w.sleeve.tolerance = w.sleeve.spacing = w.sleeve.farthest = w.sleeve.anchor_x = w.sleeve.anchor_y = (float16)0.0f;
    for (int k = 0; k < 16; k++) {
        w.next[k] = w.end[k] = 0;
        if (next_loop(&w, &g, k)) ITEM_OF(w.alive, k) = -1;
    }
    while (lane_bits(w.alive)) step_lanes(&w, &g);
}
#endif
