/* The compiled step of a thermal network (see model/thermal/reference.py, which
 * does the same operations in the same order).
 *
 * Knows nodes, links, sources, memories; knows nothing of brakes. Members of
 * a batch are marched side by side in blocks of LANES, of SOME, of FEW (the
 * corners of a car), or alone; all give the same bits (no contraction, no
 * reassociation).
 */
#include "march.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LANES 16
#define SOME 8
#define FEW 4
/* Four doubles at a time where the processor can: each lane rounds the same. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
#define INLINE static inline __attribute__((always_inline))

/* Sets `to` to `value`, an expression in the lane l, in all W lanes. Every
 * lane is read before one is written: without that the compiler must assume
 * that they overlap, and does them one by one. */
#define SET(to, value)                                          \
    do {                                                        \
        double lane_[LANES];                                    \
        double *const to_ = (to);                               \
        for (int l = 0; l < W; l++) lane_[l] = (value);         \
        for (int l = 0; l < W; l++) to_[l] = lane_[l];          \
    } while (0)

typedef struct {
    double *floats;               /* [floats][W] */
    double *slots;                /* [nodes + memories + inputs][W] */
    double *state;                /* [nodes + memories][W] */
    double *factor;               /* [factors][W] */
    double *base, *capacity;      /* [nodes][W] */
    double *rate, *free_mask;     /* [nodes][W] */
    double *g, *heat, *heat2;     /* [links], [sources] x W */
    double *flow, *energy1;       /* [links][W] */
    double *value1, *value2;      /* [memories][W] */
    double *diagonal, *off;       /* [nodes], [entries] x W */
    double *x1, *x2;              /* [nodes][W] */
    double *ledger;               /* [links + sources][W] */
    int *fixed;                   /* [nodes]: whether it is in any lane */
} Work;

int bstm_within(const int32_t *values, int n, int low, int high)
{
    for (int i = 0; i < n; i++)
        if (values[i] < low || values[i] >= high) return 0;
    return 1;
}

static int rising(const int32_t *values, int n, int last)
{
    if (values[0] != 0 || values[n - 1] != last) return 0;
    for (int i = 1; i < n; i++)
        if (values[i] < values[i - 1]) return 0;
    return 1;
}

const char *bstm_parse(Structure *s, const int32_t *ints, ptrdiff_t length)
{
    if (length < COUNTS) return "ints is shorter than its header";
    for (int i = 0; i < COUNTS; i++) {
        s->count[i] = ints[i];
        if (ints[i] < 0) return "a count is negative";
        /* sums of a few of them must fit into an int */
        if (ints[i] > INT32_MAX / 16) return "a count is too large";
    }
    if (s->count[COUNT_LAYOUT] != LAYOUT_VERSION)
        return "ints has another layout version";
    const int n = s->count[COUNT_NODES], nm = s->count[COUNT_MEMORIES];
    const int nl = s->count[COUNT_LINKS], ns = s->count[COUNT_SOURCES];
    const int nf = s->count[COUNT_FACTORS], nt = s->count[COUNT_TABLES];
    const int ne = s->count[COUNT_ENTRIES], np = s->count[COUNT_PIVOTS];
    const int no = s->count[COUNT_OPERATIONS], nu = s->count[COUNT_USES];
    const int parts = n + nl + ns + nm;
    const int expected[SECTIONS] = {
        n, n, n, nl, nl, nl, ns, nm, parts + 1, nu, nf, nf, nf, nf, nf,
        nt, nt, np, np + 1, np + 1, ne, no, no, no};
    ptrdiff_t position = COUNTS;
    for (int i = 0; i < SECTIONS; i++) {
        if (position >= length || ints[position] != expected[i]
            || length - position - 1 < expected[i])
            return "a section has the wrong length";
        s->section[i] = ints + position + 1;
        position += 1 + expected[i];
    }
    const int32_t *const *sec = s->section;
    const int slots = n + nm + s->count[COUNT_INPUTS];
    int good = bstm_within(sec[NODE_TABLE], n, -1, nt)
        && bstm_within(sec[NODE_INPUT], n, -1, s->count[COUNT_INPUTS])
        && bstm_within(sec[LINK_A], nl, 0, n) && bstm_within(sec[LINK_B], nl, 0, n)
        && bstm_within(sec[LINK_ENTRY], nl, -1, ne)
        && bstm_within(sec[SOURCE_NODE], ns, 0, n)
        && bstm_within(sec[MEMORY_KIND], nm, 0, 2)
        && rising(sec[USE_START], parts + 1, nu)
        && bstm_within(sec[USE_FACTOR], nu, 0, nf)
        && bstm_within(sec[FACTOR_KIND], nf, 0, 4)
        && bstm_within(sec[FACTOR_A], nf, 0, slots)
        && bstm_within(sec[FACTOR_B], nf, 0, slots)
        && bstm_within(sec[FACTOR_TABLE], nf, -1, nt)
        && bstm_within(sec[PIVOT_NODE], np, 0, n)
        && rising(sec[PIVOT_ENTRY_START], np + 1, ne)
        && rising(sec[PIVOT_OPERATION_START], np + 1, no)
        && bstm_within(sec[ENTRY_ROW], ne, 0, n)
        && bstm_within(sec[OPERATION_LEFT], no, 0, ne)
        && bstm_within(sec[OPERATION_RIGHT], no, 0, ne)
        && bstm_within(sec[OPERATION_TARGET], no, -n, ne);
    if (!good) return "an index is out of range";
    for (int t = 0; t < nt; t++) {
        const int points = sec[TABLE_POINTS][t], at = sec[TABLE_OFFSET][t];
        if (points < 2 || at < 0
            || (int64_t)at + 2 + points > s->count[COUNT_FLOATS])
            return "a table is out of range";
    }
    if ((int64_t)n + nl + ns + 3 * (int64_t)nm > s->count[COUNT_FLOATS])
        return "floats is too short";
    return NULL;
}

