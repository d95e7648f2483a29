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

#include "_reality_step.h"

#define STEPS_A_SLICE 512

#define NAME(name) #name,
static const char *const parameter_names[] = { PARAMETERS(NAME) };
#define PARAMETER_COUNT ((Py_ssize_t)(sizeof(Parameters) / sizeof(double)))

typedef struct {
    Py_ssize_t lanes, steps, per_car;
    int pads, cheeks, varies;
    Corner *corners;
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
            demanded += b->now[i * INPUTS + POWER] / factors[i];
            reached += b->now[i * INPUTS + POWER];
        }
        double scale = reached > 0.0 ? demanded / reached : 1.0;
        for (Py_ssize_t i = car; i < car + b->per_car; i++) {
            b->now[i * INPUTS + POWER] *= scale;
            b->now[i * INPUTS + PRESSURE] *= scale;
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
                                            &b->states[lane], in[SPEED],
                                            in[PRESSURE]);
            in[POWER] *= factors[lane];
        }
    }
    if (b->varies && b->per_car)
        share_demand(b, factors);
    for (Py_ssize_t lane = 0; lane < b->lanes; lane++) {
        const double *in = b->now + lane * INPUTS;
        b->friction[i * b->lanes + lane] = factors[lane];
        b->power[i * b->lanes + lane] = in[POWER];
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

/* state of a lane in a row: t, lump_t, e, lump_e, pad_m, charred, friction */
static double *move(double *row, double *member, size_t count, int load)
{
    if (load)
        memcpy(member, row, sizeof(double) * count);
    else
        memcpy(row, member, sizeof(double) * count);
    return row + count;
}

static void exchange_states(Batch *b, double *row, int load)
{
    for (Py_ssize_t lane = 0; lane < b->lanes; lane++) {
        State *s = &b->states[lane];
        size_t n = (size_t)b->corners[lane].nodes;
        for (int side = 0; side < SIDES; side++)
            row = move(row, s->t[side], n, load);
        row = move(row, s->lump_t, LUMPS, load);
        for (int side = 0; side < SIDES; side++)
            row = move(row, s->e[side], n, load);
        row = move(row, s->lump_e, LUMPS, load);
        row = move(row, s->pad_m, SIDES, load);
        for (int side = 0; side < SIDES; side++)
            row = move(row, s->charred[side], (size_t)b->pads, load);
        row = move(row, &s->friction_j, 1, load);
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

enum { TABLE, DEPTHS, STEP, KEEP, ROWS, STATE, RECORD, POWERS, FRICTION,
       LEDGER, BUFFERS };

static int check_sizes(const Py_buffer *v, Py_ssize_t lanes,
                       Py_ssize_t steps, int pads, int cheeks)
{
    const Py_ssize_t word = sizeof(double), nodes = 1 + pads + cheeks;
    Py_ssize_t kept = 0;
    for (Py_ssize_t i = 0; i < v[KEEP].len; i++)
        kept += ((const unsigned char *)v[KEEP].buf)[i] != 0;
    Py_ssize_t row = SIDES * (2 * nodes + 1 + pads) + 2 * LUMPS + 1;
    const Py_ssize_t wanted[BUFFERS] = {
        PARAMETER_COUNT * lanes * word, cheeks * word, steps * word, steps,
        steps * INPUTS * lanes * word, lanes * row * word,
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

static PyObject *march_buffers(Py_buffer *v, int pads, Py_ssize_t per_car)
{
    const Py_ssize_t word = sizeof(double);
    Batch b = {0};
    PyObject *result = NULL;
    b.cheeks = (int)(v[DEPTHS].len / word);
    b.pads = pads;
    b.steps = v[STEP].len / word;
    b.lanes = v[LEDGER].len / (2 * word);
    b.per_car = per_car;
    if (pads < 2 || b.cheeks < 1 || 1 + pads + b.cheeks > MAX_NODES) {
        PyErr_Format(PyExc_ValueError, "a mesh has at most %d nodes a side",
                     MAX_NODES);
        return NULL;
    }
    if (check_sizes(v, b.lanes, b.steps, pads, b.cheeks))
        return NULL;
    size_t lanes = (size_t)b.lanes;
    b.corners = calloc(lanes, sizeof(Corner));
    b.states = calloc(lanes, sizeof(State));
    b.now = calloc(lanes * (INPUTS + 1), sizeof(double));
    if (!b.corners || !b.states || !b.now) {
        PyErr_NoMemory();
        goto done;
    }
    b.step_s = v[STEP].buf;
    b.rows = v[ROWS].buf;
    b.keep = v[KEEP].buf;
    b.record = v[RECORD].buf;
    b.power = v[POWERS].buf;
    b.friction = v[FRICTION].buf;
    b.ledger = v[LEDGER].buf;
    for (Py_ssize_t lane = 0; lane < b.lanes; lane++) {
        Corner *c = &b.corners[lane];
        double *p = (double *)&c->p;
        for (Py_ssize_t k = 0; k < PARAMETER_COUNT; k++)
            p[k] = ((const double *)v[TABLE].buf)[k * b.lanes + lane];
        build(c, v[DEPTHS].buf, b.cheeks, pads);
        b.varies |= friction_varies(&c->p);
    }
    exchange_states(&b, v[STATE].buf, 1);
    if (!run(&b)) {
        exchange_states(&b, v[STATE].buf, 0);
        result = Py_NewRef(Py_None);
    }
done:
    free(b.corners);
    free(b.states);
    free(b.now);
    return result;
}

PyDoc_STRVAR(march_doc,
"march(table, depths, step_s, keep, rows, state, record, power, friction,\n"
"      ledger, pad_nodes, corners_per_car)\n--\n\n"
"March a batch in place; buffers are described in compiled.py.");

static PyObject *march(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer v[BUFFERS];
    Py_ssize_t per_car;
    int pads;
    if (!PyArg_ParseTuple(args, "y*y*y*y*y*w*w*w*w*w*in", &v[TABLE],
                          &v[DEPTHS], &v[STEP], &v[KEEP], &v[ROWS], &v[STATE],
                          &v[RECORD], &v[POWERS], &v[FRICTION], &v[LEDGER],
                          &pads, &per_car))
        return NULL;
    PyObject *const result = march_buffers(v, pads, per_car);
    for (int i = 0; i < BUFFERS; i++)
        PyBuffer_Release(&v[i]);
    return result;
}

static PyObject *names(PyObject *self, PyObject *unused)
{
    (void)self;
    (void)unused;
    PyObject *tuple = PyTuple_New(PARAMETER_COUNT);
    for (Py_ssize_t i = 0; tuple && i < PARAMETER_COUNT; i++) {
        PyObject *name = PyUnicode_FromString(parameter_names[i]);
        if (!name || PyTuple_SetItem(tuple, i, name)) {
            Py_DECREF(tuple);
            return NULL;
        }
    }
    return tuple;
}

static PyMethodDef methods[] = {
    {"march", march, METH_VARARGS, march_doc},
    {"parameter_names", names, METH_NOARGS,
     PyDoc_STR("parameter_names()\n--\n\nRows of the parameter table.")},
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
