/* Lines of a candump log into columns: the plain lines with a data frame, by
 * the grammar of candump_line.py. Any other line is handed back.
 * bus/logs/candump.py drives it.
 *
 * The text ends in a newline, and no part of a line matches one, so that no
 * loop over characters leaves the text.
 */
#include "candump_text.h"

#include <string.h>

enum {
    S_POSITION, S_LINE, S_FRAMES, S_PENDING, S_A, S_B, S_NAMES_FULL,
    S_KEYS_FULL, STATES
};
enum { DONE, NEW_NAME, NEW_KEY, NO_ROOM, NEED_WIDE };
enum { K_KEY, K_WANTED, K_COUNT, KEY_FIELDS };
enum { P_START, P_END, P_LINE, PENDING_FIELDS };
enum { LINE_LIMIT = 16384, SECOND_DIGITS = 12, FRACTION_DIGITS = 9 };
enum { CLASSIC_BYTES = 8, FD_BYTES = 64 };
enum {
    TEXT, NAMES, KEYS, STATE, TIME, LINE, CHANNEL, ID, EXTENDED, LENGTH,
    DATA, PENDING, BUFFERS
};
#define STANDARD_MAX 0x7FF
#define EXTENDED_MAX 0x1FFFFFFF

typedef struct {
    const uint8_t *seconds, *fraction, *name, *payload;
    int second_digits, fraction_digits, id_digits;
    Py_ssize_t name_length;
    uint32_t id;
} Header;

/* A header seen before, but for its digits: nearly all lines of a log begin
 * like one of a few. `fixed` has the bits that must be as expected, `carry`
 * what reaches bit 7 of a byte that is not; places are from the start. */
enum { SHAPES = 8, SHAPE_WORDS = 6 };

typedef struct {
    uint64_t expected[SHAPE_WORDS], fixed[SHAPE_WORDS], carry[SHAPE_WORDS];
    int words, channel, fraction_at, id_at;
    int second_digits, fraction_digits, id_digits;
} Shape;

/* Read what stands before the payload; 0 where it is no header. */
static int read_header(const uint8_t *at, Header *h)
{
    if (*at++ != '(') return 0;
    h->seconds = at;
    while (is_digit(*at)) at++;
    if (at - h->seconds < 1 || at - h->seconds > SECOND_DIGITS) return 0;
    h->second_digits = (int)(at - h->seconds);
    if (*at++ != '.') return 0;
    h->fraction = at;
    while (is_digit(*at)) at++;
    if (at - h->fraction < 1 || at - h->fraction > FRACTION_DIGITS) return 0;
    h->fraction_digits = (int)(at - h->fraction);
    if (*at++ != ')') return 0;
    if (!is_blank(*at)) return 0;
    while (is_blank(*at)) at++;
    h->name = at;
    while (!ends_name(*at)) at++;
    h->name_length = at - h->name;
    if (h->name_length < 1 || !is_blank(*at)) return 0;
    while (is_blank(*at)) at++;
    const uint8_t *const digits = at;
    h->id = 0;
    for (; at - digits < 8 && hex[*at]; at++)
        h->id = h->id << 4 | (uint32_t)(hex[*at] - 1);
    h->id_digits = (int)(at - digits);
    h->payload = at + 1;
    return *at == '#'
        && (h->id_digits == 3 || h->id_digits == 8 || h->id_digits == 5);
}

/* Whether the id can be that of a data frame; those of CAN XL have 5 digits,
 * those of error frames a flag above the highest id. */
static inline int is_data_id(const Header *h)
{
    if (h->id_digits == 3) return h->id <= STANDARD_MAX;
    return h->id_digits == 8 && h->id <= EXTENDED_MAX;
}

/* Number of the interface among `names`, each with a newline behind; -1. */
static int find_name(const uint8_t *names, Py_ssize_t size, const Header *h)
{
    const uint8_t *const end = names + size;
    for (int number = 0; names < end; number++) {
        Py_ssize_t same = 0;
        while (same < end - names && same < h->name_length
               && names[same] == h->name[same])
            same++;
        if (same == h->name_length && same < end - names
            && names[same] == '\n')
            return number;
        names = memchr(names + same, '\n', (size_t)(end - names - same));
        if (names == NULL) return -1;
        names++;
    }
    return -1;
}

/* Place of `key`, or the free one for it; `slots` is a power of two. -1:
 * neither. */
