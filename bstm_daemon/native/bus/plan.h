/* One frame into samples, by the extraction plan that plan_tables.py lays out:
 * decoder.py in C, the same operations in the same order. For the frames of a
 * log (extract.c) and live ones (records.c).
 */
#ifndef BSTM_PLAN_H
#define BSTM_PLAN_H

#include "bus.h"

#include <math.h>
#include <string.h>

enum {
    O_ROLE, O_BASE, O_SHIFT, O_BEYOND, O_BIG_ENDIAN, O_LENGTH, O_RAW,
    O_SCALING, O_FLAG, O_SCALE, O_OFFSET, O_GAPS, O_GAPS_END, O_CONDITIONS,
    O_CONDITIONS_END, OUTPUT_FIELDS
};
enum { RAW_UNSIGNED, RAW_SIGNED, RAW_FLOATING };
enum { SCALING_NONE, SCALING_WHOLE, SCALING_REAL };
enum { F_SCALE, F_OFFSET, F_GAIN, F_BIAS, F_LOW, F_HIGH, FACTORS };
enum { NOT_A_NUMBER, OUT_OF_RANGE, NOT_AVAILABLE, SAMPLE_COUNTS };
enum { STANDARD_IDS = 2048, EXTENDED_BITS = 29 };
enum { NO_MESSAGE = -1, WRONG_LENGTH = -2 };
enum {
    PLAN_STANDARD, PLAN_KEYS, PLAN_MESSAGES, PLAN_LENGTHS, PLAN_STARTS,
    PLAN_OUTPUTS, PLAN_FACTORS, PLAN_GAPS, PLAN_CONDITIONS, PLAN_BY_HAND,
    PLAN_BUFFERS
};

/* The tables, named as in plan_tables.py; `known` messages. */
typedef struct {
    Py_buffer view[PLAN_BUFFERS];
    const int32_t *standard, *messages;
    const int64_t *keys, *lengths, *starts, *outputs, *conditions;
    const double *factors;
    const uint64_t *gaps;
    const uint8_t *by_hand;
    Py_ssize_t buses, key_count, known;
} Plan;

static inline uint64_t big(const uint8_t *at)
{
    return (uint64_t)at[7] | (uint64_t)at[6] << 8 | (uint64_t)at[5] << 16
        | (uint64_t)at[4] << 24 | (uint64_t)at[3] << 32
        | (uint64_t)at[2] << 40 | (uint64_t)at[1] << 48
        | (uint64_t)at[0] << 56;
}

/* Position of `key` among `n` rising keys, -1 where it is not there. */
static inline Py_ssize_t find(const int64_t *keys, Py_ssize_t n, int64_t key)
{
    Py_ssize_t low = 0, high = n;
    while (low < high) {
        const Py_ssize_t middle = low + (high - low) / 2;
        if (keys[middle] < key) low = middle + 1;
        else high = middle;
    }
    return low < n && keys[low] == key ? low : -1;
}

/* The bits of a signal within a payload that reaches one byte beyond the
 * window of 8 bytes where that does not hold them all. */
static inline uint64_t bits_of(const uint8_t *data, const int64_t *output)
{
    const int64_t length = output[O_LENGTH], beyond = output[O_BEYOND];
    const int64_t shift = output[O_SHIFT];
    const uint8_t *const at = data + output[O_BASE];
    uint64_t bits;
    if (output[O_BIG_ENDIAN]) {
        bits = big(at);
        if (beyond) bits = bits << beyond | (uint64_t)(at[8] >> (8 - beyond));
        else bits >>= shift;
    } else {
        bits = bstm_little(at) >> shift;
        if (beyond) bits |= (uint64_t)at[8] << (64 - shift);
    }
    return bits & (UINT64_MAX >> (64 - length));
}

static inline double real_of(uint64_t bits, int64_t length)
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

static inline double physical(uint64_t bits, const int64_t *output,
                              const double *f)
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
    else if (output[O_RAW] == RAW_SIGNED || length < 64)
        raw = (double)(int64_t)bits;
    else raw = (double)bits;
    if (output[O_SCALING] == SCALING_NONE) return raw;
    return raw * f[F_SCALE] + f[F_OFFSET];
}

