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