static size_t work_doubles(const Structure *s)
{
    const size_t n = s->count[COUNT_NODES], nm = s->count[COUNT_MEMORIES];
    const size_t nl = s->count[COUNT_LINKS], ns = s->count[COUNT_SOURCES];
    return s->count[COUNT_FLOATS] + (n + nm + s->count[COUNT_INPUTS])
        + (n + nm) + s->count[COUNT_FACTORS] + 7 * n + 3 * nl + 2 * ns
        + 2 * nm + s->count[COUNT_ENTRIES] + (nl + ns) + n;
}

static void work_layout(Work *w, const Structure *s, double *at, int W)
{
    const size_t n = s->count[COUNT_NODES], nm = s->count[COUNT_MEMORIES];
    const size_t nl = s->count[COUNT_LINKS], ns = s->count[COUNT_SOURCES];
#define TAKE(field, size) (w->field = at, at += (size_t)(size) * W)
    TAKE(floats, s->count[COUNT_FLOATS]);
    TAKE(slots, n + nm + s->count[COUNT_INPUTS]);
    TAKE(state, n + nm);
    TAKE(factor, s->count[COUNT_FACTORS]);
    TAKE(base, n); TAKE(capacity, n); TAKE(rate, n); TAKE(free_mask, n);
    TAKE(diagonal, n); TAKE(x1, n); TAKE(x2, n);
    TAKE(g, nl); TAKE(flow, nl); TAKE(energy1, nl);
    TAKE(heat, ns); TAKE(heat2, ns);
    TAKE(value1, nm); TAKE(value2, nm);
    TAKE(off, s->count[COUNT_ENTRIES]);
    TAKE(ledger, nl + ns);
    w->fixed = (int *)at;
#undef TAKE
}

INLINE void look_up(const int W, const double *restrict f, int offset,
                    int points, const double *restrict x, double *restrict y)
{
    const double *values = f + (size_t)(offset + 2) * W;
    for (int l = 0; l < W; l++) {
        double position =
            (x[l] - f[(size_t)offset * W + l]) * f[(size_t)(offset + 1) * W + l];
        if (!(position > 0.0)) position = 0.0;
        if (position > (double)(points - 1)) position = (double)(points - 1);
        int index = (int)position;
        if (index > points - 2) index = points - 2;
        const double left = values[(size_t)index * W + l];
        const double right = values[(size_t)(index + 1) * W + l];
        y[l] = left + (position - (double)index) * (right - left);
    }
}

