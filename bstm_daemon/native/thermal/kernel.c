/* The extension module: what Python hands over is checked here, so that no
 * array can make the march (march.c) read outside.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "kernel.h"
#include "march.h"

/* Whether `have` is rows * width, which may not fit into a Py_ssize_t. */
static int fits(Py_ssize_t have, Py_ssize_t rows, Py_ssize_t width)
{
    if (width == 0) return have == 0;
    return have % width == 0 && have / width == rows;
}

PyDoc_STRVAR(march_doc,
"march(ints, floats, state, inputs, set_of_member, ledger, outputs, members,\n"
"      sets, steps, dt_s, output_every, output_phase)\n\n"
"March members through steps; buffers of int32 and float64, contiguous.\n"
"floats [members, floats]; state [members, nodes + memories], in place;\n"
"inputs [steps, sets, inputs]; set_of_member [members];\n"
"ledger [members, links + sources], added to; outputs [outputs, members,\n"
"nodes + memories + sources], filled. ValueError where sizes do not fit.");

static PyObject *py_march(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *object[7];
    March m;
    Py_ssize_t every, phase;
    if (!PyArg_ParseTuple(args, "OOOOOOOnnndnn", &object[0], &object[1],
                          &object[2], &object[3], &object[4], &object[5],
                          &object[6], &m.members, &m.sets, &m.steps, &m.dt,
                          &every, &phase))
        return NULL;
    static const int writable[7] = {0, 0, 1, 0, 0, 1, 1};
    static const int wide[7] = {4, 8, 8, 8, 4, 8, 8};
    Py_buffer view[7];
    if (bstm_buffers(7, object, writable, wide, view) < 0) return NULL;
    Structure s;
    const char *wrong = bstm_parse(&s, view[0].buf, view[0].len / 4);
    if (wrong == NULL) {
        const Py_ssize_t states =
            s.count[COUNT_NODES] + s.count[COUNT_MEMORIES];
        const Py_ssize_t ns = s.count[COUNT_SOURCES];
        if (m.members < 0 || m.members > INT32_MAX || m.sets < 1
            || m.sets > INT32_MAX || m.steps < 0 || every < 1
            || every > INT32_MAX || phase < 1 || phase > INT32_MAX
            || !(m.dt > 0.0))
            wrong = "a count or the step is out of range";
        else {
            const Py_ssize_t outputs =
                m.steps < phase ? 0 : 1 + (m.steps - phase) / every;
            const Py_ssize_t row = m.members * (states + ns);
            if (view[4].len / 4 != m.members
                || !fits(view[1].len / 8, m.members, s.count[COUNT_FLOATS])
                || !fits(view[2].len / 8, m.members, states)
                || !fits(view[3].len / 8, m.steps,
                         m.sets * s.count[COUNT_INPUTS])
                || !fits(view[5].len / 8, m.members,
                         s.count[COUNT_LINKS] + ns)
                || (row > 0 && view[6].len / 8 / row < outputs))
                wrong = "a buffer has the wrong size";
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
        m.ledger = view[5].buf;
        m.outputs = view[6].buf;
        m.every = (int)every;
        m.phase = (int)phase;
        Py_BEGIN_ALLOW_THREADS
        failed = bstm_march(&m);
        Py_END_ALLOW_THREADS
    }
    for (int i = 0; i < 7; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    if (failed) return PyErr_NoMemory();
    Py_RETURN_NONE;
}

int bstm_buffers(int n, PyObject **object, const int *writable,
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

static PyMethodDef methods[] = {
    {"march", py_march, METH_VARARGS, march_doc},
    {"sample_pass", bstm_sample_pass, METH_VARARGS, bstm_sample_pass_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernel",
    "Compiled step of a thermal network and compiled pass over samples.", -1,
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