static Py_ssize_t find_key(const int64_t *keys, Py_ssize_t slots, int64_t key)
{
    const uint64_t mixed = (uint64_t)key * UINT64_C(0x9E3779B97F4A7C15);
    Py_ssize_t slot = (Py_ssize_t)(mixed >> 32) & (slots - 1);
    for (Py_ssize_t i = 0; i < slots; i++) {
        const int64_t found = keys[slot * KEY_FIELDS + K_KEY];
        if (found == key || found == 0) return slot;
        slot = (slot + 1) & (slots - 1);
    }
    return -1;
}

static void keep_shape(Shape *shape, const uint8_t *line, const Header *h,
                       int channel)
{
    const int size = (int)(h->payload - line);
    uint8_t expected[8 * SHAPE_WORDS] = {0}, fixed[8 * SHAPE_WORDS] = {0};
    uint8_t carry[8 * SHAPE_WORDS] = {0};
    shape->id_at = size - 1 - h->id_digits;
    for (int i = 0; i < size; i++) {
        if (i >= shape->id_at && i < size - 1) continue;
        const int digit = line + i < h->name && is_digit(line[i]);
        expected[i] = digit ? '0' : line[i];
        carry[i] = digit ? 0x80 - 10 : 0x80 - 1;
        fixed[i] = 0xFF;
    }
    for (int i = 0; i < SHAPE_WORDS; i++) {
        shape->expected[i] = bstm_little(expected + 8 * i);
        shape->fixed[i] = bstm_little(fixed + 8 * i);
        shape->carry[i] = bstm_little(carry + 8 * i);
    }
    shape->words = (size + 7) / 8;
    shape->channel = channel;
    shape->fraction_at = (int)(h->fraction - line);
    shape->second_digits = h->second_digits;
    shape->fraction_digits = h->fraction_digits;
    shape->id_digits = h->id_digits;
}

/* Read the header of a line of this shape; 0 where it has another. */
static inline int read_shape(const Shape *shape, const uint8_t *line,
                             const uint8_t *readable, Header *h)
{
    if (readable - line < 8 * SHAPE_WORDS) return 0;
    uint64_t wrong = 0;
    for (int i = 0; i < shape->words; i++) {
        /* a carry out of a byte comes only from one that is wrong */
        const uint64_t differs = (bstm_little(line + 8 * i)
                                  ^ shape->expected[i]) & shape->fixed[i];
        wrong |= differs | (differs + shape->carry[i]);
    }
    if (wrong & BSTM_EACH(0x80)) return 0;
    const uint8_t *const digits = line + shape->id_at;
    h->id = 0;
    for (int i = 0; i < shape->id_digits; i++) {
        if (!hex[digits[i]]) return 0;
        h->id = h->id << 4 | (uint32_t)(hex[digits[i]] - 1);
    }
    h->id_digits = shape->id_digits;
    h->seconds = line + 1;
    h->second_digits = shape->second_digits;
    h->fraction = line + shape->fraction_at;
    h->fraction_digits = shape->fraction_digits;
    h->payload = digits + shape->id_digits + 1;
    return 1;
}

/* The newline behind the payload of a line that ends at `at`, with or without
 * a direction flag; NULL where anything else follows. */
static inline const uint8_t *end_of_line(const uint8_t *at)
{
    if (*at == '\n') return at;
    if (is_blank(*at)) {
        while (is_blank(*at)) at++;
        const uint8_t letter = *at & 0xDF;
        if (letter == 'R' || letter == 'T') at++;
    }
    while (is_blank(*at) || *at == '\r') at++;
    return *at == '\n' ? at : NULL;
}

/* Read pairs of hex digits, `limit` at most, into `data`; behind them, or
 * NULL where a digit stands alone. */
static inline const uint8_t *read_pairs(const uint8_t *at, int limit,
                                        uint8_t *data, int *count)
{
    for (*count = 0; *count < limit && hex[at[0]]; at += 2) {
        if (!hex[at[1]]) return NULL;
        data[(*count)++] =
            (uint8_t)((hex[at[0]] - 1) << 4 | (hex[at[1]] - 1));
    }
    return at;
}

/* Read up to 8 bytes, zeros behind them, and the end of the line, whose
 * newline is returned; NULL for any other payload. */
static inline const uint8_t *read_classic(const uint8_t *at,
                                          const uint8_t *readable,
                                          uint8_t *data, uint8_t *bytes)
{
    uint32_t first, second;
    int length = CLASSIC_BYTES;
    if (readable - at >= 16 && four_bytes(bstm_little(at), &first)
        && four_bytes(bstm_little(at + 8), &second)) {
        for (int i = 0; i < 4; i++) {
            data[i] = (uint8_t)(first >> 8 * i);
            data[i + 4] = (uint8_t)(second >> 8 * i);
        }
        at += 16;
    } else {
        memset(data, 0, CLASSIC_BYTES);
        at = read_pairs(at, CLASSIC_BYTES, data, &length);
        if (at == NULL) return NULL;
    }
    *bytes = (uint8_t)length;
    return end_of_line(at);
}

