/* The reality's brake corner, compiled: the maths of the Python modules beside
 * it, one lane after another. Chains are eliminated before the lumps, where
 * Python solves for all nodes at once; a test holds both together for every
 * effect. */
#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030B0000
#endif
#include <Python.h>
#include <stdlib.h>

#include "_reality_paths.h"

#define STEPS_A_SLICE 512

/* -- one implicit step -------------------------------------------------- */

/* columns: right-hand side and the responses to unit flows at the ports */
static void solve_chain(int n, const double *link, double *diagonal,
                        double x[MAX_NODES][1 + PORTS])
{
    for (int i = 1; i < n; i++) {
        double w = link[i - 1] / diagonal[i - 1];
        diagonal[i] -= w * link[i - 1];
        for (int k = 0; k < 1 + PORTS; k++)
            x[i][k] += w * x[i - 1][k];
    }
    double inverse = 1.0 / diagonal[n - 1];
    for (int k = 0; k < 1 + PORTS; k++)
        x[n - 1][k] *= inverse;
    for (int i = n - 2; i >= 0; i--) {
        inverse = 1.0 / diagonal[i];
        for (int k = 0; k < 1 + PORTS; k++)
            x[i][k] = (x[i][k] + link[i] * x[i + 1][k]) * inverse;
    }
}

/* symmetric positive definite: no pivoting needed */
static void solve_lumps(double m[LUMPS][LUMPS], double *x)
{
    for (int i = 0; i < LUMPS; i++)
        for (int j = i + 1; j < LUMPS; j++) {
            double w = m[j][i] / m[i][i];
            if (w == 0.0)
                continue;
            for (int k = i + 1; k < LUMPS; k++)
                m[j][k] -= w * m[i][k];
            x[j] -= w * x[i];
        }
    for (int i = LUMPS - 1; i >= 0; i--) {
        for (int k = i + 1; k < LUMPS; k++)
            x[i] -= m[i][k] * x[k];
        x[i] /= m[i][i];
    }
}

static double euler(const Corner *c, const State *s, const Paths *h,
                    const double *in, double dt, State *out)
{
    const int n = c->nodes, surface = c->surface;
    const int ports[PORTS] = {0, surface, n - 1};
    const double ambient = in[IN_AMBIENT_K];
    double x[SIDES][MAX_NODES][1 + PORTS];
    double matrix[LUMPS][LUMPS], lump_x[LUMPS];

    for (int i = 0; i < LUMPS; i++) {
        double gain = -h->lump_out[i] * (s->lump_t[i] - ambient);
        if (i == BODY)
            gain += h->body_gain;
        for (int k = 0; k < LUMPS; k++) {
            gain -= h->between[i][k] * s->lump_t[k];
            matrix[i][k] = dt * h->between[i][k];
        }
        matrix[i][i] += h->lump_capacity[i] + dt * h->lump_out[i];
        lump_x[i] = dt * gain;
    }
    for (int side = 0; side < SIDES; side++) {
        const double *t = s->t[side];
        double scaled[MAX_NODES], diagonal[MAX_NODES];
        memset(x[side], 0, sizeof(double) * (1 + PORTS) * (size_t)n);
        for (int i = 0; i < n; i++) {
            diagonal[i] = h->capacity[side][i];
            x[side][i][0] = dt * h->source[side][i];
        }
        for (int i = 0; i + 1 < n; i++) {
            double flow = dt * h->link[side][i] * (t[i + 1] - t[i]);
            scaled[i] = dt * h->link[side][i];
            diagonal[i] += scaled[i];
            diagonal[i + 1] += scaled[i];
            x[side][i][0] += flow;
            x[side][i + 1][0] -= flow;
        }
        diagonal[surface] += dt * h->surface_out[side];
        x[side][surface][0] -=
            dt * h->surface_out[side] * (t[surface] - ambient);
        for (int q = 0; q < PORTS; q++) {
            const double *k = h->coupling[PORTS * side + q];
            int at = ports[q];
            x[side][at][1 + q] = 1.0;
            for (int i = 0; i < LUMPS; i++) {
                if (k[i] == 0.0)
                    continue;
                double flow = dt * k[i] * (s->lump_t[i] - t[at]);
                diagonal[at] += dt * k[i];
                matrix[i][i] += dt * k[i];
                x[side][at][0] += flow;
                lump_x[i] -= flow;
            }
        }
        solve_chain(n, scaled, diagonal, x[side]);
        /* Schur complement of this chain in the lumps */
        for (int q = 0; q < PORTS; q++) {
            const double *kq = h->coupling[PORTS * side + q];
            for (int i = 0; i < LUMPS; i++) {
                if (kq[i] == 0.0)
                    continue;
                double a = dt * kq[i];
                lump_x[i] += a * x[side][ports[q]][0];
                for (int r = 0; r < PORTS; r++) {
                    const double *kr = h->coupling[PORTS * side + r];
                    double b = a * dt * x[side][ports[q]][1 + r];
                    for (int j = 0; j < LUMPS; j++)
                        matrix[i][j] -= b * kr[j];
                }
            }
        }
    }
    solve_lumps(matrix, lump_x);

    double lost = h->heat_in - h->body_gain;
    for (int side = 0; side < SIDES; side++) {
        double flow[PORTS];
        for (int q = 0; q < PORTS; q++) {
            flow[q] = 0.0;
            for (int i = 0; i < LUMPS; i++)
                flow[q] += dt * h->coupling[PORTS * side + q][i] * lump_x[i];
        }
        for (int i = 0; i < n; i++) {
            double rise = x[side][i][0];
            for (int q = 0; q < PORTS; q++)
                rise += x[side][i][1 + q] * flow[q];
            out->t[side][i] = s->t[side][i] + rise;
            out->e[side][i] = s->e[side][i] + h->capacity[side][i] * rise;
            lost -= h->source[side][i];
        }
        lost += h->surface_out[side] * (out->t[side][surface] - ambient);
        out->pad_m[side] = s->pad_m[side];
    }
    for (int i = 0; i < LUMPS; i++) {
        out->lump_t[i] = s->lump_t[i] + lump_x[i];
        out->lump_e[i] = s->lump_e[i] + h->lump_capacity[i] * lump_x[i];
        lost += h->lump_out[i] * (out->lump_t[i] - ambient);
    }
    settle(c, out);
    return dt * lost;
}

