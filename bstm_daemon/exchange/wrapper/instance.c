#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static int fail(const Instance *o, const char *text)
{
    o->log(o, FMU_ERROR, text);
    return FMU_ERROR;
}

int instance_refuse(const Instance *o, const char *what)
{
    return fail(o, what);
}

/* The network's numbers at the present tunables: those that are nominal leave
 * not a bit changed. */
static void apply_tunables(Memory *m)
{
    memcpy(m->floats, FMU_NOMINAL_FLOATS, sizeof m->floats);
    for (int i = 0; i < FMU_RESPONSES; i++) {
        const Response *r = &FMU_RESPONSE[i];
        const double d =
            m->tunable[r->tunable] - FMU_TUNABLE[r->tunable].start;
        m->floats[r->number] *= (1.0 + r->b * d) / (1.0 + r->c * d);
    }
}

void instance_reset(Instance *o)
{
    Memory *m = &o->m;
    memset(m, 0, sizeof *m);
    memcpy(m->token, FMU_TOKEN, sizeof FMU_TOKEN);
    memcpy(m->input, FMU_INPUT_START, sizeof m->input);
    memcpy(m->state, FMU_INITIAL_STATE, sizeof m->state);
    for (int i = 0; i < FMU_TUNABLES; i++)
        m->tunable[i] = FMU_TUNABLE[i].start;
    apply_tunables(m);
    for (int i = 0; i < FMU_SETS; i++)
        memcpy(m->rows + i * CHANNELS, FMU_ROW_AT_REST,
               sizeof FMU_ROW_AT_REST);
#if FMU_HEAT
    memcpy(&m->times, FMU_TIMES, sizeof m->times);
    memcpy(&m->numbers, FMU_NUMBERS, sizeof m->numbers);
#endif
}

Instance *instance_new(const char *name, const char *token,
                       void *environment, void *logger,
                       void (*log)(const Instance *, int, const char *))
{
    if (token == NULL || strcmp(token, FMU_TOKEN) != 0) return NULL;
    Instance *o = calloc(1, sizeof *o);
    if (o == NULL) return NULL;
    if (name == NULL) name = "";
    o->name = malloc(strlen(name) + 1);
    if (o->name == NULL) {
        free(o);
        return NULL;
    }
    strcpy(o->name, name);
    o->environment = environment;
    o->logger = logger;
    o->log = log;
    for (int c = 0; c < FMU_CORNERS; c++)
        if (bstm_parse(&o->structure[c], FMU_INTS + FMU_CORNER[c].ints,
                       FMU_CORNER[c].length) != NULL) {
            instance_free(o);
            return NULL;
        }
    instance_reset(o);
    return o;
}

void instance_free(Instance *o)
{
    if (o == NULL) return;
    free(o->name);
    free(o);
}

static int64_t microseconds(double time_s)
{
    return (int64_t)llround(time_s * 1e6);
}

int instance_start(Instance *o, double time_s)
{
    Memory *m = &o->m;
    if (!(fabs(time_s) < 1e9))
        return fail(o, "the start time is out of range");
    m->now_us = microseconds(time_s);
    int64_t whole = m->now_us / FMU_STEP_US;
    if (m->now_us % FMU_STEP_US < 0) whole--;
    m->grid_us = (whole + 1) * FMU_STEP_US;
    m->time_s = m->grid_s = time_s;
    return FMU_OK;
}

#if FMU_HEAT
/* Temperature between disc and pads for the friction laws; `anew`: also of
 * those that have one. */
static void heat_interfaces(Memory *m, int anew)
{
    for (int c = 0; c < FMU_CORNERS; c++) {
        const Corner *k = &FMU_CORNER[c];
        PassMemoryFloats *pass = &m->numbers.samples;
        if (!anew && pass->next_interface_k[k->set] > 0.0) continue;
        const double between =
            0.5 * (m->state[k->disc] + m->state[k->pad_front]);
        pass->next_interface_k[k->set] = between;
        if (!(pass->interface_k[k->set] > 0.0))
            pass->interface_k[k->set] = between;
    }
}