/* The same for the payload of a CAN FD frame, from its second '#' on. */
static const uint8_t *read_fd(const uint8_t *at, uint8_t *data,
                              uint8_t *bytes)
{
    int length;
    if (!hex[at[1]]) return NULL;
    memset(data, 0, FD_BYTES);
    at = read_pairs(at + 2, FD_BYTES, data, &length);
    if (at == NULL || !bstm_is_fd_length((unsigned)length)) return NULL;
    *bytes = (uint8_t)length;
    return end_of_line(at);
}

static inline int64_t stamp_us(const Header *h)
{
    static const int64_t unit_us[] = {0, 100000, 10000, 1000, 100, 10, 1};
    const int digits = h->fraction_digits < 6 ? h->fraction_digits : 6;
    /* the rest of a header makes up 8 bytes with the first digit */
    const uint64_t fraction = bstm_little(h->fraction) << (64 - 8 * digits);
    return number(h->seconds, h->second_digits) * 1000000
        + eight_digits(fraction) * unit_us[digits];
}

/* Scan to the end of the text or to where Python has to decide. */
static int scan(const Py_buffer *view, Py_ssize_t end)
{
    const uint8_t *const text = view[TEXT].buf, *const stop_at = text + end;
    const uint8_t *const readable = text + view[TEXT].len;
    int64_t *const keys = view[KEYS].buf, *const state = view[STATE].buf;
    int64_t *const pending = view[PENDING].buf;
    int64_t *const time_us = view[TIME].buf, *const lines = view[LINE].buf;
    int16_t *const channels = view[CHANNEL].buf;
    uint32_t *const ids = view[ID].buf;
    uint8_t *const extendeds = view[EXTENDED].buf;
    uint8_t *const lengths = view[LENGTH].buf, *const data = view[DATA].buf;
    const Py_ssize_t slots = view[KEYS].len / 8 / KEY_FIELDS;
    const Py_ssize_t room = view[TIME].len / 8;
    const Py_ssize_t width =
        view[DATA].len == room * FD_BYTES ? FD_BYTES : CLASSIC_BYTES;
    const Py_ssize_t pending_room = view[PENDING].len / 8 / PENDING_FIELDS;
    Py_ssize_t frames = (Py_ssize_t)state[S_FRAMES];
    Py_ssize_t left = (Py_ssize_t)state[S_PENDING];
    int64_t line = state[S_LINE];
    const uint8_t *start = text + state[S_POSITION];
    Shape shapes[SHAPES];
    int shapes_kept = 0, latest = 0;
    int stop = DONE;
    while (start < stop_at) {
        if (frames >= room || left >= pending_room) {
            stop = NO_ROOM;
            break;
        }
        Header h;
        int channel = -1, settled = 0, tried = 0;
        while (tried < shapes_kept && !settled) {
            settled = read_shape(shapes + latest, start, readable, &h);
            if (settled) channel = shapes[latest].channel;
            else if (++latest >= shapes_kept) latest = 0;
            tried++;
        }
        const uint8_t *newline = NULL;
        if (!settled && read_header(start, &h)
            && h.payload - start <= LINE_LIMIT && is_data_id(&h)) {
            channel = find_name(view[NAMES].buf, view[NAMES].len, &h);
            if (channel < 0 && !state[S_NAMES_FULL]) {
                stop = NEW_NAME;
                state[S_A] = h.name - text;
                state[S_B] = h.name_length;
                break;
            }
            settled = channel >= 0;
            if (settled && shapes_kept < SHAPES
                && h.payload - start <= 8 * SHAPE_WORDS) {
                latest = shapes_kept++;
                keep_shape(shapes + latest, start, &h, channel);
            }
        }
        if (settled) {
            const int extended = h.id_digits == 8;
            int64_t *entry = NULL;
            settled = is_data_id(&h);
            if (settled) {
                /* never 0, which stands for a free place */
                const int64_t key = ((int64_t)channel + 1) << 32
                    | (int64_t)extended << 31 | h.id;
                const Py_ssize_t slot = find_key(keys, slots, key);
                settled = slot >= 0;
                if (settled) {
                    entry = keys + slot * KEY_FIELDS;
                    settled = entry[K_KEY] || !state[S_KEYS_FULL];
                }
                if (settled && entry[K_KEY] == 0) {
                    entry[K_KEY] = key;
                    stop = NEW_KEY;
                    state[S_A] = slot;
                    break;
                }
            }
            if (settled && entry[K_WANTED]) {
                const int is_fd = *h.payload == '#';
                if (is_fd && width < FD_BYTES) {
                    stop = NEED_WIDE;
                    break;
                }
                uint8_t *const payload = data + width * frames;
                newline = is_fd
                    ? read_fd(h.payload, payload, lengths + frames)
                    : read_classic(h.payload, readable, payload,
                                   lengths + frames);
                if (!is_fd && width > CLASSIC_BYTES)
                    memset(payload + CLASSIC_BYTES, 0,
                           FD_BYTES - CLASSIC_BYTES);
                settled = newline != NULL && newline - start <= LINE_LIMIT;
                if (settled) {
                    time_us[frames] = stamp_us(&h);
                    lines[frames] = line;
                    channels[frames] = (int16_t)channel;
                    ids[frames] = h.id;
                    extendeds[frames] = (uint8_t)extended;
                    frames++;
                }
            }
            if (settled) entry[K_COUNT]++;
        }
        if (newline == NULL) {
            const uint8_t *const from = settled ? h.payload : start;
            newline = memchr(from, '\n', (size_t)(stop_at - from));
        }
        if (!settled) {
            int64_t *const row = pending + left++ * PENDING_FIELDS;
            const Py_ssize_t size = newline - start;
            row[P_START] = start - text;
            row[P_END] = row[P_START] + (size < LINE_LIMIT ? size : LINE_LIMIT);
            row[P_LINE] = line;
        }
        start = newline + 1;
        line++;
    }
    state[S_POSITION] = start - text;
    state[S_LINE] = line;
    state[S_FRAMES] = frames;
    state[S_PENDING] = left;
    return stop;
}

