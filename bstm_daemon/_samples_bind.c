/* The pass over samples for Python: buffers are checked here, so that none
 * can make the pass (_samples.c) read outside.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "_kernel.h"
#include "_samples.h"

/* Where the checks have their limits, roles and memory. */
static void bind_checks(Pass *p, const double *limits, int64_t *times,
                        double *numbers)
{
    Checks *c = &p->checks;
    c->roles = p->roles;
    c->corners = p->corners;
    c->settling_s = p->f[F_SETTLING];
    c->low = limits;
    c->high = c->low + p->roles;
    c->step = c->high + p->roles;
    c->rate = c->step + p->roles;
    c->voice_role[p->corners] = p->role[R_SPEED];
    c->pressure_role[0] = p->role[R_PRIMARY];
    c->pressure_role[1] = p->role[R_SECONDARY];
    c->acceleration_role = p->role[R_ACCELERATION];
    c->torque_role = p->role[R_TORQUE];
    c->temperatures = 0;
    c->temperature_role[c->temperatures++] = p->role[R_AMBIENT];
    for (int i = 0; i < p->corners; i++) {
        const int32_t *corner = p->corner + i * PER_CORNER_INTS;
        c->voice_role[i] = corner[C_WHEEL];
        c->pressure_role[2 + i] = corner[C_PRESSURE];
        for (int m = 0; m < MEASURED; m++)
            c->temperature_role[c->temperatures++] = corner[C_MEASURED + m];
    }
    bstm_checks_bind(c, times, numbers,
                     (double)(int64_t)p->f[F_STEP] * 1e-6);
}

const char bstm_sample_pass_doc[] =
    "sample_pass(ints, floats, times, numbers, flags, times_us, roles, values,"
    "\n            rows, vehicle_rows, row_times_us, first)\n\n"
    "Returns (next sample, steps, code); see heat/sample_pass.py.";

/* Point the pass into its buffers. Returns NULL or what is wrong. */
static const char *bind(Pass *p, Py_buffer *view)
{
    const int32_t *ints = view[0].buf;
    if (view[0].len / 4 < HEADER + VEHICLE_ROLES
        || ints[I_LAYOUT] != PLAN_LAYOUT)
        return "ints has another layout";
    p->ints = ints;
    p->roles = ints[I_ROLES];
    p->corners = ints[I_CORNERS];
    p->points = ints[I_POINTS];
    if (p->roles < 1 || p->roles > 4096 || p->corners < 0
        || p->corners > MAX_CORNERS || p->points < 0 || p->points > 4096
        || ints[I_ASSUMED] < 0 || ints[I_ASSUMED] > 1
        || ints[I_LAW] < 0 || ints[I_LAW] > 1)
        return "a count is out of range";
    const int k = p->corners;
    const Py_ssize_t n_ints = HEADER + VEHICLE_ROLES + k * PER_CORNER_INTS;
    const Py_ssize_t n_floats = VEHICLE_FLOATS + k * PER_CORNER_FLOATS
        + 2 * p->points + (1 + LIMITS) * p->roles
        + (ints[I_LAW] ? k * LAW : 0);
    const Py_ssize_t n_times = TIMES + p->roles + bstm_checks_times(p->roles);
    const Py_ssize_t n_numbers = NUMBERS + p->roles + PER_CORNER_SUMS * k
        + bstm_checks_numbers(k, p->roles) + OBSERVER_NUMBERS + k;
    p->room = view[10].len / 8;
    if (view[0].len / 4 != n_ints || view[1].len / 8 != n_floats
        || view[2].len / 8 != n_times
        || view[3].len / 8 != n_numbers || view[4].len / 4 != 1
        || view[6].len / 4 != view[5].len / 8
        || view[7].len != view[5].len
        || view[8].len / 8 < p->room * k * CHANNELS
        || view[9].len / 8 < p->room * VEHICLE_CHANNELS)
        return "a buffer has the wrong size";
    p->role = ints + HEADER;
    p->corner = p->role + VEHICLE_ROLES;
    for (Py_ssize_t i = HEADER; i < n_ints; i++) {
        if (ints[i] < -1 || ints[i] >= p->roles)
            return "a role number is out of range";
    }
    p->f = view[1].buf;
    if (!(p->f[F_STEP] >= 1.0)) return "the step is too short";
    p->corner_f = p->f + VEHICLE_FLOATS;
    p->table_front = p->corner_f + k * PER_CORNER_FLOATS;
    p->table_rear = p->table_front + p->points;
    p->timeout = p->table_rear + p->points;
    p->law = ints[I_LAW] ? p->timeout + (1 + LIMITS) * p->roles : NULL;
    p->t = view[2].buf;
    p->stamp = p->t + TIMES;
    p->n = view[3].buf;
    p->value = p->n + NUMBERS;
    p->lagged = p->value + p->roles;
    p->energy_ff = p->lagged + k;
    p->pressure_sum = p->energy_ff + k;
    p->on_time = p->pressure_sum + k;
    p->total_ff = p->on_time + k;
    p->interface_k = p->total_ff + k;
    p->told_k = p->interface_k + k;
    bind_checks(p, p->timeout + p->roles, p->stamp + p->roles,
                p->told_k + k);
    Observer *o = &p->observer;
    o->n = p->told_k + k + bstm_checks_numbers(k, p->roles);
    o->brake_sum = o->n + OBSERVER_NUMBERS;
    o->mass_kg = p->f[F_MASS];
    o->rotating = p->f[F_ROTATING] / p->f[F_MASS];
    o->rolling = p->f[F_CONSTANT] / p->f[F_MASS];
    p->flags = view[4].buf;
    p->rows = view[8].buf;
    p->vehicle_rows = view[9].buf;
    p->row_times = view[10].buf;
    p->steps = 0;
    p->stale = 1;
    p->speed_known = 0;
    p->on_pressure = p->f[F_ON_PRESSURE];
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
    static const int wide[BUFFERS] = {4, 8, 8, 8, 4, 8, 4, 8, 8, 8, 8};
    Py_buffer view[BUFFERS];
    if (bstm_buffers(BUFFERS, object, writable, wide, view) < 0) return NULL;
    Pass p;
    int code = DONE;
    const char *wrong = bind(&p, view);
    const Py_ssize_t count = view[5].len / 8;
    if (wrong == NULL && (first < 0 || first > count))
        wrong = "the first sample is out of range";
    if (wrong == NULL) {
        Py_BEGIN_ALLOW_THREADS
        first = bstm_consume(&p, view[5].buf, view[6].buf, view[7].buf,
                             first, count, &code);
        Py_END_ALLOW_THREADS
    }
    for (int i = 0; i < BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return Py_BuildValue("nni", first, p.steps, code);
}