/* Every input is a sample at `now`; time goes on to `to_us`. */
static void form_row(Memory *m, int64_t to_us)
{
    int64_t times[FMU_INPUTS + 1], row_time;
    int32_t roles[FMU_INPUTS + 1], flags = (int32_t)m->flags;
    double values[FMU_INPUTS + 1];
    for (int i = 0; i < FMU_INPUTS; i++) {
        const Input *in = &FMU_INPUT[i];
        times[i] = m->now_us;
        roles[i] = in->slot;
        values[i] = in->gain * m->input[i] + in->offset;
    }
    times[FMU_INPUTS] = to_us;
    roles[FMU_INPUTS] = -1;
    values[FMU_INPUTS] = 0.0;
    Pass p = {0};
    p.in.options = (const PlanNumbersInts *)FMU_PLAN_INTS;
    p.in.plan = (const PlanNumbersFloats *)FMU_PLAN_FLOATS;
    p.in.table_front = (const double *)(p.in.plan + 1);
    p.in.table_rear = p.in.table_front + p.in.options->points;
    p.in.laws = FMU_LAWS ? p.in.table_rear + p.in.options->points : NULL;
    inputs_init(&p.in, &m->times, &m->numbers);
    p.flags = &flags;
    p.rows = m->rows;
    p.vehicle_rows = m->vehicle;
    p.row_times = &row_time;
    p.room = 1;
    int code;
    ptrdiff_t index = 0;
    /* it returns early where its caller may have to act; here nothing is */
    while (index <= FMU_INPUTS)
        index = sample_pass(&p, times, roles, values, index, FMU_INPUTS + 1,
                            &code);
    m->flags = flags;
}
#else
static void form_row(Memory *m, int64_t to_us)
{
    const double span = (double)(to_us - m->now_us);
    const int whole = to_us - m->now_us == FMU_STEP_US;
    for (int i = 0; i < FMU_INPUTS; i++) {
        const int slot = FMU_INPUT[i].slot;
        m->open[slot] += m->input[i] * span;
        if (to_us < m->grid_us) continue;
        m->rows[slot] =
            whole ? m->input[i] : m->open[slot] / (double)FMU_STEP_US;
        m->open[slot] = 0.0;
    }
}
#endif

/* March all corners over the finished step; whether all stay finite. */
static int march(Instance *o)
{
    Memory *m = &o->m;
    const double step_s = (double)FMU_STEP_US * 1e-6;
    double sum = 0.0;
    for (int c = 0; c < FMU_CORNERS; c++) {
        const Corner *k = &FMU_CORNER[c];
        const int32_t set = k->set;
        const March one = {
            .s = &o->structure[c], .floats = m->floats + k->floats,
            .state = m->state + k->state, .inputs = m->rows, .set_of = &set,
            .ledger = m->ledger + k->ledger, .dt = &step_s, .members = 1,
            .sets = FMU_SETS, .steps = 1, .rows = 1, .durations = 1,
            .every = 1, .phase = 2};
        if (bstm_march(&one) != 0) return 0;
    }
    for (int i = 0; i < FMU_STATES; i++) sum += m->state[i];
    return isfinite(sum);
}

int instance_do_step(Instance *o, double time_s, double step_s)
{
    Memory *m = &o->m;
    m->initialized = 1;
    if (!(fabs(time_s) < 1e9) || !(step_s >= 0.0 && step_s < 1e9))
        return fail(o, "time or step is out of range");
    const int64_t from_us = microseconds(time_s) - m->now_us;
    if (from_us < -1 || from_us > 1)
        return fail(o, "the step does not begin where the last one ended");
    const int64_t end_us = microseconds(time_s + step_s);
    while (m->now_us < end_us) {
        const int64_t to_us = end_us < m->grid_us ? end_us : m->grid_us;
#if FMU_HEAT
        if (FMU_LAWS) heat_interfaces(m, 0);
#endif
        form_row(m, to_us);
        m->now_us = to_us;
        if (to_us < m->grid_us) continue;
        if (!march(o)) return fail(o, "a temperature is not finite any more");
#if FMU_HEAT
        if (FMU_LAWS && to_us % FMU_COUPLING_US == 0) heat_interfaces(m, 1);
#endif
        m->grid_us += FMU_STEP_US;
        m->grid_s = (double)to_us / 1e6;
    }
    m->time_s = time_s + step_s;
    if (end_us % FMU_STEP_US != 0 && !m->warned) {
        m->warned = 1;
        o->log(o, FMU_WARNING,
               "a communication point is no multiple of the step of the "
               "model (grid_step_s): the outputs are those of grid_time_s");
    }
    return FMU_OK;
}

