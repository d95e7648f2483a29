/* Samples from frames, the same operations in the same order as in
 * columns.py; column_plan.py lays out `outputs` and `factors`.
 */
#include "_log.h"

#include <math.h>
#include <string.h>

enum {
    O_ROLE, O_START, O_LENGTH, O_BIG_ENDIAN, O_RAW, O_SCALING, O_FLAG,
    O_SCALE, O_OFFSET, OUTPUT_FIELDS
};
enum { RAW_UNSIGNED, RAW_SIGNED, RAW_FLOATING };
enum { SCALING_NONE, SCALING_WHOLE, SCALING_REAL };
enum { F_SCALE, F_OFFSET, F_GAIN, F_BIAS, F_LOW, F_HIGH, FACTORS };
enum { NOT_A_NUMBER, OUT_OF_RANGE, COUNTS };
enum {
    PLAN, FIRST, DATA, PLANS, OUTPUTS, FACTOR, VALUES, ROLES, KEPT, COUNT,
    BUFFERS
};

static uint64_t big(const uint8_t *at)
{
    return (uint64_t)at[7] | (uint64_t)at[6] << 8 | (uint64_t)at[5] << 16
        | (uint64_t)at[4] << 24 | (uint64_t)at[3] << 32
        | (uint64_t)at[2] << 40 | (uint64_t)at[1] << 48
        | (uint64_t)at[0] << 56;
}

/* The bits of a signal that lies within the payload of `width` bytes, which
 * are at least 8. A window of 8 bytes holds all but those in the one byte
 * behind it. */
static uint64_t bits_of(const uint8_t *data, int64_t width,
                        const int64_t *output)
{
    const int64_t start = output[O_START], length = output[O_LENGTH];
    const int64_t byte = start >> 3; /* the plan has none below 0 */
    const int64_t base = byte < width - 8 ? byte : width - 8;
    const int64_t beyond = start + length - 8 * base - 64;
    uint64_t bits;
    if (output[O_BIG_ENDIAN]) {
        bits = big(data + base);
        if (beyond > 0)
            bits = bits << beyond | (uint64_t)(data[base + 8] >> (8 - beyond));
        else
            bits >>= -beyond;
    } else {
        const int64_t shift = start - 8 * base;
        bits = bstm_little(data + base) >> shift;
        if (beyond > 0) bits |= (uint64_t)data[base + 8] << (64 - shift);
    }
    return length == 64 ? bits : bits & ((UINT64_C(1) << length) - 1);
}