INLINE void evaluate(const int W, const Structure *s, Work *w, int first)
{
    const int32_t *const *sec = s->section;
    double x[LANES];
    for (int j = 0; j < s->count[COUNT_FACTORS]; j++) {
        if (!first && sec[FACTOR_STEADY][j]) continue;
        const double *restrict a = w->slots + (size_t)sec[FACTOR_A][j] * W;
        const double *restrict b = w->slots + (size_t)sec[FACTOR_B][j] * W;
        double *restrict y = w->factor + (size_t)j * W;
        switch (sec[FACTOR_KIND][j]) {
        case DRIVER_VALUE: SET(x, a[l]); break;
        case DRIVER_DIFFERENCE: SET(x, a[l] - b[l]); break;
        case DRIVER_MEAN: SET(x, 0.5 * (a[l] + b[l])); break;
        default: SET(x, (a[l] * a[l] + b[l] * b[l]) * (a[l] + b[l]));
        }
        const int table = sec[FACTOR_TABLE][j];
        if (table < 0)
            SET(y, x[l]);
        else
            look_up(W, w->floats, sec[TABLE_OFFSET][table],
                    sec[TABLE_POINTS][table], x, y);
    }
}

INLINE void product(const int W, const Structure *s, const Work *w, int part,
                    int constant, double *restrict y)
{
    const int32_t *start = s->section[USE_START];
    const double *restrict c = w->floats + (size_t)constant * W;
    double x[LANES];
    SET(x, c[l]);
    for (int u = start[part]; u < start[part + 1]; u++) {
        const double *restrict v =
            w->factor + (size_t)s->section[USE_FACTOR][u] * W;
        SET(x, x[l] * v[l]);
    }
    SET(y, x[l]);
}

/* Temperature after the heat capacity * rise [J] has entered a node. */
static double heated(const Structure *s, const double *f, int W, int node,
                     double t, double base, double capacity, double rise)
{
    const int table = s->section[NODE_TABLE][node];
    if (table < 0 || !(base > 0.0)) return t + rise;
    const int last = s->section[TABLE_POINTS][table] - 1;
    const double *v = f + (size_t)(s->section[TABLE_OFFSET][table] + 2) * W;
    const double x0 = v[-2 * W], inverse_dx = v[-1 * W];
    double heat = capacity * rise / base;
    if (isnan(t + heat)) return t + heat;
    const double position = (t - x0) * inverse_dx;
    const int up = heat > 0.0;
    int cell;
    if (position <= 0.0) cell = -1;
    else if (position >= (double)last) cell = last;
    else {
        cell = (int)position;
        if (!up && position == (double)cell) cell -= 1;
    }
    for (;;) {
        if (cell < 0) {
            const double c = v[0];
            if (!up || heat <= c * (x0 - t)) return t + heat / c;
            heat -= c * (x0 - t);
            t = x0;
            cell = 0;
        } else if (cell >= last) {
            const double c = v[(size_t)last * W];
            const double edge = x0 + (double)last / inverse_dx;
            if (up || heat >= c * (edge - t)) return t + heat / c;
            heat -= c * (edge - t);
            t = edge;
            cell = last - 1;
        } else {
            const double here = v[(size_t)cell * W];
            const double slope =
                (v[(size_t)(cell + 1) * W] - here) * inverse_dx;
            const double left = x0 + (double)cell / inverse_dx;
            const double c = here + (t - left) * slope;
            const double edge =
                up ? x0 + (double)(cell + 1) / inverse_dx : left;
            const double to_edge =
                (c + 0.5 * slope * (edge - t)) * (edge - t);
            if (up ? heat <= to_edge : heat >= to_edge)
                return t + 2.0 * heat / (c + sqrt(c * c + 2.0 * slope * heat));
            heat -= to_edge;
            t = edge;
            cell += up ? 1 : -1;
        }
    }
}