static inline int is_gap(uint64_t bits, const int64_t *output,
                         const uint64_t *gaps)
{
    for (int64_t i = output[O_GAPS]; i < output[O_GAPS_END]; i++)
        if (gaps[i] == bits) return 1;
    return 0;
}

/* A condition is a row of an output whose gaps are what its bits may be. */
static inline int holds(const Plan *p, const uint8_t *data,
                        const int64_t *output)
{
    for (int64_t i = output[O_CONDITIONS]; i < output[O_CONDITIONS_END]; i++) {
        const int64_t *const one = p->conditions + i * OUTPUT_FIELDS;
        if (!is_gap(bits_of(data, one), one, p->gaps)) return 0;
    }
    return 1;
}

/* The sample of an output in *value: -1, or why it is none. */
static inline int sample_of(const uint8_t *data, const int64_t *output,
                            const double *f, const uint64_t *gaps,
                            double *value)
{
    const uint64_t bits = bits_of(data, output);
    double si = f[F_GAIN] * physical(bits, output, f);
    si += f[F_BIAS];
    *value = output[O_FLAG] ? si != 0.0 : si;
    if (is_gap(bits, output, gaps)) return NOT_AVAILABLE;
    if (si >= f[F_LOW] && si <= f[F_HIGH]) return -1;
    return isnan(si) ? NOT_A_NUMBER : OUT_OF_RANGE;
}

/* The message of a data frame of the right length, or why there is none. */
static inline Py_ssize_t message_of(const Plan *p, int64_t bus, uint32_t id,
                                    int extended, int64_t length)
{
    Py_ssize_t found = -1;
    if (bus < 0 || bus >= p->buses) return NO_MESSAGE;
    if (!extended) {
        if (id < STANDARD_IDS)
            found = p->standard[bus * STANDARD_IDS + (Py_ssize_t)id];
    } else {
        const Py_ssize_t at = find(p->keys, p->key_count,
                                   bus << EXTENDED_BITS | id);
        if (at >= 0) found = p->messages[at];
    }
    if (found < 0 || found >= p->known) return NO_MESSAGE;
    return p->lengths[found] == length ? found : WRONG_LENGTH;
}

static inline Py_ssize_t size_of(const Plan *p, Py_ssize_t message)
{
    return (Py_ssize_t)(p->starts[message + 1] - p->starts[message]);
}

/* Write the samples of a frame of `message`, at most size_of() of them, and
 * count the values that are none. Returns the number of samples. */
static inline Py_ssize_t samples_of(const Plan *p, Py_ssize_t message,
                                    const uint8_t *data, int32_t *roles,
                                    double *values, int64_t *counts)
{
    Py_ssize_t samples = 0;
    for (int64_t o = p->starts[message]; o < p->starts[message + 1]; o++) {
        const int64_t *const output = p->outputs + o * OUTPUT_FIELDS;
        if (!holds(p, data, output)) continue;
        const int reason = sample_of(data, output, p->factors + o * FACTORS,
                                     p->gaps, values + samples);
        if (reason >= 0) counts[reason]++;
        else roles[samples++] = (int32_t)output[O_ROLE];
    }
    return samples;
}

/* `size`: bytes of the frames, 8 at least, that may be read. */
static inline const char *wrong_with_row(const int64_t *output, int64_t gaps,
                                         int64_t size)
{
    const int64_t length = output[O_LENGTH], beyond = output[O_BEYOND];
    const int64_t shift = output[O_SHIFT];
    /* what lies beyond a window is behind all its bits from the shift on */
    if (output[O_BASE] < 0 || output[O_BASE] > 56 || length < 1
        || length > 64 || shift < 0 || shift > 63 || beyond < 0 || beyond > 7
        || (beyond && !output[O_BIG_ENDIAN] && shift < 1)
        || (output[O_RAW] == RAW_FLOATING && length != 32 && length != 64))
        return "a signal is out of range";
    if (output[O_BASE] + 8 + (beyond > 0) > size)
        return "a signal lies outside the payload";
    if (output[O_GAPS] < 0 || output[O_GAPS_END] < output[O_GAPS]
        || output[O_GAPS_END] > gaps)
        return "a signal's gaps are out of range";
    return NULL;
}