/* -- linings change one way --------------------------------------------- */

static double pyrolyse(const Corner *c, State *s, double dt)
{
    double total = 0.0;
    for (int side = 0; side < SIDES; side++)
        for (int i = 0; i < c->pads; i++) {
            double *done = &s->charred[side][i];
            double *t = &s->t[side][1 + i];
            double rate = PYROLYSIS_RATE_S * exp(-PYROLYSIS_ACTIVATION_K / *t);
            double reacted = -(1.0 - *done) * expm1(-rate * dt);
            double kg = pad_kg(c, s, side, i);
            double taken = c->p.pad_pyrolysis * PYROLYSIS_J_KG * kg * reacted;
            *done += reacted;
            s->e[side][1 + i] -= taken;
            *t -= taken / (kg * lining_cp(&c->p, *t));
            total += taken;
        }
    return total;
}

static double wear(const Corner *c, State *s, double friction_j)
{
    const Parameters *p = &c->p;
    double total = 0.0;
    for (int side = 0; side < SIDES; side++) {
        double *e = s->e[side] + 1;
        double front = s->t[side][c->surface - 1];
        double above = fmax(front - WEAR_RISE_FROM_K, 0.0);
        double loss_m = p->pad_wear * WEAR_M_PER_J * friction_j
                        * exp(fmin(above, WEAR_RISE_MOST_K) / WEAR_RISE_K);
        loss_m = fmin(loss_m, fmax(s->pad_m[side] - LAST_M, 0.0));
        double kg = p->pad_density_kg_m3 * p->pad_area_m2 * loss_m;
        double brought = 0.0;
        double old[MAX_NODES];
        for (int i = 0; i < c->pads; i++)
            old[i] = e[i] / pad_kg(c, s, side, i);
        for (int i = 0; i < c->pads; i++) {
            double face = i + 1 < c->pads ? i + 0.5 : c->pads - 1;
            double carried = face / (c->pads - 1) * kg * old[i];
            e[i] += brought - carried;
            brought = carried;
        }
        total += brought;
        s->pad_m[side] -= loss_m;
        for (int i = 0; i < c->pads; i++)
            s->t[side][1 + i] = lining_t(p, e[i] / pad_kg(c, s, side, i),
                                         s->t[side][1 + i]);
    }
    return total;
}