INLINE void balance(const int W, const Structure *s, const Work *w,
                    const double *heat, double *restrict net)
{
    const int32_t *const *sec = s->section;
    memset(net, 0, sizeof(double) * (size_t)s->count[COUNT_NODES] * W);
    for (int k = 0; k < s->count[COUNT_LINKS]; k++) {
        const double *restrict q = w->flow + (size_t)k * W;
        double *a = net + (size_t)sec[LINK_A][k] * W;
        double *b = net + (size_t)sec[LINK_B][k] * W;
        SET(a, a[l] - q[l]);
        SET(b, b[l] + q[l]);
    }
    for (int k = 0; k < s->count[COUNT_SOURCES]; k++) {
        double *a = net + (size_t)sec[SOURCE_NODE][k] * W;
        SET(a, a[l] + heat[(size_t)k * W + l]);
    }
}

INLINE void factorise(const int W, const Structure *s, Work *w, double gdt)
{
    const int32_t *const *sec = s->section;
    double *restrict d = w->diagonal, *restrict off = w->off;
    const double *mask = w->free_mask;
    double inverse[LANES];
    memcpy(d, w->capacity, sizeof(double) * s->count[COUNT_NODES] * W);
    memset(off, 0, sizeof(double) * (size_t)s->count[COUNT_ENTRIES] * W);
    for (int k = 0; k < s->count[COUNT_LINKS]; k++) {
        const size_t a = (size_t)sec[LINK_A][k] * W;
        const size_t b = (size_t)sec[LINK_B][k] * W;
        const double *restrict g = w->g + (size_t)k * W;
        SET(d + a, d[a + l] + gdt * g[l]);
        SET(d + b, d[b + l] + gdt * g[l]);
        if (sec[LINK_ENTRY][k] >= 0) {
            double *e = off + (size_t)sec[LINK_ENTRY][k] * W;
            SET(e, e[l] - gdt * g[l] * (mask[a + l] * mask[b + l]));
        }
    }
    for (int i = 0; i < s->count[COUNT_NODES]; i++) {
        if (!w->fixed[i]) continue;
        for (size_t at = (size_t)i * W; at < (size_t)(i + 1) * W; at++)
            d[at] = mask[at] > 0.0 ? d[at] : 1.0;
    }
    for (int p = 0; p < s->count[COUNT_PIVOTS]; p++) {
        double *dp = d + (size_t)sec[PIVOT_NODE][p] * W;
        /* all lanes divide at once, and those by 0, if any, are set right */
        int64_t zeros = 0;
        for (int l = 0; l < W; l++) zeros |= dp[l] == 0.0;
        SET(inverse, 1.0 / dp[l]);
        for (int l = 0; l < W && zeros; l++)
            if (dp[l] == 0.0) inverse[l] = 0.0;
        for (int o = sec[PIVOT_OPERATION_START][p];
             o < sec[PIVOT_OPERATION_START][p + 1]; o++) {
            const double *left = off + (size_t)sec[OPERATION_LEFT][o] * W;
            const double *right = off + (size_t)sec[OPERATION_RIGHT][o] * W;
            const int target = sec[OPERATION_TARGET][o];
            double *y = target >= 0 ? off + (size_t)target * W
                                    : d + (size_t)(-1 - target) * W;
            SET(y, y[l] - left[l] * inverse[l] * right[l]);
        }
        for (int e = sec[PIVOT_ENTRY_START][p];
             e < sec[PIVOT_ENTRY_START][p + 1]; e++)
            SET(off + (size_t)e * W, off[(size_t)e * W + l] * inverse[l]);
        SET(dp, inverse[l]);
    }
}

