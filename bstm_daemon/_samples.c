/* The compiled pass over samples: heat/sample_pass.py says what it does and
 * does the same operations in the same order; heat/sample_plan.py lays out
 * `ints` and `floats`.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <stdint.h>

#include "_kernel.h"

#define PLAN_LAYOUT 1
#define NEVER INT64_MIN
#define TAIL 4.0 /* filter times that Feed-Back runs on after release */
#define UNKNOWN (-1.0)
#define LATE_US INT64_C(1000000)
#define AHEAD_US INT64_C(3600000000)
#define SETTLED_US (12 * INT64_C(3600000000))
#define CLOCK_SET_US (30 * 24 * INT64_C(3600000000))
#define CONFIRM_US INT64_C(10000000)
#define LIMIT_US (INT64_C(1) << 60)

enum { DONE, FULL, SETTLE, JUMP, DROP };
enum {
    FLAG_SPEED = 1, FLAG_PRESSURE = 2, FLAG_ACCELERATION = 4,
    FLAG_TORQUE = 8, FLAG_AMBIENT = 16, FLAG_JUMP = 32, FLAG_SETTLED = 64,
    FLAG_CORNER_PRESSURE = 128
};
enum {
    I_LAYOUT, I_ROLES, I_CORNERS, I_MODE, I_SLOPE, I_POINTS, I_PRESSURE,
    HEADER
};
enum {
    R_SPEED, R_PRIMARY, R_SECONDARY, R_ACCELERATION, R_TORQUE, R_EXTERNAL,
    R_AMBIENT, R_RAIN, VEHICLE_ROLES
};
enum { C_WHEEL, C_PRESSURE, C_SECONDARY, C_REAR, C_MEASURED };
enum { MEASURED = 6, PER_CORNER_INTS = C_MEASURED + MEASURED };
enum {
    F_STEP, F_MASS, F_ROTATING, F_RADIUS, F_QUADRATIC, F_LINEAR, F_CONSTANT,
    F_AMBIENT, F_TORQUE, F_ON_PRESSURE, F_ON_FORCE, F_FILTER, VEHICLE_FLOATS
};
enum { T_PER_PA, T_PUSHOUT, T_LAG, T_SHARE, PER_CORNER_FLOATS };
enum { S_NOW, S_GRID, S_PENDING, S_LATE, S_DROPPED, S_JUMPS, TIMES };
enum {
    N_FILTERED, N_SPEED, N_DISTANCE, N_FORCE, N_ENERGY_FB, N_TOTAL_FB, N_TAIL,
    NUMBERS
};
enum { PER_CORNER_SUMS = 5, CHANNELS = 8 + MEASURED, VEHICLE_CHANNELS = 5 };
enum { MAX_CORNERS = 16 }; /* each has a bit of its own in flags */

typedef struct {
    const int32_t *ints, *role, *corner;  /* role: the vehicle's roles */
    const double *f, *corner_f, *table_front, *table_rear, *timeout;
    int roles, corners, points;
    int64_t *t, *stamp;
    double *n, *lagged, *energy_ff, *pressure_sum, *on_time, *total_ff, *value;
    int32_t *flags;
    double *rows, *vehicle_rows;
    int64_t *row_times;
    Py_ssize_t room, steps;
    int stale, speed_known;
    double speed, heading, wheel[MAX_CORNERS], target[MAX_CORNERS];
} Pass;

static int valid(const Pass *p, int role)
{
    return role >= 0 && p->stamp[role] != NEVER
        && (double)(p->t[S_NOW] - p->stamp[role]) <= p->timeout[role];
}

static double vehicle(const Pass *p, int which, double otherwise)
{
    const int role = p->role[which];
    return valid(p, role) ? p->value[role] : otherwise;
}

static double rear(const Pass *p, double front)
{
    const double *x = p->table_front, *y = p->table_rear;
    const int last = p->points - 1;
    if (front <= x[0]) return y[0];
    if (front >= x[last]) return y[last];
    int i = 0;
    while (front >= x[i + 1]) i++;
    return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i]);
}

static double pressure_of(const Pass *p, const int32_t *corner)
{
    if (valid(p, corner[C_PRESSURE])) return p->value[corner[C_PRESSURE]];
    double pressure = vehicle(p, R_PRIMARY, 0.0);
    if (corner[C_SECONDARY]) pressure = vehicle(p, R_SECONDARY, pressure);
    if (corner[C_REAR] && p->points) return rear(p, pressure);
    return pressure;
}

