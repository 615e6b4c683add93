/* Decimation of a contour while it is followed. */

/* Keeps a point only where the ones before it no longer lie within `tolerance` of a chord from the last kept point. */
typedef struct {
    float2 anchor, last, left, right; /* left, right: the cone of chords that is still allowed; their lengths say nothing */
    float tolerance, spacing, farthest;
    int wide, late; /* wide: no cone yet; late: the cone broke before the spacing was reached */
    int count;
} Sleeve;

INLINE void keep(Sleeve *s, float2 p, __global float2 *out)
{
    out[s->count++] = p;
    s->anchor = p;
    s->farthest = 0.0f;
    s->wide = 1;
    s->late = 0;
}

/* Whether a chord to p passes all points since the anchor; narrows the cone if so. */
INLINE int fits(Sleeve *s, float2 p)
{
    float2 d = p - s->anchor;
    float far2 = d.x * d.x + d.y * d.y, far = sqrt(far2), sine = s->tolerance;
    if (far <= s->tolerance) return s->farthest <= 2.0f * s->tolerance;
    if (!s->wide && (cross2(s->right, d) < 0.0f || cross2(d, s->left) < 0.0f || d.x * (s->left.x + s->right.x) + d.y * (s->left.y + s->right.y) < 0.0f))
        return 0;
    if (far < s->farthest - s->tolerance) return 0;
    float cosine = sqrt(far2 - sine * sine); /* both times the distance */
    float2 l = (float2)(d.x * cosine - d.y * sine, d.x * sine + d.y * cosine);
    float2 r = (float2)(d.x * cosine + d.y * sine, d.y * cosine - d.x * sine);
    if (s->wide || cross2(l, s->left) > 0.0f) s->left = l;
    if (s->wide || cross2(s->right, r) > 0.0f) s->right = r;
    s->wide = 0;
    s->farthest = GREATER(s->farthest, far);
    return 1;
}

INLINE void feed(Sleeve *s, float2 p, __global float2 *out)
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
    float t = clamp(dot(p - a, d) / GREATER(dot(d, d), 1e-12f), 0.0f, 1.0f);
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