static const char *wrong_with(const Py_buffer *view, Py_ssize_t end)
{
    const uint8_t *const text = view[TEXT].buf;
    const int64_t *const state = view[STATE].buf;
    const Py_ssize_t slots = view[KEYS].len / 8 / KEY_FIELDS;
    const Py_ssize_t room = view[TIME].len / 8;
    if (view[STATE].len / 8 != STATES) return "state has the wrong length";
    if (end < 1 || end > view[TEXT].len || text[end - 1] != '\n')
        return "the text does not end in a newline";
    if (state[S_POSITION] < 0 || state[S_POSITION] > end)
        return "the position is outside the text";
    if (state[S_FRAMES] < 0 || state[S_PENDING] < 0)
        return "a count is negative";
    if (slots < 1 || (slots & (slots - 1)) != 0
        || view[KEYS].len / 8 != slots * KEY_FIELDS)
        return "keys has the wrong length";
    if (view[LINE].len / 8 != room || view[CHANNEL].len / 2 != room
        || view[ID].len / 4 != room || view[EXTENDED].len != room
        || view[LENGTH].len != room
        || (view[DATA].len != room * CLASSIC_BYTES
            && view[DATA].len != room * FD_BYTES))
        return "a column has the wrong length";
    return NULL;
}

const char bstm_scan_doc[] =
"scan(text, end, names, keys, state, time_us, line, channel, can_id,\n"
"     extended, length, data, pending)\n\n"
"Read the lines of text[:end], which ends in a newline, from state[0] on,\n"
"behind the frames and pending lines that the columns already have.\n"
"names: interfaces, a newline behind each; keys int64 [2 ** n, 3]: key,\n"
"if wanted, lines settled; data [n, 8] or [n, 64]. Returns 0 at the end, 1 at\n"
"an interface not in names, 2 at a key that is new, 3 where a column is\n"
"full, 4 at a CAN FD frame where data has 8 columns.\n"
"ValueError where sizes do not fit.";

PyObject *bstm_scan(PyObject *Py_UNUSED(self), PyObject *args)
{
    static const int wide[BUFFERS] = {1, 1, 8, 8, 8, 8, 2, 4, 1, 1, 1, 8};
    Py_buffer view[BUFFERS];
    Py_ssize_t end;
    if (!PyArg_ParseTuple(args, "y*ny*w*w*w*w*w*w*w*w*w*w*", &view[TEXT],
                          &end, &view[NAMES], &view[KEYS], &view[STATE],
                          &view[TIME], &view[LINE], &view[CHANNEL], &view[ID],
                          &view[EXTENDED], &view[LENGTH], &view[DATA],
                          &view[PENDING])
        || bstm_widths(BUFFERS, view, wide) < 0)
        return NULL;
    const char *const wrong = wrong_with(view, end);
    /* the lock is kept, so that the text does not change meanwhile */
    const int stop = wrong == NULL ? scan(view, end) : 0;
    bstm_release(BUFFERS, view);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return PyLong_FromLong(stop);
}