static void refresh(Pass *p)
{
    double total = 0.0, along = 0.0;
    int count = 0;
    for (int c = 0; c < p->corners; c++) {
        const int role = p->corner[c * PER_CORNER_INTS + C_WHEEL];
        if (valid(p, role)) {
            total += fabs(p->value[role]);
            along += p->value[role];
            count++;
        }
    }
    if (valid(p, p->role[R_SPEED])) {
        along = vehicle(p, R_SPEED, 0.0);
        p->speed = fabs(along);
    } else p->speed = count ? total / (double)count : 0.0;
    p->heading = along < 0.0 ? -1.0 : 1.0;
    p->speed_known = count > 0 || valid(p, p->role[R_SPEED]);
    for (int c = 0; c < p->corners; c++) {
        const int32_t *corner = p->corner + c * PER_CORNER_INTS;
        const int role = corner[C_WHEEL];
        p->wheel[c] = valid(p, role) ? fabs(p->value[role]) : p->speed;
        const double pressure = pressure_of(p, corner);
        p->target[c] = pressure > 0.0 ? pressure : 0.0;
    }
    p->stale = 0;
}

static int corner_known(const Pass *p, int c)
{
    const int32_t *corner = p->corner + c * PER_CORNER_INTS;
    return valid(p, corner[C_PRESSURE]) || valid(p, p->role[R_PRIMARY])
        || (corner[C_SECONDARY] && valid(p, p->role[R_SECONDARY]));
}

static int pressure_known(const Pass *p)
{
    for (int c = 0; c < p->corners; c++)
        if (corner_known(p, c)) return 1;
    return 0;
}

/* All of Eq 4.11 but the change of speed, times h; that change acts on
 * *inertia_kg. */
static double outer_impulse(const Pass *p, double h, double v,
                            double *inertia_kg)
{
    const double *f = p->f;
    const double drag = v > 0.0
        ? (f[F_QUADRATIC] * v + f[F_LINEAR]) * v + f[F_CONSTANT] : 0.0;
    const double torque = vehicle(p, R_TORQUE, f[F_TORQUE]);
    const double external = vehicle(p, R_EXTERNAL, 0.0);
    const double driving = p->heading * (torque / f[F_RADIUS] + external);
    const double impulse = (driving - drag) * h;
    const int acceleration = p->role[R_ACCELERATION];
    if (p->ints[I_SLOPE] == 0 && valid(p, acceleration)) {
        const double felt =
            f[F_MASS] * (p->heading * p->value[acceleration]) * h;
        *inertia_kg = f[F_ROTATING];
        return impulse - felt;
    }
    *inertia_kg = f[F_MASS] + f[F_ROTATING];
    return impulse;
}

/* Change of the filtered speed over h; its mean is left in *middle. */
static double filter_speed(Pass *p, double h, double v, double *middle)
{
    *middle = v;
    if (!p->speed_known) {
        p->n[N_FILTERED] = UNKNOWN;
        return 0.0;
    }
    if (p->n[N_FILTERED] < 0.0) {
        p->n[N_FILTERED] = v;
        return 0.0;
    }
    const double before = p->n[N_FILTERED];
    p->n[N_FILTERED] = v + (before - v) * exp(-h / p->f[F_FILTER]);
    *middle = 0.5 * (before + p->n[N_FILTERED]);
    return p->n[N_FILTERED] - before;
}

static void integrate(Pass *p, int64_t time_us)
{
    if (time_us <= p->t[S_NOW]) return;
    if (p->stale) refresh(p);
    const double h = (double)(time_us - p->t[S_NOW]) * 1e-6;
    const double v = p->speed;
    double highest = 0.0;
    for (int c = 0; c < p->corners; c++) {
        const double *k = p->corner_f + c * PER_CORNER_FLOATS;
        const double target = p->target[c];
        double pressure;
        /* a pressure measured at the wheel has the lag in it */
        if (k[T_LAG] > 0.0
            && !valid(p, p->corner[c * PER_CORNER_INTS + C_PRESSURE])) {
            const double decay = exp(-h / k[T_LAG]);
            const double apart = p->lagged[c] - target;
            pressure = target + apart * (k[T_LAG] * (1.0 - decay) / h);
            p->lagged[c] = target + apart * decay;
        } else {
            pressure = target;
            p->lagged[c] = target;
        }
        const double pushing = pressure - k[T_PUSHOUT];
        const int pressed = pressure > p->f[F_ON_PRESSURE];
        if (pressed && pushing > 0.0) {
            const double power =
                k[T_PER_PA] * pushing * (p->wheel[c] / p->f[F_RADIUS]);
            p->energy_ff[c] += power * h;
        }
        p->pressure_sum[c] += pressure * h;
        if (pressed) p->on_time[c] += h;
        if (pressure > highest) highest = pressure;
    }
    double middle, inertia_kg;
    const double gained = filter_speed(p, h, v, &middle);
    const double impulse = outer_impulse(p, h, v, &inertia_kg);
    const double force_s = impulse - inertia_kg * gained;
    const int pressed = pressure_known(p) ? highest > p->f[F_ON_PRESSURE]
                                          : force_s > p->f[F_ON_FORCE] * h;
    if (pressed)
        p->n[N_TAIL] = inertia_kg > p->f[F_ROTATING] ? TAIL * p->f[F_FILTER]
                                                     : 0.0;
    if (pressed || p->n[N_TAIL] > 0.0) {
        p->n[N_FORCE] += force_s;
        p->n[N_ENERGY_FB] += impulse * v - inertia_kg * (gained * middle);
    }
    if (!pressed) {
        const double left = p->n[N_TAIL] - h;
        p->n[N_TAIL] = left > 0.0 ? left : 0.0;
    }
    p->n[N_SPEED] += v * h;
    p->n[N_DISTANCE] += v * h;
    p->t[S_NOW] = time_us;
}