INLINE void solve(const int W, const Structure *s, const Work *w, double gdt,
                  double sign, double *restrict rhs)
{
    const int32_t *const *sec = s->section;
    const double *mask = w->free_mask, *rate = w->rate;
    const double *off = w->off;
    for (int k = 0; k < s->count[COUNT_LINKS]; k++) {
        if (!w->fixed[sec[LINK_A][k]] && !w->fixed[sec[LINK_B][k]]) continue;
        const size_t a = (size_t)sec[LINK_A][k] * W;
        const size_t b = (size_t)sec[LINK_B][k] * W;
        const double *restrict g = w->g + (size_t)k * W;
        for (int l = 0; l < W; l++) {
            const double c = gdt * g[l] * sign;
            if (!(mask[b + l] > 0.0)) rhs[a + l] += c * rate[b + l];
            if (!(mask[a + l] > 0.0)) rhs[b + l] += c * rate[a + l];
        }
    }
    for (int i = 0; i < s->count[COUNT_NODES]; i++) {
        if (!w->fixed[i]) continue;
        for (size_t at = (size_t)i * W; at < (size_t)(i + 1) * W; at++)
            if (!(mask[at] > 0.0)) rhs[at] = sign * rate[at];
    }
    for (int p = 0; p < s->count[COUNT_PIVOTS]; p++) {
        const double *known = rhs + (size_t)sec[PIVOT_NODE][p] * W;
        for (int e = sec[PIVOT_ENTRY_START][p];
             e < sec[PIVOT_ENTRY_START][p + 1]; e++) {
            double *y = rhs + (size_t)sec[ENTRY_ROW][e] * W;
            SET(y, y[l] - off[(size_t)e * W + l] * known[l]);
        }
    }
    for (int p = s->count[COUNT_PIVOTS] - 1; p >= 0; p--) {
        const size_t node = (size_t)sec[PIVOT_NODE][p] * W;
        double x[LANES];
        SET(x, rhs[node + l] * w->diagonal[node + l]);
        for (int e = sec[PIVOT_ENTRY_START][p];
             e < sec[PIVOT_ENTRY_START][p + 1]; e++) {
            const double *y = rhs + (size_t)sec[ENTRY_ROW][e] * W;
            SET(x, x[l] - off[(size_t)e * W + l] * y[l]);
        }
        SET(rhs + node, x[l]);
    }
}

/* Conductances, sources, memory values and link flows at w->slots. */
INLINE void flows(const int W, const Structure *s, Work *w, double *g,
                  double *heat, double *value)
{
    const int n = s->count[COUNT_NODES], nl = s->count[COUNT_LINKS];
    const int ns = s->count[COUNT_SOURCES];
    for (int k = 0; k < nl; k++) {
        const double *restrict a =
            w->slots + (size_t)s->section[LINK_A][k] * W;
        const double *restrict b =
            w->slots + (size_t)s->section[LINK_B][k] * W;
        double conductance[LANES];
        double *restrict q = w->flow + (size_t)k * W;
        product(W, s, w, n + k, n + k, conductance);
        SET(q, conductance[l] * (a[l] - b[l]));
        if (g != NULL) SET(g + (size_t)k * W, conductance[l]);
    }
    for (int k = 0; k < ns; k++)
        product(W, s, w, n + nl + k, n + nl + k, heat + (size_t)k * W);
    for (int m = 0; m < s->count[COUNT_MEMORIES]; m++)
        product(W, s, w, n + nl + ns + m, n + nl + ns + 3 * m,
                value + (size_t)m * W);
}

INLINE double bounded(const Work *w, int first, int m, int W, int l, double x)
{
    const double lower = w->floats[(size_t)(first + 3 * m + 1) * W + l];
    const double upper = w->floats[(size_t)(first + 3 * m + 2) * W + l];
    if (x < lower) x = lower;
    return x > upper ? upper : x;
}

INLINE void link_energy(const int W, const Structure *s, const Work *w,
                        double gdt, int k, const double *x, double *restrict y)
{
    const double *a = x + (size_t)s->section[LINK_A][k] * W;
    const double *b = x + (size_t)s->section[LINK_B][k] * W;
    const double *restrict g = w->g + (size_t)k * W;
    const double *restrict q = w->flow + (size_t)k * W;
    SET(y, q[l] + gdt * (g[l] * (a[l] - b[l])));
}

/* One step of W members; their inputs are already in w->slots, `same` as in
 * the step before or not; `kept`: whether the ledger is. */