static double real_of(uint64_t bits, int64_t length)
{
    if (length == 32) {
        const uint32_t half = (uint32_t)bits;
        float value;
        memcpy(&value, &half, sizeof value);
        return value;
    }
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static double physical(uint64_t bits, const int64_t *output, const double *f)
{
    const int64_t length = output[O_LENGTH];
    if (output[O_RAW] == RAW_SIGNED) {
        const uint64_t sign = UINT64_C(1) << (length - 1);
        bits = (bits ^ sign) - sign;
    }
    if (output[O_SCALING] == SCALING_WHOLE) /* the plan rules out overflow */
        return (double)(int64_t)(bits * (uint64_t)output[O_SCALE]
                                 + (uint64_t)output[O_OFFSET]);
    double raw;
    if (output[O_RAW] == RAW_FLOATING) raw = real_of(bits, length);
    else if (output[O_RAW] == RAW_SIGNED) raw = (double)(int64_t)bits;
    else raw = (double)bits;
    if (output[O_SCALING] == SCALING_NONE) return raw;
    return raw * f[F_SCALE] + f[F_OFFSET];
}

static const char *extract(const Py_buffer *view, int64_t width)
{
    const int64_t *const plan = view[PLAN].buf, *const first = view[FIRST].buf;
    const int64_t *const plans = view[PLANS].buf;
    const int64_t *const outputs = view[OUTPUTS].buf;
    const double *const factors = view[FACTOR].buf;
    double *const values = view[VALUES].buf;
    int32_t *const roles = view[ROLES].buf;
    uint8_t *const kept = view[KEPT].buf;
    int64_t *const counts = view[COUNT].buf;
    const int64_t frames = view[PLAN].len / 8, slots = view[VALUES].len / 8;
    const int64_t plan_count = view[PLANS].len / 8 - 1;
    for (int64_t i = 0; i < frames; i++) {
        if (plan[i] < 0) continue;
        if (plan[i] >= plan_count) return "a frame has no plan";
        const int64_t low = plans[plan[i]], high = plans[plan[i] + 1];
        if (low == high) continue;
        if (first[i] < 0 || first[i] > slots - (high - low))
            return "a slot is out of range";
        const uint8_t *const data = (uint8_t *)view[DATA].buf + i * width;
        for (int64_t o = low; o < high; o++) {
            const int64_t *const output = outputs + o * OUTPUT_FIELDS;
            const double *const f = factors + o * FACTORS;
            const int64_t slot = first[i] + o - low;
            if (output[O_START] + output[O_LENGTH] > 8 * width)
                return "a signal lies outside the payload";
            double value = f[F_GAIN]
                * physical(bits_of(data, width, output), output, f);
            value += f[F_BIAS];
            if (!(value >= f[F_LOW] && value <= f[F_HIGH])) {
                kept[slot] = 0;
                counts[isnan(value) ? NOT_A_NUMBER : OUT_OF_RANGE]++;
            }
            values[slot] = output[O_FLAG] ? value != 0.0 : value;
            roles[slot] = (int32_t)output[O_ROLE];
        }
    }
    return NULL;
}

static const char *wrong_with(const Py_buffer *view, Py_ssize_t width)
{
    const int64_t *const plans = view[PLANS].buf;
    const int64_t *const outputs = view[OUTPUTS].buf;
    const Py_ssize_t frames = view[PLAN].len / 8, slots = view[VALUES].len / 8;
    const Py_ssize_t plan_count = view[PLANS].len / 8 - 1;
    const Py_ssize_t total = view[OUTPUTS].len / 8 / OUTPUT_FIELDS;
    if (width < 8 || width > 64 || view[FIRST].len / 8 != frames
        || view[DATA].len / width != frames || view[DATA].len % width != 0)
        return "the columns of frames have different lengths";
    if (view[ROLES].len / 4 != slots || view[KEPT].len != slots
        || view[COUNT].len / 8 != COUNTS)
        return "the columns of samples have different lengths";
    if (plan_count < 0 || plans[0] != 0 || plans[plan_count] != total
        || view[OUTPUTS].len / 8 != total * OUTPUT_FIELDS
        || view[FACTOR].len / 8 != total * FACTORS)
        return "the plan has the wrong length";
    for (Py_ssize_t p = 0; p < plan_count; p++)
        if (plans[p + 1] < plans[p]) return "the plan is out of order";
    for (Py_ssize_t o = 0; o < total; o++) {
        const int64_t *const output = outputs + o * OUTPUT_FIELDS;
        const int64_t start = output[O_START], length = output[O_LENGTH];
        if (start < 0 || start >= 512 || length < 1 || length > 64
            || (output[O_RAW] == RAW_FLOATING && length != 32
                && length != 64))
            return "a signal is out of range";
    }
    return NULL;
}

const char bstm_extract_doc[] =
"extract(plan, first, data, width, plans, outputs, factors, values, roles,\n"
"        kept, counts)\n\n"
"Write the samples of each frame from slot first on; plan int64 [n], -1:\n"
"none; data [n, width]; plans [m + 1]: where the outputs of a plan begin.\n"
"kept is cleared for samples out of range, which counts counts: not a\n"
"number, out of range. ValueError where sizes do not fit.";

PyObject *bstm_extract(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *o[BUFFERS];
    Py_ssize_t width;
    if (!PyArg_ParseTuple(args, "OOOnOOOOOOO", &o[PLAN], &o[FIRST], &o[DATA],
                          &width, &o[PLANS], &o[OUTPUTS], &o[FACTOR],
                          &o[VALUES], &o[ROLES], &o[KEPT], &o[COUNT]))
        return NULL;
    static const int writable[BUFFERS] = {0, 0, 0, 0, 0, 0, 1, 1, 1, 1};
    static const int wide[BUFFERS] = {8, 8, 1, 8, 8, 8, 8, 4, 1, 8};
    Py_buffer view[BUFFERS];
    if (bstm_log_buffers(BUFFERS, o, writable, wide, view) < 0) return NULL;
    const char *wrong = wrong_with(view, width);
    if (wrong == NULL) wrong = extract(view, width);
    for (int i = 0; i < BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    Py_RETURN_NONE;
}