static void clear(Pass *p)
{
    p->n[N_SPEED] = p->n[N_FORCE] = p->n[N_ENERGY_FB] = 0.0;
    for (int c = 0; c < p->corners; c++)
        p->energy_ff[c] = p->pressure_sum[c] = p->on_time[c] = 0.0;
}

static int missing(const Pass *p)
{
    int flags = 0, speed = valid(p, p->role[R_SPEED]);
    for (int c = 0; c < p->corners && !speed; c++)
        speed = valid(p, p->corner[c * PER_CORNER_INTS + C_WHEEL]);
    if (!speed) flags |= FLAG_SPEED;
    for (int c = 0; c < p->corners; c++)
        if (!corner_known(p, c))
            flags |= FLAG_PRESSURE | FLAG_CORNER_PRESSURE << c;
    if (!valid(p, p->role[R_ACCELERATION])) flags |= FLAG_ACCELERATION;
    if (!valid(p, p->role[R_TORQUE])) flags |= FLAG_TORQUE;
    if (!valid(p, p->role[R_AMBIENT])) flags |= FLAG_AMBIENT;
    return flags;
}

static void newest(const Pass *p, int role, int64_t *stamp)
{
    if (role >= 0 && p->stamp[role] > *stamp) *stamp = p->stamp[role];
}

/* Age [s] of the mandatory input that is silent longest; nan before it. */
static double input_age_s(const Pass *p)
{
    int64_t speed = NEVER, pressure = NEVER;
    newest(p, p->role[R_SPEED], &speed);
    newest(p, p->role[R_PRIMARY], &pressure);
    newest(p, p->role[R_SECONDARY], &pressure);
    for (int c = 0; c < p->corners; c++) {
        const int32_t *corner = p->corner + c * PER_CORNER_INTS;
        newest(p, corner[C_WHEEL], &speed);
        newest(p, corner[C_PRESSURE], &pressure);
    }
    const int64_t oldest =
        p->ints[I_PRESSURE] && pressure < speed ? pressure : speed;
    if (oldest == NEVER) return (double)NAN;
    return (double)(p->t[S_NOW] - oldest) * 1e-6;
}

static void close_step(Pass *p)
{
    const double dt_s = (double)(int64_t)p->f[F_STEP] * 1e-6;
    const double ambient = vehicle(p, R_AMBIENT, p->f[F_AMBIENT]);
    double wetness = vehicle(p, R_RAIN, 0.0);
    if (wetness < 0.0) wetness = 0.0;
    if (wetness > 1.0) wetness = 1.0;
    const double energy = p->n[N_ENERGY_FB];
    const double power_fb = (energy > 0.0 ? energy : 0.0) / dt_s;
    const double speed = p->n[N_SPEED] / dt_s;
    p->n[N_TOTAL_FB] += energy > 0.0 ? energy : 0.0;
    double *row = p->rows + p->steps * p->corners * CHANNELS;
    for (int c = 0; c < p->corners; c++, row += CHANNELS) {
        const double power_ff = p->energy_ff[c] / dt_s;
        const double share = p->corner_f[c * PER_CORNER_FLOATS + T_SHARE];
        p->total_ff[c] += p->energy_ff[c];
        row[0] = speed;
        row[1] = p->pressure_sum[c] / dt_s;
        row[2] = p->on_time[c] / dt_s;
        row[3] = wetness;
        row[4] = ambient;
        row[5] = p->ints[I_MODE] == 1 ? share * power_fb : power_ff;
        row[6] = p->total_ff[c];
        row[7] = share * p->n[N_TOTAL_FB];
        const int32_t *measured =
            p->corner + c * PER_CORNER_INTS + C_MEASURED;
        for (int i = 0; i < MEASURED; i++)
            row[8 + i] =
                valid(p, measured[i]) ? p->value[measured[i]] : (double)NAN;
    }
    double *whole = p->vehicle_rows + p->steps * VEHICLE_CHANNELS;
    whole[0] = speed;
    whole[1] = p->n[N_DISTANCE];
    whole[2] = (p->n[N_FORCE] > 0.0 ? p->n[N_FORCE] : 0.0) / dt_s;
    whole[3] = input_age_s(p);
    whole[4] = (double)(*p->flags | missing(p));
    p->row_times[p->steps] = p->t[S_GRID];
    p->steps++;
    *p->flags = 0;
    p->t[S_GRID] += (int64_t)p->f[F_STEP];
    clear(p);
    p->stale = 1;
}

