/* The extension module: what Python hands over is checked here, so that no
 * array can make the march (thermal/march.c), the pass over samples
 * (heat/sample_pass.c) or the risk (risk/vaporisation.c) read outside.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "../heat/sample_pass.h"
#include "../risk/vaporisation.h"
#include "../thermal/march.h"

#define WORDS(layout) ((Py_ssize_t)(sizeof(layout) / 8))

/* Contiguous buffers of the objects, writable where asked, with items of the
 * given width. Returns -1 with an exception and nothing held on failure. */
static int buffers(int n, PyObject **object, const int *writable,
                   const int *wide, Py_buffer *view)
{
    for (int i = 0; i < n; i++) {
        const int flags = writable[i] ? PyBUF_CONTIG : PyBUF_CONTIG_RO;
        int bad = PyObject_GetBuffer(object[i], &view[i], flags) < 0;
        if (!bad && view[i].itemsize != wide[i]) {
            PyErr_Format(PyExc_ValueError,
                         "buffer %d holds items of %zd bytes, not %d", i,
                         view[i].itemsize, wide[i]);
            PyBuffer_Release(&view[i]);
            bad = 1;
        }
        if (bad) {
            while (i-- > 0) PyBuffer_Release(&view[i]);
            return -1;
        }
    }
    return 0;
}

/* Whether `have` is rows * width, which may not fit into a Py_ssize_t. */
static int fits(Py_ssize_t have, Py_ssize_t rows, Py_ssize_t width)
{
    if (width == 0) return have == 0;
    return have % width == 0 && have / width == rows;
}

static int positive(const double *values, Py_ssize_t n)
{
    for (Py_ssize_t i = 0; i < n; i++)
        if (!(values[i] > 0.0)) return 0;
    return 1;
}

PyDoc_STRVAR(march_doc,
"march(ints, floats, state, inputs, set_of_member, ledger, outputs, steps_s,\n"
"      members, sets, steps, column, output_every, output_phase)\n\n"
"March members through steps; buffers of int32 and float64, contiguous.\n"
"floats [members, floats]; state [members, nodes + memories], in place;\n"
"inputs [rows, sets, inputs]; set_of_member [members];\n"
"ledger [members, links + sources], added to, or empty, where one column of\n"
"the state is all that is wanted; outputs [outputs, members,\n"
"nodes + memories + sources], or of one column, filled. inputs and steps_s\n"
"are one for all steps or one for each. ValueError where sizes do not fit.");

