/* Lines of a candump log into columns: the plain lines with a classic data
 * frame, by the grammar of candump_line.py. Any other line is handed back.
 * bus/candump_scan.py drives it.
 *
 * The text ends in a newline, and no part of a line matches one, so that no
 * loop over characters leaves the text.
 */
#include "_log.h"

#include <string.h>

enum {
    S_POSITION, S_LINE, S_FRAMES, S_PENDING, S_A, S_B, S_NAMES_FULL,
    S_KEYS_FULL, STATES
};
enum { DONE, NEW_NAME, NEW_KEY, NO_ROOM };
enum { K_KEY, K_VERDICT, K_COUNT, KEY_FIELDS };
enum { UNDECIDED = -1, UNWANTED = 0 };
enum { P_START, P_END, P_LINE, PENDING_FIELDS };
enum { LINE_LIMIT = 16384, SECOND_DIGITS = 12, FRACTION_DIGITS = 9 };
enum {
    TEXT, NAMES, KEYS, STATE, TIME, LINE, CHANNEL, ID, EXTENDED, LENGTH,
    DATA, PENDING, BUFFERS
};
#define STANDARD_MAX 0x7FF
#define EXTENDED_MAX 0x1FFFFFFF

/* Value of a hex digit plus one; 0: no hex digit. */
static const uint8_t hex[256] = {
    ['0'] = 1, ['1'] = 2, ['2'] = 3, ['3'] = 4, ['4'] = 5, ['5'] = 6,
    ['6'] = 7, ['7'] = 8, ['8'] = 9, ['9'] = 10, ['A'] = 11, ['B'] = 12,
    ['C'] = 13, ['D'] = 14, ['E'] = 15, ['F'] = 16, ['a'] = 11, ['b'] = 12,
    ['c'] = 13, ['d'] = 14, ['e'] = 15, ['f'] = 16,
};

typedef struct {
    const uint8_t *seconds, *fraction, *name, *payload;
    int second_digits, fraction_digits, id_digits;
    Py_ssize_t name_length;
    uint32_t id;
} Header;

static int is_digit(uint8_t c) { return (uint8_t)(c - '0') < 10; }

/* Behind the digits at `at`, 8 of them at once where that many are in the
 * text, which ends at `end`. */
static const uint8_t *skip_digits(const uint8_t *at, const uint8_t *end)
{
    while (end - at >= 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        /* a carry out of a byte comes only from one that is no digit */
        const uint64_t above = word + UINT64_C(0x4646464646464646);
        const uint64_t below = word - UINT64_C(0x3030303030303030);
        if ((word | above | below) & UINT64_C(0x8080808080808080)) break;
        at += 8;
    }
    while (is_digit(*at)) at++;
    return at;
}

static int is_blank(uint8_t c) { return c == ' ' || c == '\t'; }

static int ends_name(uint8_t c)
{
    return c == ' ' || (c >= '\t' && c <= '\r') || c == '#';
}

/* Read what stands before the payload, in a text up to `end`; 0 where it is no
 * header. */