static void start_axis(Pass *p, int64_t time_us)
{
    const int64_t step = (int64_t)p->f[F_STEP];
    int64_t whole = time_us / step;
    if (time_us % step < 0) whole--;
    p->t[S_NOW] = time_us;
    p->t[S_GRID] = (whole + 1) * step;
    clear(p);
    p->stale = 1;
}

static int march_to(Pass *p, int64_t time_us)
{
    while (p->t[S_GRID] <= time_us) {
        if (p->steps == p->room) return FULL;
        integrate(p, p->t[S_GRID]);
        close_step(p);
    }
    integrate(p, time_us);
    p->t[S_PENDING] = NEVER;
    return DONE;
}

static int move_to(Pass *p, int64_t time_us)
{
    int64_t *t = p->t;
    if (time_us > LIMIT_US || time_us < -LIMIT_US) {
        t[S_DROPPED]++;
        return DROP;
    }
    if (t[S_NOW] == NEVER) {
        start_axis(p, time_us);
        return DONE;
    }
    const int64_t ahead = time_us - t[S_NOW];
    if (ahead >= -LATE_US && ahead <= AHEAD_US) {
        if (ahead < 0) {
            t[S_LATE]++;
            return DONE;
        }
        return march_to(p, time_us);
    }
    const int64_t apart = t[S_PENDING] == NEVER ? 0 : time_us - t[S_PENDING];
    if (t[S_PENDING] == NEVER || apart == 0 || apart > CONFIRM_US
        || apart < -CONFIRM_US) {
        t[S_PENDING] = time_us;
        t[S_DROPPED]++;
        return DROP;
    }
    if (ahead > 0 && ahead <= SETTLED_US) return march_to(p, time_us);
    t[S_PENDING] = NEVER;
    t[S_JUMPS]++;
    const int settled = ahead > 0 && ahead <= CLOCK_SET_US;
    *p->flags |= settled ? FLAG_SETTLED : FLAG_JUMP;
    for (int r = 0; r < p->roles && !settled; r++)
        if (p->stamp[r] != NEVER) p->stamp[r] += ahead;
    start_axis(p, time_us);
    return settled ? SETTLE : JUMP;
}

static Py_ssize_t consume(Pass *p, const int64_t *times, const int32_t *roles,
                          const double *values, Py_ssize_t index,
                          Py_ssize_t count, int *code)
{
    for (; index < count; index++) {
        *code = move_to(p, times[index]);
        if (*code == FULL) return index;
        const int role = roles[index];
        if (*code != DROP && role >= 0 && role < p->roles
            && isfinite(values[index])) {
            p->value[role] = values[index];
            p->stamp[role] =
                times[index] > p->t[S_NOW] ? times[index] : p->t[S_NOW];
        }
        p->stale = 1;
        if (*code == SETTLE || *code == JUMP) return index + 1;
    }
    *code = DONE;
    return index;
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
        || p->corners > MAX_CORNERS || p->points < 0 || p->points > 4096)
        return "a count is out of range";
    const int k = p->corners;
    const Py_ssize_t n_ints = HEADER + VEHICLE_ROLES + k * PER_CORNER_INTS;
    const Py_ssize_t n_floats = VEHICLE_FLOATS + k * PER_CORNER_FLOATS
        + 2 * p->points + p->roles;
    const Py_ssize_t n_numbers = NUMBERS + PER_CORNER_SUMS * k + p->roles;
    p->room = view[10].len / 8;
    if (view[0].len / 4 != n_ints || view[1].len / 8 != n_floats
        || view[2].len / 8 != TIMES + p->roles
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
    p->t = view[2].buf;
    p->stamp = p->t + TIMES;
    p->n = view[3].buf;
    p->lagged = p->n + NUMBERS;
    p->energy_ff = p->lagged + k;
    p->pressure_sum = p->energy_ff + k;
    p->on_time = p->pressure_sum + k;
    p->total_ff = p->on_time + k;
    p->value = p->total_ff + k;
    p->flags = view[4].buf;
    p->rows = view[8].buf;
    p->vehicle_rows = view[9].buf;
    p->row_times = view[10].buf;
    p->steps = 0;
    p->stale = 1;
    p->speed_known = 0;
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
        first = consume(&p, view[5].buf, view[6].buf, view[7].buf, first,
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
