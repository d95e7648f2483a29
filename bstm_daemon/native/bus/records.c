/* Records of received frames: on the axis of the service, in order of time,
 * and into samples. service/intake.py and frame_records.py drive this; what is
 * not plain is handed back to them, frame by frame.
 */
#include "bus.h"
#include "plan.h"

#include <stdlib.h>

enum { T_STORE, T_TIMES, T_ROLES, T_VALUES, T_COUNT, TAKE_BUFFERS };

/* Rounded down, as Python divides. */
static int64_t micros(int64_t stamp_ns)
{
    return stamp_ns / 1000 - (stamp_ns % 1000 < 0);
}

const char bstm_place_in_time_doc[] =
"place_in_time(store, first, end, shift_us, low_us, high_us, latest_us,\n"
"              passed_us)\n\n"
"Set each record's time: its stamp less the shift, passed_us at least.\n"
"Returns (first record whose time is outside low .. high or after the\n"
"latest, `end` if none is; how many were before passed_us).";

PyObject *bstm_place_in_time(PyObject *Py_UNUSED(self), PyObject *args)
{
    Py_buffer store;
    Py_ssize_t at, end, late = 0;
    long long shift, low, high, latest, passed;
    if (!PyArg_ParseTuple(args, "w*nnLLLLL", &store, &at, &end, &shift, &low,
                          &high, &latest, &passed))
        return NULL;
    Record *const records = bstm_records(&store, at, end);
    for (; records != NULL && at < end; at++) {
        const int64_t time_us = micros(records[at].stamp_ns) - shift;
        if (time_us < low || time_us > high || time_us > latest) break;
        late += time_us < passed;
        records[at].time_us = time_us < passed ? passed : time_us;
    }
    PyBuffer_Release(&store);
    if (records == NULL) return NULL;
    return Py_BuildValue("nn", at, late);
}

/* The end of the run of times that do not fall, from `at` on. */
static Py_ssize_t run_end(const Record *r, Py_ssize_t at, Py_ssize_t n)
{
    while (++at < n && r[at - 1].time_us <= r[at].time_us) continue;
    return at < n ? at : n;
}

/* Merge runs until there is one: each bus is one, so there are few. Stable.
 * Returns -1 without memory. */
static int merge_runs(Record *records, Py_ssize_t n)
{
    if (n < 2 || run_end(records, 0, n) == n) return 0;
    Record *const other = malloc((size_t)n * sizeof *other);
    if (other == NULL) return -1;
    Record *from = records, *to = other;
    while (run_end(from, 0, n) < n) {
        for (Py_ssize_t at = 0; at < n;) {
            Py_ssize_t left = at, out = at;
            const Py_ssize_t middle = run_end(from, at, n);
            const Py_ssize_t end =
                middle < n ? run_end(from, middle, n) : n;
            Py_ssize_t right = middle;
            while (left < middle && right < end)
                to[out++] = from[right].time_us < from[left].time_us
                    ? from[right++] : from[left++];
            while (left < middle) to[out++] = from[left++];
            while (right < end) to[out++] = from[right++];
            at = end;
        }
        Record *const swapped = from;
        from = to;
        to = swapped;
    }
    if (from != records) memcpy(records, from, (size_t)n * sizeof *from);
    free(other);
    return 0;
}

const char bstm_sort_doc[] =
"sort(store, count, until_us)\n\n"
"Sort the first `count` records by time, equal ones as they are; returns how\n"
"many are not after until_us.";

PyObject *bstm_sort(PyObject *Py_UNUSED(self), PyObject *args)
{
    Py_buffer store;
    Py_ssize_t count;
    long long until;
    if (!PyArg_ParseTuple(args, "w*nL", &store, &count, &until)) return NULL;
    Record *const records = bstm_records(&store, 0, count);
    int failed = 0;
    if (records != NULL) {
        failed = merge_runs(records, count);
        while (count > 0 && records[count - 1].time_us > until) count--;
    }
    PyBuffer_Release(&store);
    if (records == NULL) return NULL;
    if (failed) return PyErr_NoMemory();
    return PyLong_FromSsize_t(count);
}

typedef struct {
    PyObject *names, *held; /* of roles, None or its name; a list */
    Py_ssize_t at, samples;
} Taken;