static double friction_factor(const Corner *c, const State *s, double v,
                              double pressure)
{
    const Parameters *p = &c->p;
    int j = c->surface;
    double t = (s->t[0][j - 1] + s->t[0][j] + s->t[1][j - 1] + s->t[1][j])
               / 4;
    double fade = 1.0
                  - FADE_DEPTH * p->friction_fade
                        / (1.0 + exp((FADE_CENTRE_K - t) / FADE_WIDTH_K));
    double speed = (v - REFERENCE_SPEED_MS) / (v + REFERENCE_SPEED_MS);
    double press = (pressure - REFERENCE_PRESSURE_PA)
                   / (pressure + 2 * REFERENCE_PRESSURE_PA);
    double bedded = s->friction_j / (s->friction_j + BEDDING_J);
    return fmax(fade * (1.0 - SPEED_FALL * p->friction_speed * speed)
                    * (1.0 - PRESSURE_FALL * p->friction_pressure * press)
                    * (1.0 - BEDDING_FALL * p->friction_history * bedded),
                LEAST_FACTOR);
}

static void step(const Corner *c, State *s, const double *in, double dt,
                 double *gained, double *lost)
{
    Paths paths;
    State whole, half, fine;
    find_paths(c, s, in, &paths);
    double out_whole = euler(c, s, &paths, in, dt, &whole);
    double out_first = euler(c, s, &paths, in, dt / 2, &half);
    find_paths(c, &half, in, &paths);
    double out_second = euler(c, &half, &paths, in, dt / 2, &fine);
    for (int side = 0; side < SIDES; side++)
        for (int i = 0; i < c->nodes; i++) {
            s->t[side][i] = fine.t[side][i];
            s->e[side][i] = 2 * fine.e[side][i] - whole.e[side][i];
        }
    for (int i = 0; i < LUMPS; i++) {
        s->lump_t[i] = fine.lump_t[i];
        s->lump_e[i] = 2 * fine.lump_e[i] - whole.lump_e[i];
    }
    settle(c, s);
    double in_j = dt * paths.heat_in;
    double out_j = 2 * (out_first + out_second) - out_whole;
    s->friction_j += in_j;
    if (c->p.pad_pyrolysis != 0.0)
        out_j += pyrolyse(c, s, dt);
    if (c->p.pad_wear != 0.0)
        out_j += wear(c, s, in_j);
    *gained += in_j;
    *lost += out_j;
}

/* -- a batch ------------------------------------------------------------ */

typedef struct {
    Py_ssize_t lanes, steps, per_car;
    int varies;
    const Corner *corners;
    State *states;
    const double *step_s, *rows;
    const unsigned char *keep;
    double *record, *power, *friction, *ledger;
    double *now;
} Batch;

static void share_demand(Batch *b, const double *factors)
{
    for (Py_ssize_t car = 0; car + b->per_car <= b->lanes; car += b->per_car) {
        double demanded = 0.0, reached = 0.0;
        for (Py_ssize_t i = car; i < car + b->per_car; i++) {
            demanded += b->now[i * INPUTS + IN_POWER_W] / factors[i];
            reached += b->now[i * INPUTS + IN_POWER_W];
        }
        double scale = reached > 0.0 ? demanded / reached : 1.0;
        for (Py_ssize_t i = car; i < car + b->per_car; i++) {
            b->now[i * INPUTS + IN_POWER_W] *= scale;
            b->now[i * INPUTS + IN_PRESSURE_PA] *= scale;
        }
    }
}

static void advance(Batch *b, Py_ssize_t i)
{
    double *factors = b->now + b->lanes * INPUTS;
    for (Py_ssize_t lane = 0; lane < b->lanes; lane++) {
        double *in = b->now + lane * INPUTS;
        for (int k = 0; k < INPUTS; k++)
            in[k] = b->rows[(i * INPUTS + k) * b->lanes + lane];
        factors[lane] = 1.0;
        if (b->varies) {
            factors[lane] = friction_factor(&b->corners[lane],
                                            &b->states[lane], in[IN_SPEED_MS],
                                            in[IN_PRESSURE_PA]);
            in[IN_POWER_W] *= factors[lane];
        }
    }
    if (b->varies && b->per_car)
        share_demand(b, factors);
    for (Py_ssize_t lane = 0; lane < b->lanes; lane++) {
        const double *in = b->now + lane * INPUTS;
        b->friction[i * b->lanes + lane] = factors[lane];
        b->power[i * b->lanes + lane] = in[IN_POWER_W];
        step(&b->corners[lane], &b->states[lane], in, b->step_s[i],
             &b->ledger[lane], &b->ledger[b->lanes + lane]);
    }
    if (!b->keep[i])
        return;
    for (Py_ssize_t lane = 0; lane < b->lanes; lane++) {
        const State *s = &b->states[lane];
        int n = b->corners[lane].nodes;
        for (int side = 0; side < SIDES; side++) {
            memcpy(b->record, s->t[side], sizeof(double) * (size_t)n);
            b->record += n;
        }
        memcpy(b->record, s->lump_t, sizeof s->lump_t);
        b->record += LUMPS;
    }
}

