/* The pass over samples for Python: buffers are checked here, so that none
 * can make the pass (sample_pass.c) read outside.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "../thermal/kernel.h"
#include "sample_pass.h"

#define WORDS(layout) ((Py_ssize_t)(sizeof(layout) / 8))

const char bstm_sample_pass_doc[] =
    "sample_pass(ints, floats, times, numbers, flags, times_us, roles, values,"
    "\n            rows, vehicle_rows, row_times_us, first)\n\n"
    "Returns (next sample, steps, code); see model/heat/sample_pass.py.";

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
    p->steps = 0;
    return NULL;
}

PyObject *bstm_sample_pass(PyObject *Py_UNUSED(self), PyObject *args)
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
    if (bstm_buffers(BUFFERS, object, writable, wide, view) < 0) return NULL;
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