INLINE void step(const int W, const Structure *s, Work *w, double dt, int same,
                 int kept)
{
    const int n = s->count[COUNT_NODES], nm = s->count[COUNT_MEMORIES];
    const int nl = s->count[COUNT_LINKS], ns = s->count[COUNT_SOURCES];
    const int memory_first = n + nl + ns;
    const double gdt = GAMMA * dt, half = 0.5 * dt;
    const int32_t *const *sec = s->section;
    double *slots = w->slots, *state = w->state;

    for (int i = 0; i < n; i++) {
        const int channel = sec[NODE_INPUT][i];
        /* without a boundary it is as in the step before */
        if (same && channel < 0) continue;
        w->fixed[i] = 0;
        for (int l = 0; l < W; l++) {
            const size_t at = (size_t)i * W + l;
            const double target =
                channel < 0 ? NAN : slots[(size_t)(n + nm + channel) * W + l];
            const int gone = isnan(target);
            w->free_mask[at] = gone && sec[NODE_FREE][i] ? 1.0 : 0.0;
            w->rate[at] = gone ? 0.0 : (target - state[at]) / dt;
            if (!(gone && sec[NODE_FREE][i])) w->fixed[i] = 1;
        }
    }

    memcpy(slots, state, sizeof(double) * (size_t)(n + nm) * W);
    evaluate(W, s, w, !same);
    for (int i = 0; i < n; i++) {
        const size_t at = (size_t)i * W;
        product(W, s, w, i, i, w->base + at);
        const int table = sec[NODE_TABLE][i];
        double own[LANES];
        if (table < 0)
            SET(own, 1.0);
        else
            look_up(W, w->floats, sec[TABLE_OFFSET][table],
                    sec[TABLE_POINTS][table], state + at, own);
        SET(w->capacity + at, w->base[at + l] * own[l]);
    }
    flows(W, s, w, w->g, w->heat, w->value1);
    balance(W, s, w, w->heat, w->x1);
    factorise(W, s, w, gdt);
    solve(W, s, w, gdt, 1.0, w->x1);
    for (int k = 0; k < nl && kept; k++)
        link_energy(W, s, w, gdt, k, w->x1, w->energy1 + (size_t)k * W);
    for (int i = 0; i < n; i++) {
        const size_t first = (size_t)i * W;
        double rise[LANES];
        SET(rise, dt * w->x1[first + l]);
        if (!w->fixed[i] && sec[NODE_TABLE][i] < 0) {
            SET(slots + first, state[first + l] + rise[l]);
            continue;
        }
        for (int l = 0; l < W; l++) {
            const size_t at = first + l;
            slots[at] = w->free_mask[at] > 0.0
                ? heated(s, w->floats + l, W, i, state[at], w->base[at],
                         w->capacity[at], rise[l])
                : state[at] + dt * w->rate[at];
        }
    }
    for (int m = 0; m < nm; m++)
        for (int l = 0; l < W; l++) {
            const size_t at = (size_t)(n + m) * W + l;
            const double old = state[at], v = w->value1[(size_t)m * W + l];
            const double x = sec[MEMORY_KIND][m] == MEMORY_INTEGRAL ? old + dt * v
                                                      : (v > old ? v : old);
            slots[at] = bounded(w, memory_first, m, W, l, x);
        }

    evaluate(W, s, w, 0);
    flows(W, s, w, NULL, w->heat2, w->value2);
    balance(W, s, w, w->heat2, w->x2);
    for (size_t at = 0; at < (size_t)n * W; at += W)
        SET(w->x2 + at,
            w->x2[at + l] - 2.0 * (w->capacity[at + l] * w->x1[at + l]));
    solve(W, s, w, gdt, -1.0, w->x2);
    for (int k = 0; k < nl && kept; k++) {
        const size_t at = (size_t)k * W;
        double energy2[LANES];
        link_energy(W, s, w, gdt, k, w->x2, energy2);
        SET(w->ledger + at, w->ledger[at + l]
            + half * (w->energy1[at + l] + energy2[l]));
    }
    for (int k = 0; k < ns && kept; k++) {
        const size_t at = (size_t)k * W;
        double *energy = w->ledger + (size_t)nl * W + at;
        SET(energy,
            energy[l] + half * (w->heat[at + l] + w->heat2[at + l]));
    }
    for (int i = 0; i < n; i++) {
        const size_t first = (size_t)i * W;
        double rise[LANES];
        SET(rise, dt * (1.5 * w->x1[first + l] + 0.5 * w->x2[first + l]));
        if (!w->fixed[i] && sec[NODE_TABLE][i] < 0) {
            SET(state + first, state[first + l] + rise[l]);
            continue;
        }
        for (int l = 0; l < W; l++) {
            const size_t at = first + l;
            state[at] = w->free_mask[at] > 0.0
                ? heated(s, w->floats + l, W, i, state[at], w->base[at],
                         w->capacity[at], rise[l])
                : slots[at];
        }
    }
    for (int m = 0; m < nm; m++)
        for (int l = 0; l < W; l++) {
            const size_t at = (size_t)(n + m) * W + l;
            const double old = state[at], v = w->value2[(size_t)m * W + l];
            const double x = sec[MEMORY_KIND][m] == MEMORY_INTEGRAL
                ? old + half * (w->value1[(size_t)m * W + l] + v)
                : (v > old ? v : old);
            state[at] = bounded(w, memory_first, m, W, l, x);
        }
}