static double *place(Memory *m, const Variable *v)
{
    switch (v->kind) {
    case VARIABLE_INPUT: return m->input + v->index;
    case VARIABLE_TUNABLE: return m->tunable + v->index;
    case VARIABLE_STATE: return m->state + v->index;
    case VARIABLE_ROW: return m->rows + v->index;
    case VARIABLE_VEHICLE: return m->vehicle + v->index;
    case VARIABLE_GRID: return &m->grid_s;
    default: return &m->time_s;
    }
}

int instance_get(Instance *o, const uint32_t *references, size_t n,
                 double *values)
{
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= FMU_VARIABLES)
            return fail(o, "no such variable");
        values[i] = *place(&o->m, &FMU_VARIABLE[references[i]]);
    }
    return FMU_OK;
}

/* Returns NULL or what is wrong. */
static const char *check(const Memory *m, const Variable *v, double value)
{
    if (v->kind == VARIABLE_INPUT)
        return isfinite(value) || FMU_INPUT[v->index].may_be_missing
            ? NULL : "an input is not finite";
    if (v->kind == VARIABLE_TUNABLE) {
        const Tunable *t = &FMU_TUNABLE[v->index];
        return value >= t->lower && value <= t->upper
            ? NULL : "a parameter is out of its bounds";
    }
    if (v->kind != VARIABLE_STATE) return "this variable can not be set";
    if (m->initialized) return "a state is set before the first step only";
    return value >= 0.0 && value < INFINITY
        ? NULL : "a starting value is negative or not finite";
}

int instance_set(Instance *o, const uint32_t *references, size_t n,
                 const double *values)
{
    int tuned = 0;
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= FMU_VARIABLES)
            return fail(o, "no such variable");
        const Variable *v = &FMU_VARIABLE[references[i]];
        const char *wrong = check(&o->m, v, values[i]);
        if (wrong != NULL) return fail(o, wrong);
        *place(&o->m, v) = values[i];
        tuned |= v->kind == VARIABLE_TUNABLE;
    }
    if (tuned) apply_tunables(&o->m);
    return FMU_OK;
}

int instance_save(const Instance *o, void **saved)
{
    if (*saved == NULL) *saved = malloc(sizeof(Memory));
    if (*saved == NULL) return fail(o, "out of memory");
    memcpy(*saved, &o->m, sizeof(Memory));
    return FMU_OK;
}

int instance_restore(Instance *o, const void *saved)
{
    if (saved == NULL) return fail(o, "no saved state");
    memcpy(&o->m, saved, sizeof(Memory));
    return FMU_OK;
}

int instance_serialise(const Instance *o, const void *saved, void *bytes,
                       size_t size)
{
    if (saved == NULL || size < sizeof(Memory))
        return fail(o, "no saved state, or too small a buffer");
    memcpy(bytes, saved, sizeof(Memory));
    return FMU_OK;
}

int instance_deserialise(const Instance *o, const void *bytes, size_t size,
                         void **saved)
{
    if (bytes == NULL || size != sizeof(Memory)
        || memcmp(bytes, FMU_TOKEN, sizeof FMU_TOKEN) != 0)
        return fail(o, "the serialised state is another model's");
    Memory *copy = malloc(sizeof(Memory));
    if (copy == NULL) return fail(o, "out of memory");
    memcpy(copy, bytes, sizeof(Memory));
    *saved = copy;
    return FMU_OK;
}
