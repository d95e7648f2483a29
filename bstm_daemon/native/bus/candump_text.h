/* Characters of a candump log, eight at once where that is quicker. */
#ifndef BSTM_CANDUMP_TEXT_H
#define BSTM_CANDUMP_TEXT_H

#include "bus.h"

#include <string.h>

#define BSTM_EACH(byte) (UINT64_C(0x0101010101010101) * (byte))

/* Value of a hex digit plus one; 0: no hex digit. */
static const uint8_t hex[256] = {
    ['0'] = 1, ['1'] = 2, ['2'] = 3, ['3'] = 4, ['4'] = 5, ['5'] = 6,
    ['6'] = 7, ['7'] = 8, ['8'] = 9, ['9'] = 10, ['A'] = 11, ['B'] = 12,
    ['C'] = 13, ['D'] = 14, ['E'] = 15, ['F'] = 16, ['a'] = 11, ['b'] = 12,
    ['c'] = 13, ['d'] = 14, ['e'] = 15, ['f'] = 16,
};

static inline int is_digit(uint8_t c) { return (uint8_t)(c - '0') < 10; }

static inline int is_blank(uint8_t c) { return c == ' ' || c == '\t'; }

static inline int ends_name(uint8_t c)
{
    return c == ' ' || (c >= '\t' && c <= '\r') || c == '#';
}

/* The number in 8 digits, the first lowest: pairs, then fours, then eight. */
static inline int64_t eight_digits(uint64_t word)
{
    word &= BSTM_EACH(0x0F);
    word = (word * (10 * 0x100 + 1) >> 8) & UINT64_C(0x00FF00FF00FF00FF);
    word = (word * (100 * 0x10000 + 1) >> 16) & UINT64_C(0x0000FFFF0000FFFF);
    return (int64_t)(word * (10000 * UINT64_C(0x100000000) + 1) >> 32);
}

/* The number in 1 to 15 digits. */
static inline int64_t number(const uint8_t *at, int digits)
{
    int64_t value = 0;
    if (digits >= 8) {
        value = eight_digits(bstm_little(at));
        at += 8;
        digits -= 8;
    }
    for (int i = 0; i < digits; i++) value = value * 10 + (at[i] - '0');
    return value;
}

/* The 4 bytes in 8 hex digits, the first lowest; 0 where one is none. */
static inline int four_bytes(uint64_t word, uint32_t *bytes)
{
    const uint64_t low = word & BSTM_EACH(0x7F);
    const uint64_t letter = (low | BSTM_EACH(0x20)) ^ BSTM_EACH(0x60);
    /* bit 7: no digit; neither a..f; not below a: no sum leaves its byte */
    const uint64_t no_digit = (low ^ BSTM_EACH('0')) + BSTM_EACH(0x80 - 10);
    const uint64_t above = letter + BSTM_EACH(0x80 - 7);
    const uint64_t from_a = letter + BSTM_EACH(0x80 - 1);
    if (((no_digit & (above | ~from_a)) | word) & BSTM_EACH(0x80)) return 0;
    uint64_t pairs = (low & BSTM_EACH(0x0F))
        + (low >> 6 & BSTM_EACH(1)) * 9;
    pairs = (pairs << 4 | pairs >> 8) & UINT64_C(0x00FF00FF00FF00FF);
    pairs = (pairs | pairs >> 8) & UINT64_C(0x0000FFFF0000FFFF);
    *bytes = (uint32_t)(pairs | pairs >> 16);
    return 1;
}

#endif