INLINE void gather(const int W, const size_t *member, double *to,
                   const double *from, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (int l = 0; l < W; l++) to[i * W + l] = from[member[l] * n + i];
}

INLINE void scatter(const int W, const size_t *member, double *to,
                    const double *from, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (int l = 0; l < W; l++) to[member[l] * n + i] = from[i * W + l];
}

INLINE void march_block(const int W, const March *m, Work *w, size_t first)
{
    const Structure *s = m->s;
    const size_t ni = s->count[COUNT_INPUTS], ns = s->count[COUNT_SOURCES];
    const size_t states = s->count[COUNT_NODES] + s->count[COUNT_MEMORIES];
    const size_t nl = s->count[COUNT_LINKS], width = m->columns;
    const size_t first_column = m->column, end = first_column + width;
    const size_t floats = s->count[COUNT_FLOATS];
    /* the last member fills the lanes that are left over */
    size_t member[LANES];
    for (int l = 0; l < W; l++)
        member[l] = first + l < (size_t)m->members ? first + l
                                                   : (size_t)m->members - 1;
    gather(W, member, w->floats, m->floats, floats);
    gather(W, member, w->state, m->state, states);
    if (m->ledger) gather(W, member, w->ledger, m->ledger, nl + ns);
    double *out = m->outputs;
    int due = m->phase;
    for (ptrdiff_t t = 0; t < m->steps; t++) {
        const int same = t > 0 && m->rows == 1;
        const double *row =
            m->inputs + (same ? 0 : (size_t)t * m->sets * ni);
        for (int l = 0; l < W && !same; l++) {
            const double *channels = row + (size_t)m->set_of[member[l]] * ni;
            for (size_t c = 0; c < ni; c++)
                w->slots[(states + c) * W + l] = channels[c];
        }
        step(W, s, w, m->dt[m->durations == 1 ? 0 : t], same,
             m->ledger != NULL);
        if (--due == 0) {
            for (int l = 0; l < W; l++) {
                double *to = out + member[l] * width;
                for (size_t i = first_column; i < end; i++)
                    *to++ = i < states ? w->state[i * W + l]
                                       : w->ledger[(nl + i - states) * W + l];
            }
            out += (size_t)m->members * width;
            due = m->every;
        }
    }
    scatter(W, member, m->state, w->state, states);
    if (m->ledger) scatter(W, member, m->ledger, w->ledger, nl + ns);
}

static void march_one(const March *m, Work *w, size_t first)
{
    march_block(1, m, w, first);
}

WIDE static void march_few(const March *m, Work *w, size_t first)
{
    march_block(FEW, m, w, first);
}

WIDE static void march_some(const March *m, Work *w, size_t first)
{
    march_block(SOME, m, w, first);
}

WIDE static void march_lanes(const March *m, Work *w, size_t first)
{
    march_block(LANES, m, w, first);
}

int bstm_march(const March *m)
{
    double *memory = malloc(sizeof(double) * work_doubles(m->s) * LANES);
    if (memory == NULL) return -1;
    Work w;
    size_t first = 0;
    while (first < (size_t)m->members) {
        const size_t left = (size_t)m->members - first;
        /* a single step is mostly spent on filling the lanes */
        const int many = m->steps > 1;
        const int W = left >= LANES || (many && left > LANES - FEW) ? LANES
            : left >= SOME || (many && left > FEW) ? SOME
            : left >= FEW || (many && left > 1) ? FEW : 1;
        work_layout(&w, m->s, memory, W);
        (W == LANES ? march_lanes : W == SOME ? march_some
            : W == FEW ? march_few : march_one)(m, &w, first);
        first += W;
    }
    free(memory);
    return 0;
}