static PyObject *py_march(PyObject *Py_UNUSED(self), PyObject *args)
{
    enum { BUFFERS = 8 };
    PyObject *object[BUFFERS];
    March m;
    Py_ssize_t every, phase;
    if (!PyArg_ParseTuple(args, "OOOOOOOOnnnnnn", &object[0], &object[1],
                          &object[2], &object[3], &object[4], &object[5],
                          &object[6], &object[7], &m.members, &m.sets,
                          &m.steps, &m.column, &every, &phase))
        return NULL;
    static const int writable[BUFFERS] = {0, 0, 1, 0, 0, 1, 1, 0};
    static const int wide[BUFFERS] = {4, 8, 8, 8, 4, 8, 8, 8};
    Py_buffer view[BUFFERS];
    if (buffers(BUFFERS, object, writable, wide, view) < 0) return NULL;
    Structure s;
    const char *wrong = bstm_parse(&s, view[0].buf, view[0].len / 4);
    if (wrong == NULL) {
        const Py_ssize_t states =
            s.count[COUNT_NODES] + s.count[COUNT_MEMORIES];
        const Py_ssize_t ns = s.count[COUNT_SOURCES];
        if (m.members < 0 || m.members > INT32_MAX || m.sets < 1
            || m.sets > INT32_MAX || m.steps < 0 || every < 1
            || every > INT32_MAX || phase < 1 || phase > INT32_MAX
            || m.column < -1 || m.column >= states + ns)
            wrong = "a count or the step is out of range";
        else {
            const Py_ssize_t outputs =
                m.steps < phase ? 0 : 1 + (m.steps - phase) / every;
            const Py_ssize_t width = m.sets * s.count[COUNT_INPUTS];
            m.columns = m.column < 0 ? states + ns : 1;
            m.rows = fits(view[3].len / 8, 1, width) ? 1 : m.steps;
            m.durations = view[7].len / 8;
            const Py_ssize_t row = m.members * m.columns;
            if (view[4].len / 4 != m.members
                || !fits(view[1].len / 8, m.members, s.count[COUNT_FLOATS])
                || !fits(view[2].len / 8, m.members, states)
                || !fits(view[3].len / 8, m.rows, width)
                || !((view[5].len == 0 && m.column >= 0 && m.column < states)
                     || fits(view[5].len / 8, m.members,
                             s.count[COUNT_LINKS] + ns))
                || (row > 0 && view[6].len / 8 / row < outputs))
                wrong = "a buffer has the wrong size";
            else if (m.durations != 1 && m.durations != m.steps)
                wrong = "the durations are neither one nor those of the steps";
            else if (!positive(view[7].buf, m.durations))
                wrong = "a step is not above 0 s";
            else if (!bstm_within(view[4].buf, (int)m.members, 0, (int)m.sets))
                wrong = "a member has no input set";
        }
    }
    int failed = 0;
    if (wrong == NULL) {
        m.s = &s;
        m.floats = view[1].buf;
        m.state = view[2].buf;
        m.inputs = view[3].buf;
        m.set_of = view[4].buf;
        m.ledger = view[5].len ? view[5].buf : NULL;
        m.outputs = view[6].buf;
        m.dt = view[7].buf;
        if (m.column < 0) m.column = 0;
        m.every = (int)every;
        m.phase = (int)phase;
        Py_BEGIN_ALLOW_THREADS
        failed = bstm_march(&m);
        Py_END_ALLOW_THREADS
    }
    for (int i = 0; i < BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    if (failed) return PyErr_NoMemory();
    Py_RETURN_NONE;
}

PyDoc_STRVAR(sample_pass_doc,
"sample_pass(ints, floats, times, numbers, flags, times_us, roles, values,\n"
"            rows, vehicle_rows, row_times_us, first)\n\n"
"Returns (next sample, steps, code); see model/heat/sample_pass.py.");

/* Point the pass into its buffers. Returns NULL or what is wrong. */
static const char *bind(Pass *p, Py_buffer *view)
{
    Inputs *in = &p->in;
    if (view[0].len / 8 != WORDS(PlanNumbersInts))
        return "the plan has another layout";
    const PlanNumbersInts *options = in->options = view[0].buf;
    in->plan = view[1].buf;
    if (options->corners < 0 || options->corners > MAX_CORNERS
        || options->points < 0 || options->points > 4096
        || options->has_laws < 0 || options->has_laws > 1
        || options->step_us < 1 || options->step_us > AHEAD_US)
        return "a count or the step is out of range";
    for (int c = 0; c < MAX_CORNERS; c++)
        if (options->place[c] < 0 || options->place[c] >= MAX_CORNERS)
            return "a corner's place is out of range";
    const Py_ssize_t corners = (Py_ssize_t)options->corners;
    const Py_ssize_t points = (Py_ssize_t)options->points;
    const Py_ssize_t laws = options->has_laws ? corners * 3 * LAW_POINTS : 0;
    p->room = view[10].len / 8;
    if (view[1].len / 8 != WORDS(PlanNumbersFloats) + 2 * points + laws
        || view[2].len / 8 != WORDS(SampleMemoryInts)
        || view[3].len / 8 != WORDS(SampleMemoryFloats)
        || view[4].len / 4 != 1 || view[6].len / 4 != view[5].len / 8
        || view[7].len != view[5].len
        || view[8].len / 8 < p->room * corners * CHANNELS
        || view[9].len / 8 < p->room * VEHICLE_CHANNELS)
        return "a buffer has the wrong size";
    in->table_front = (const double *)(in->plan + 1);
    in->table_rear = in->table_front + points;
    in->laws = laws ? in->table_rear + points : NULL;
    inputs_init(in, view[2].buf, view[3].buf);
    p->flags = view[4].buf;
    p->rows = view[8].buf;
    p->vehicle_rows = view[9].buf;
    p->row_times = view[10].buf;
    return NULL;
}

static PyObject *py_sample_pass(PyObject *Py_UNUSED(self), PyObject *args)
{
    enum { BUFFERS = 11 };
    PyObject *object[BUFFERS];
    Py_ssize_t first;
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOOn", &object[0], &object[1],
                          &object[2], &object[3], &object[4], &object[5],
                          &object[6], &object[7], &object[8], &object[9],
                          &object[10], &first))
        return NULL;
    static const int writable[BUFFERS] = {0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1};
    static const int wide[BUFFERS] = {8, 8, 8, 8, 4, 8, 4, 8, 8, 8, 8};
    Py_buffer view[BUFFERS];
    if (buffers(BUFFERS, object, writable, wide, view) < 0) return NULL;
    Pass p = {0};
    int code = DONE;
    const char *wrong = bind(&p, view);
    const Py_ssize_t count = view[5].len / 8;
    if (wrong == NULL && (first < 0 || first > count))
        wrong = "the first sample is out of range";
    if (wrong == NULL) {
        Py_BEGIN_ALLOW_THREADS
        first = sample_pass(&p, view[5].buf, view[6].buf, view[7].buf, first,
                            count, &code);
        Py_END_ALLOW_THREADS
    }
    for (int i = 0; i < BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return Py_BuildValue("nni", first, p.steps, code);
}

PyDoc_STRVAR(mean_probability_doc,
"mean_probability(lines, low_k, temperatures_k)\n\n"
"See model/risk/vaporisation.py. lines: float64 [kelvins, 2].");

static PyObject *py_mean_probability(PyObject *Py_UNUSED(self),
                                     PyObject *args)
{
    static const int writable[1] = {0}, wide[1] = {8};
    PyObject *lines, *kelvins;
    Py_buffer view;
    Vapour sum = {0};
    if (!PyArg_ParseTuple(args, "OdO", &lines, &sum.low_k, &kelvins))
        return NULL;
    const Py_ssize_t count = PySequence_Size(kelvins);
    if (count < 0 || buffers(1, &lines, writable, wide, &view) < 0)
        return NULL;
    sum.lines = view.buf;
    sum.count = view.len / 16;
    int failed = 0;
    for (Py_ssize_t i = 0; i < count && !failed; i++) {
        PyObject *const item = PySequence_GetItem(kelvins, i);
        const double kelvin = item == NULL ? -1.0 : PyFloat_AsDouble(item);
        failed = kelvin == -1.0 && PyErr_Occurred() != NULL;
        Py_XDECREF(item);
        vaporisation_add(&sum, kelvin);
    }
    PyBuffer_Release(&view);
    if (failed) return NULL;
    return PyFloat_FromDouble(vaporisation_mean(&sum, (double)count));
}

static PyMethodDef methods[] = {
    {"march", py_march, METH_VARARGS, march_doc},
    {"mean_probability", py_mean_probability, METH_VARARGS,
     mean_probability_doc},
    {"sample_pass", py_sample_pass, METH_VARARGS, sample_pass_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernel",
    "Compiled step of a thermal network, pass over samples, and risk.", -1,
    methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL
        && PyModule_AddStringConstant(made, "SOURCES", BSTM_SOURCES) < 0)
        Py_CLEAR(made);
    return made;
}