static inline const char *wrong_with_output(const Plan *p,
                                            const int64_t *output,
                                            int64_t size)
{
    const int64_t gaps = p->view[PLAN_GAPS].len / 8;
    const int64_t first = output[O_CONDITIONS], end = output[O_CONDITIONS_END];
    const char *wrong = wrong_with_row(output, gaps, size);
    if (first < 0 || end < first
        || end > p->view[PLAN_CONDITIONS].len / 8 / OUTPUT_FIELDS)
        return "a signal's conditions are out of range";
    for (int64_t i = first; i < end && wrong == NULL; i++)
        wrong = wrong_with_row(p->conditions + i * OUTPUT_FIELDS, gaps, size);
    return wrong;
}

static inline const char *wrong_with_plan(const Plan *p)
{
    const Py_buffer *const view = p->view;
    const Py_ssize_t total = view[PLAN_OUTPUTS].len / 8 / OUTPUT_FIELDS;
    if (view[PLAN_STANDARD].len / 4 % STANDARD_IDS != 0
        || view[PLAN_MESSAGES].len / 4 != p->key_count
        || view[PLAN_LENGTHS].len / 8 != p->known
        || view[PLAN_STARTS].len / 8 != p->known + 1 || p->starts[0] != 0
        || p->starts[p->known] != total
        || view[PLAN_OUTPUTS].len / 8 != total * OUTPUT_FIELDS
        || view[PLAN_FACTORS].len / 8 != total * FACTORS
        || view[PLAN_CONDITIONS].len / 8 % OUTPUT_FIELDS != 0)
        return "the plan has the wrong length";
    for (Py_ssize_t m = 0; m < p->known; m++) {
        if (size_of(p, m) < 0) return "the plan is out of order";
        if (p->lengths[m] > 64) return "a message is out of range";
    }
    for (Py_ssize_t m = 0; m < p->known; m++)
        for (int64_t o = p->starts[m]; o < p->starts[m + 1]; o++) {
            const char *const wrong = wrong_with_output(
                p, p->outputs + o * OUTPUT_FIELDS,
                p->lengths[m] < 8 ? 8 : p->lengths[m]);
            if (wrong != NULL) return wrong;
        }
    return NULL;
}

/* Hold the buffers of the tuple `tables`; -1 with an exception and nothing
 * held where they are no plan. */
static inline int hold_plan(PyObject *tables, Plan *p)
{
    static const int wide[PLAN_BUFFERS] = {4, 8, 4, 8, 8, 8, 8, 8, 8, 1};
    Py_buffer *const v = p->view;
    if (PyTuple_Size(tables) != PLAN_BUFFERS) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_ValueError, "the plan has other tables");
        return -1;
    }
    if (!PyArg_ParseTuple(tables, "y*y*y*y*y*y*y*y*y*y*", v, v + 1, v + 2,
                          v + 3, v + 4, v + 5, v + 6, v + 7, v + 8, v + 9)
        || bstm_widths(PLAN_BUFFERS, v, wide) < 0)
        return -1;
    p->standard = p->view[PLAN_STANDARD].buf;
    p->messages = p->view[PLAN_MESSAGES].buf;
    p->keys = p->view[PLAN_KEYS].buf;
    p->lengths = p->view[PLAN_LENGTHS].buf;
    p->starts = p->view[PLAN_STARTS].buf;
    p->outputs = p->view[PLAN_OUTPUTS].buf;
    p->factors = p->view[PLAN_FACTORS].buf;
    p->gaps = p->view[PLAN_GAPS].buf;
    p->conditions = p->view[PLAN_CONDITIONS].buf;
    p->by_hand = p->view[PLAN_BY_HAND].buf;
    p->buses = p->view[PLAN_STANDARD].len / 4 / STANDARD_IDS;
    p->key_count = p->view[PLAN_KEYS].len / 8;
    p->known = p->view[PLAN_BY_HAND].len;
    const char *const wrong = wrong_with_plan(p);
    if (wrong == NULL) return 0;
    PyErr_SetString(PyExc_ValueError, wrong);
    bstm_release(PLAN_BUFFERS, p->view);
    return -1;
}

#endif
