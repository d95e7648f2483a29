/* One output of a message: its value from a payload, by the rows that
 * column_plan.py lays out. The same operations in the same order as in
 * column_values.py. For frames of a log (_extract.c) and live ones
 * (_records.c).
 */
#ifndef BSTM_OUTPUT_H
#define BSTM_OUTPUT_H

#include "_buffers.h"

#include <math.h>
#include <string.h>

enum {
    O_ROLE, O_BASE, O_SHIFT, O_BEYOND, O_BIG_ENDIAN, O_LENGTH, O_RAW,
    O_SCALING, O_FLAG, O_SCALE, O_OFFSET, O_GAPS, O_GAPS_END, OUTPUT_FIELDS
};
enum { RAW_UNSIGNED, RAW_SIGNED, RAW_FLOATING };
enum { SCALING_NONE, SCALING_WHOLE, SCALING_REAL };
enum { F_SCALE, F_OFFSET, F_GAIN, F_BIAS, F_LOW, F_HIGH, FACTORS };
enum { NOT_A_NUMBER, OUT_OF_RANGE, NOT_AVAILABLE, SAMPLE_COUNTS };
enum { STANDARD_IDS = 2048, EXTENDED_BITS = 29 };

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

/* The sample of an output in *value: -1, or what makes it none. */
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

static inline const char *wrong_with_output(const int64_t *output,
                                            int64_t gaps)
{
    const int64_t length = output[O_LENGTH], beyond = output[O_BEYOND];
    const int64_t shift = output[O_SHIFT];
    /* what lies beyond a window is behind all its bits from the shift on */
    if (output[O_BASE] < 0 || output[O_BASE] > 56 || length < 1
        || length > 64 || shift < 0 || shift > 63 || beyond < 0 || beyond > 7
        || (beyond && !output[O_BIG_ENDIAN] && shift < 1)
        || (output[O_RAW] == RAW_FLOATING && length != 32 && length != 64))
        return "a signal is out of range";
    if (output[O_GAPS] < 0 || output[O_GAPS_END] < output[O_GAPS]
        || output[O_GAPS_END] > gaps)
        return "a signal's gaps are out of range";
    return NULL;
}

#endif