static int read_header(const uint8_t *at, const uint8_t *end, Header *h)
{
    if (*at++ != '(') return 0;
    h->seconds = at;
    at = skip_digits(at, end);
    if (at - h->seconds < 1 || at - h->seconds > SECOND_DIGITS) return 0;
    h->second_digits = (int)(at - h->seconds);
    if (*at++ != '.') return 0;
    h->fraction = at;
    at = skip_digits(at, end);
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

static int is_open(const int64_t *entry)
{
    return entry[K_KEY] == 0 || entry[K_VERDICT] == UNDECIDED;
}

/* Read up to 8 bytes and the end of the line, whose newline is returned; NULL
 * for any other payload. `data` has been cleared. */
static const uint8_t *read_payload(const uint8_t *at, uint8_t *data,
                                   int *bytes)
{
    int length = 0;
    while (length < 8 && hex[at[0]]) {
        if (!hex[at[1]]) return NULL;
        data[length++] = (uint8_t)((hex[at[0]] - 1) << 4 | (hex[at[1]] - 1));
        at += 2;
    }
    if (is_blank(*at)) {
        while (is_blank(*at)) at++;
        const uint8_t letter = *at & 0xDF;
        if (letter == 'R' || letter == 'T') at++;
    }
    while (is_blank(*at) || *at == '\r') at++;
    *bytes = length;
    return *at == '\n' ? at : NULL;
}

/* The number in 8 digits: pairs, then fours, then eight. */
static int64_t eight_digits(const uint8_t *at)
{
    uint64_t word = bstm_little(at) & UINT64_C(0x0F0F0F0F0F0F0F0F);
    word = (word * (10 * 0x100 + 1) >> 8) & UINT64_C(0x00FF00FF00FF00FF);
    word = (word * (100 * 0x10000 + 1) >> 16) & UINT64_C(0x0000FFFF0000FFFF);
    return (int64_t)(word * (10000 * UINT64_C(0x100000000) + 1) >> 32);
}

static int64_t number(const uint8_t *at, int digits)
{
    int64_t value = 0;
    if (digits >= 8) {
        value = eight_digits(at);
        at += 8;
        digits -= 8;
    }
    for (int i = 0; i < digits; i++) value = value * 10 + (at[i] - '0');
    return value;
}

static int64_t stamp_us(const Header *h)
{
    const int digits = h->fraction_digits < 6 ? h->fraction_digits : 6;
    int64_t fraction = number(h->fraction, digits);
    for (int i = digits; i < 6; i++) fraction *= 10;
    return number(h->seconds, h->second_digits) * 1000000 + fraction;
}

/* Scan to the end of the text or to where Python has to decide. */
static int scan(const Py_buffer *view, Py_ssize_t end)
{
    const uint8_t *const text = view[TEXT].buf;
    int64_t *const keys = view[KEYS].buf, *const state = view[STATE].buf;
    int64_t *const pending = view[PENDING].buf;
    const Py_ssize_t slots = view[KEYS].len / 8 / KEY_FIELDS;
    const Py_ssize_t room = view[TIME].len / 8;
    const Py_ssize_t pending_room = view[PENDING].len / 8 / PENDING_FIELDS;
    Py_ssize_t frames = (Py_ssize_t)state[S_FRAMES];
    Py_ssize_t left = (Py_ssize_t)state[S_PENDING];
    int64_t line = state[S_LINE];
    const uint8_t *start = text + state[S_POSITION];
    int stop = DONE;
    while (start < text + end) {
        if (frames >= room || left >= pending_room) {
            stop = NO_ROOM;
            break;
        }
        Header h;
        int settled = read_header(start, text + end, &h)
            && h.payload - start <= LINE_LIMIT;
        const uint8_t *newline = NULL;
        if (settled) {
            const int channel = find_name(view[NAMES].buf, view[NAMES].len,
                                          &h);
            const int extended = h.id_digits == 8;
            if (channel < 0 && !state[S_NAMES_FULL]) {
                stop = NEW_NAME;
                state[S_A] = h.name - text;
                state[S_B] = h.name_length;
                break;
            }
            settled = channel >= 0 && h.id_digits != 5
                && h.id <= (extended ? EXTENDED_MAX : STANDARD_MAX);
            Py_ssize_t slot = -1;
            if (settled) {
                /* never 0, which stands for a free place */
                const int64_t key = ((int64_t)channel + 1) << 32
                    | (int64_t)extended << 31 | h.id;
                slot = find_key(keys, slots, key);
                settled = slot >= 0
                    && (keys[slot * KEY_FIELDS + K_KEY]
                        || !state[S_KEYS_FULL]);
                if (settled && is_open(keys + slot * KEY_FIELDS)) {
                    keys[slot * KEY_FIELDS + K_KEY] = key;
                    keys[slot * KEY_FIELDS + K_VERDICT] = UNDECIDED;
                    stop = NEW_KEY;
                    state[S_A] = slot;
                    break;
                }
            }
            if (settled && keys[slot * KEY_FIELDS + K_VERDICT] != UNWANTED) {
                uint8_t *const data = (uint8_t *)view[DATA].buf + 8 * frames;
                memset(data, 0, 8);
                int length;
                newline = read_payload(h.payload, data, &length);
                settled = newline != NULL && newline - start <= LINE_LIMIT;
                if (settled) {
                    ((int64_t *)view[TIME].buf)[frames] = stamp_us(&h);
                    ((int64_t *)view[LINE].buf)[frames] = line;
                    ((int16_t *)view[CHANNEL].buf)[frames] = (int16_t)channel;
                    ((uint32_t *)view[ID].buf)[frames] = h.id;
                    ((uint8_t *)view[EXTENDED].buf)[frames] =
                        (uint8_t)extended;
                    ((uint8_t *)view[LENGTH].buf)[frames] = (uint8_t)length;
                    frames++;
                }
            }
            if (settled) keys[slot * KEY_FIELDS + K_COUNT]++;
        }
        if (newline == NULL) {
            const uint8_t *const from = settled ? h.payload : start;
            newline = memchr(from, '\n', (size_t)(text + end - from));
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
        || view[LENGTH].len != room || view[DATA].len / 8 != room)
        return "a column has the wrong length";
    return NULL;
}

PyDoc_STRVAR(scan_doc,
"scan(text, end, names, keys, state, time_us, line, channel, can_id,\n"
"     extended, length, data, pending)\n\n"
"Read the lines of text[:end], which ends in a newline, from state[0] on,\n"
"behind the frames and pending lines that the columns already have.\n"
"names: interfaces, a newline behind each; keys int64 [2 ** n, 3]: key,\n"
"verdict, lines settled. Returns 0 at the end, 1 at an interface not in\n"
"names, 2 at a key without verdict, 3 where a column is full.\n"
"ValueError where sizes do not fit.");

static PyObject *py_scan(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *o[BUFFERS];
    Py_ssize_t end;
    if (!PyArg_ParseTuple(args, "OnOOOOOOOOOOO", &o[TEXT], &end, &o[NAMES],
                          &o[KEYS], &o[STATE], &o[TIME], &o[LINE],
                          &o[CHANNEL], &o[ID], &o[EXTENDED], &o[LENGTH],
                          &o[DATA], &o[PENDING]))
        return NULL;
    static const int writable[BUFFERS] = {0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    static const int wide[BUFFERS] = {1, 1, 8, 8, 8, 8, 2, 4, 1, 1, 1, 8};
    Py_buffer view[BUFFERS];
    if (bstm_log_buffers(BUFFERS, o, writable, wide, view) < 0) return NULL;
    const char *const wrong = wrong_with(view, end);
    /* the lock is kept: nobody may change the text meanwhile */
    const int stop = wrong == NULL ? scan(view, end) : 0;
    for (int i = 0; i < BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return PyLong_FromLong(stop);
}

int bstm_log_buffers(int n, PyObject **object, const int *writable,
                     const int *wide, Py_buffer *view)
{
    for (int i = 0; i < n; i++) {
        const int flags = writable[i] ? PyBUF_CONTIG : PyBUF_CONTIG_RO;
        int bad = PyObject_GetBuffer(object[i], &view[i], flags) < 0;
        if (!bad && view[i].itemsize != wide[i]) {
            PyErr_Format(PyExc_ValueError,
                         "buffer %d holds items of %zd bytes, not %d", i,
                         view[i].itemsize, wide[i]);
            PyBuffer_Release(&view[i]);
            bad = 1;
        }
        if (bad) {
            while (i-- > 0) PyBuffer_Release(&view[i]);
            return -1;
        }
    }
    return 0;
}

static PyMethodDef methods[] = {
    {"scan", py_scan, METH_VARARGS, scan_doc},
    {"extract", bstm_extract, METH_VARARGS, bstm_extract_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_log",
    "Compiled reading of candump logs and of samples from frames.", -1,
    methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__log(void)
{
    PyObject *const found = PyModule_Create(&module);
    if (found != NULL && PyModule_AddIntConstant(found, "LAYOUT", 1) < 0) {
        Py_DECREF(found);
        return NULL;
    }
    return found;
}