/* Append (time, name, value) to the held samples; -1 with an exception. */
static int hold(const Taken *t, PyObject *name, int64_t time_us, double value)
{
    PyObject *const sample =
        Py_BuildValue("LOd", (long long)time_us, name, value);
    if (sample == NULL) return -1;
    const int failed = PyList_Append(t->held, sample);
    Py_DECREF(sample);
    return failed;
}

static const char *wrong_with_take(const Py_buffer *view, const Plan *plan,
                                   const Taken *t)
{
    const Py_ssize_t roles = PyTuple_Size(t->names);
    if (view[T_ROLES].len / 4 != view[T_TIMES].len / 8
        || view[T_VALUES].len != view[T_TIMES].len
        || view[T_COUNT].len / 8 != SAMPLE_COUNTS)
        return "the columns of samples have different lengths";
    for (int64_t o = 0; o < plan->starts[plan->known]; o++) {
        const int64_t role = plan->outputs[o * OUTPUT_FIELDS + O_ROLE];
        if (role < 0 || role >= roles) return "a role is out of range";
    }
    return NULL;
}

static int take(const Py_buffer *view, const Plan *plan, Py_ssize_t end,
                Taken *t)
{
    const Record *const records = view[T_STORE].buf;
    int64_t *const times = view[T_TIMES].buf;
    int32_t *const roles = view[T_ROLES].buf;
    double *const values = view[T_VALUES].buf;
    const Py_ssize_t room = view[T_TIMES].len / 8;
    for (; t->at < end; t->at++) {
        const Record *const r = records + t->at;
        if (r->error || r->remote) return 0;
        const Py_ssize_t message =
            message_of(plan, r->bus, r->id, r->extended, r->length);
        if (message < 0 || plan->by_hand[message]
            || size_of(plan, message) > room - t->samples)
            return 0;
        const Py_ssize_t samples_end = t->samples
            + samples_of(plan, message, r->data, roles + t->samples,
                         values + t->samples, view[T_COUNT].buf);
        for (; t->samples < samples_end; t->samples++) {
            times[t->samples] = r->time_us;
            PyObject *const name =
                PyTuple_GetItem(t->names, roles[t->samples]);
            if (name == NULL
                || (name != Py_None
                    && hold(t, name, r->time_us, values[t->samples]) < 0))
                return -1;
        }
    }
    return 0;
}

const char bstm_take_doc[] =
"take(store, first, end, plan, times, roles, values, counts, names, held)\n\n"
"Write the samples of the records from `first` on, up to one that is no data\n"
"frame of a message of its length, whose message is marked by_hand, or whose\n"
"samples find no room. plan: a tuple, as plan_tables.py has it; names: a\n"
"tuple, for each role None or what appends (time, name, value) to the list\n"
"`held`. Adds to counts: not a number, out of range, not available. Returns\n"
"(the record it stopped at, samples).";

PyObject *bstm_take(PyObject *Py_UNUSED(self), PyObject *args)
{
    static const int wide[TAKE_BUFFERS] = {1, 8, 4, 8, 8};
    PyObject *tables;
    Py_buffer view[TAKE_BUFFERS];
    Py_ssize_t end;
    Taken t = {NULL, NULL, 0, 0};
    Plan plan;
    if (!PyArg_ParseTuple(args, "y*nnOw*w*w*w*O!O!", &view[T_STORE], &t.at,
                          &end, &tables, &view[T_TIMES], &view[T_ROLES],
                          &view[T_VALUES], &view[T_COUNT], &PyTuple_Type,
                          &t.names, &PyList_Type, &t.held)
        || bstm_widths(TAKE_BUFFERS, view, wide) < 0)
        return NULL;
    if (hold_plan(tables, &plan) < 0) {
        bstm_release(TAKE_BUFFERS, view);
        return NULL;
    }
    int failed = -1;
    if (bstm_records(&view[T_STORE], t.at, end) != NULL) {
        const char *const wrong = wrong_with_take(view, &plan, &t);
        if (wrong == NULL) failed = take(view, &plan, end, &t);
        else PyErr_SetString(PyExc_ValueError, wrong);
    }
    bstm_release(TAKE_BUFFERS, view);
    bstm_release(PLAN_BUFFERS, plan.view);
    if (failed) return NULL;
    return Py_BuildValue("nn", t.at, t.samples);
}
