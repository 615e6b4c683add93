/* Running sums. */

/* Along each row. */
__kernel void sum_rows(__global int *wind, int tiles_x)
{
    __global int *row = wind + (int)get_global_id(0) * tiles_x;
    int w = 0;
    for (int tx = 0; tx < tiles_x; tx++) row[tx] = w += row[tx];
}

/* start[i] is the sum of the n counts before i, so is what stands in place of each count afterwards; start[n] and total: of all.
 * For one work-item; on a GPU for a group of 64 that takes as many stretches. */
__kernel void sum_counts(int n, __global int *count, __global int *start, __global long *total)
{
    int each = (n + LANES - 1) / LANES, first = min(LANE * each, n), last = min(first + each, n);
    long sum = 0;
#ifdef WIDE
    __local long of[LANES];
    for (int i = first; i < last; i++) sum += count[i];
    of[LANE] = sum;
    SYNC;
    sum = 0;
    for (int k = 0; k < LANE; k++) sum += of[k];
#endif
    for (int i = first; i < last; i++) {
        int here = count[i];
        start[i] = count[i] = (int)sum;
        sum += here;
    }
    if (LANE == LANES - 1) start[n] = (int)sum, *total = sum;
}