static int run(Batch *b)
{
    int interrupted = 0;
    for (Py_ssize_t i = 0; i < b->steps && !interrupted;) {
        Py_ssize_t end = i + STEPS_A_SLICE;
        if (end > b->steps)
            end = b->steps;
        Py_BEGIN_ALLOW_THREADS
        for (; i < end; i++)
            advance(b, i);
        Py_END_ALLOW_THREADS
        interrupted = PyErr_CheckSignals();
    }
    return interrupted;
}

enum { CORNERS, STEP, KEEP, ROWS, STATE, RECORD, POWERS, FRICTION, LEDGER,
       BUFFERS };

static int check_sizes(const Py_buffer *v, Py_ssize_t lanes, Py_ssize_t steps)
{
    const Py_ssize_t word = sizeof(double);
    const Corner *const corners = v[CORNERS].buf;
    Py_ssize_t kept = 0, nodes = lanes ? corners->nodes : 0;
    for (Py_ssize_t lane = 0; lane < lanes; lane++)
        if (corners[lane].nodes != nodes || nodes > MAX_NODES || nodes < 3
            || corners[lane].pads < 2 || corners[lane].cheeks < 1
            || corners[lane].surface != corners[lane].pads + 1
            || corners[lane].surface + corners[lane].cheeks != nodes)
            nodes = -1;
    for (Py_ssize_t i = 0; i < v[KEEP].len; i++)
        kept += ((const unsigned char *)v[KEEP].buf)[i] != 0;
    const Py_ssize_t wanted[BUFFERS] = {
        nodes < 0 ? 0 : lanes * (Py_ssize_t)sizeof(Corner), steps * word,
        steps, steps * INPUTS * lanes * word,
        lanes * (Py_ssize_t)sizeof(State),
        kept * lanes * (SIDES * nodes + LUMPS) * word, steps * lanes * word,
        steps * lanes * word, 2 * lanes * word,
    };
    for (int i = 0; i < BUFFERS; i++)
        if (v[i].len != wanted[i]) {
            PyErr_Format(PyExc_ValueError,
                         "argument %d has %zd bytes instead of %zd", i + 1,
                         v[i].len, wanted[i]);
            return -1;
        }
    return 0;
}

PyDoc_STRVAR(march_doc,
"march(corners, step_s, keep, rows, state, record, power, friction, ledger,\n"
"      varies, corners_per_car)\n--\n\n"
"March a batch in place; buffers are described in compiled.py.");

static PyObject *march(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer v[BUFFERS];
    Batch b = {0};
    PyObject *result = NULL;
    if (!PyArg_ParseTuple(args, "y*y*y*y*w*w*w*w*w*pn", &v[CORNERS], &v[STEP],
                          &v[KEEP], &v[ROWS], &v[STATE], &v[RECORD],
                          &v[POWERS], &v[FRICTION], &v[LEDGER], &b.varies,
                          &b.per_car))
        return NULL;
    b.steps = v[KEEP].len;
    b.lanes = v[CORNERS].len / (Py_ssize_t)sizeof(Corner);
    b.now = calloc((size_t)b.lanes * (INPUTS + 1), sizeof(double));
    b.corners = v[CORNERS].buf;
    b.states = v[STATE].buf;
    b.step_s = v[STEP].buf;
    b.rows = v[ROWS].buf;
    b.keep = v[KEEP].buf;
    b.record = v[RECORD].buf;
    b.power = v[POWERS].buf;
    b.friction = v[FRICTION].buf;
    b.ledger = v[LEDGER].buf;
    if (b.now == NULL)
        PyErr_NoMemory();
    else if (!check_sizes(v, b.lanes, b.steps) && !run(&b))
        result = Py_NewRef(Py_None);
    free(b.now);
    for (int i = 0; i < BUFFERS; i++)
        PyBuffer_Release(&v[i]);
    return result;
}

static PyMethodDef methods[] = {
    {"march", march, METH_VARARGS, march_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT,
    .m_name = "_reality",
    .m_doc = PyDoc_STR("The reality's brake corner, compiled."),
    .m_size = 0,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__reality(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL
        && PyModule_AddStringConstant(made, "SOURCES", BSTM_SOURCES) < 0)
        Py_CLEAR(made);
    return made;
}
