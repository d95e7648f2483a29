/* Samples from frames, the same operations in the same order as in
 * column_values.py; column_plan.py lays out the tables.
 */
#include "_log.h"
#include "_output.h"

enum { UNKNOWN_INTERFACE, UNKNOWN_ID, WRONG_LENGTH, FRAME_COUNTS };
enum {
    P_CHANNEL, P_ID, P_EXTENDED, P_LENGTH, P_ROWS, P_STANDARD, P_KEYS,
    P_MESSAGES, P_LENGTHS, P_SIZES, P_MESSAGE, P_COUNT, PLACE_BUFFERS
};
enum {
    E_MESSAGE, E_TIME, E_DATA, E_SIZES, E_STARTS, E_OUTPUTS, E_FACTORS,
    E_GAPS, E_TIMES, E_ROLES, E_VALUES, E_KEPT, E_COUNT, EXTRACT_BUFFERS
};

/* Write each frame's message, -1 where it has none; returns the number of
 * samples to come, or -1 with `wrong` set. */
static Py_ssize_t place(const Py_buffer *view, const char **wrong)
{
    const int16_t *const channel = view[P_CHANNEL].buf;
    const uint32_t *const id = view[P_ID].buf;
    const uint8_t *const extended = view[P_EXTENDED].buf;
    const uint8_t *const length = view[P_LENGTH].buf;
    const int64_t *const rows = view[P_ROWS].buf;
    const int32_t *const standard = view[P_STANDARD].buf;
    const int64_t *const keys = view[P_KEYS].buf;
    const int32_t *const messages = view[P_MESSAGES].buf;
    const int64_t *const lengths = view[P_LENGTHS].buf;
    const int64_t *const sizes = view[P_SIZES].buf;
    int32_t *const message = view[P_MESSAGE].buf;
    int64_t *const counts = view[P_COUNT].buf;
    const Py_ssize_t frames = view[P_MESSAGE].len / 4;
    const Py_ssize_t channels = view[P_ROWS].len / 8;
    const Py_ssize_t known = view[P_SIZES].len / 8 - 1;
    const Py_ssize_t key_count = view[P_KEYS].len / 8;
    const int64_t row_count = view[P_STANDARD].len / 4 / STANDARD_IDS;
    Py_ssize_t samples = 0;
    for (Py_ssize_t i = 0; i < frames; i++) {
        message[i] = -1;
        if (channel[i] < 0 || channel[i] >= channels) {
            *wrong = "a channel is out of range";
            return -1;
        }
        const int64_t row = rows[channel[i]];
        if (row < 0) {
            counts[UNKNOWN_INTERFACE]++;
            continue;
        }
        if (row >= row_count) {
            *wrong = "a row is out of range";
            return -1;
        }
        int32_t found = -1;
        if (!extended[i]) {
            found = standard[row * STANDARD_IDS + id[i] % STANDARD_IDS];
        } else if (key_count) {
            const Py_ssize_t at = find(keys, key_count,
                                       row << EXTENDED_BITS | id[i]);
            if (at >= 0) found = messages[at];
        }
        if (found < 0) {
            counts[UNKNOWN_ID]++;
        } else if (found >= known) {
            *wrong = "a message is out of range";
            return -1;
        } else if (lengths[found] != length[i]) {
            counts[WRONG_LENGTH]++;
        } else {
            message[i] = found;
            samples += (Py_ssize_t)sizes[found];
        }
    }
    return samples;
}

static const char *extract(const Py_buffer *view, int64_t width)
{
    const int32_t *const message = view[E_MESSAGE].buf;
    const int64_t *const time_us = view[E_TIME].buf;
    const int64_t *const sizes = view[E_SIZES].buf;
    const int64_t *const starts = view[E_STARTS].buf;
    const int64_t *const outputs = view[E_OUTPUTS].buf;
    const double *const factors = view[E_FACTORS].buf;
    const uint64_t *const gaps = view[E_GAPS].buf;
    int64_t *const times = view[E_TIMES].buf;
    int32_t *const roles = view[E_ROLES].buf;
    double *const values = view[E_VALUES].buf;
    uint8_t *const kept = view[E_KEPT].buf;
    int64_t *const counts = view[E_COUNT].buf;
    const Py_ssize_t frames = view[E_MESSAGE].len / 4;
    const int64_t slots = view[E_VALUES].len / 8;
    const int64_t known = view[E_SIZES].len / 8 - 1;
    const uint8_t *data = view[E_DATA].buf;
    int64_t slot = 0;
    for (Py_ssize_t i = 0; i < frames; i++, data += width) {
        if (message[i] < 0) continue;
        if (message[i] >= known) return "a message is out of range";
        const int64_t size = sizes[message[i]];
        if (size < 0 || size > slots - slot) return "a slot is out of range";
        const int64_t first = starts[message[i]];
        const int foreign = starts[message[i] + 1] == first;
        if (!foreign && starts[message[i] + 1] - first != size)
            return "the plan has other sizes";
        for (int64_t o = 0; o < size; o++, slot++) {
            times[slot] = time_us[i];
            kept[slot] = 1;
            if (foreign) continue;
            const int64_t *const output = outputs + (first + o)
                * OUTPUT_FIELDS;
            const double *const f = factors + (first + o) * FACTORS;
            if (output[O_BASE] + 8 + (output[O_BEYOND] > 0) > width)
                return "a signal lies outside the payload";
            roles[slot] = (int32_t)output[O_ROLE];
            const int refusal = sample_of(data, output, f, gaps,
                                          values + slot);
            if (refusal >= 0) {
                kept[slot] = 0;
                counts[refusal]++;
            }
        }
    }
    return slot == slots ? NULL : "a slot is left over";
}

static const char *wrong_with_place(const Py_buffer *view)
{
    const Py_ssize_t frames = view[P_MESSAGE].len / 4;
    if (view[P_CHANNEL].len / 2 != frames || view[P_ID].len / 4 != frames
        || view[P_EXTENDED].len != frames || view[P_LENGTH].len != frames)
        return "the columns of frames have different lengths";
    if (view[P_STANDARD].len / 4 % STANDARD_IDS != 0
        || view[P_KEYS].len / 8 != view[P_MESSAGES].len / 4
        || view[P_SIZES].len < 8 || view[P_LENGTHS].len != view[P_SIZES].len
        || view[P_COUNT].len / 8 != FRAME_COUNTS)
        return "the plan has the wrong length";
    return NULL;
}

static const char *wrong_with_extract(const Py_buffer *view,
                                      Py_ssize_t width)
{
    const int64_t *const starts = view[E_STARTS].buf;
    const int64_t *const outputs = view[E_OUTPUTS].buf;
    const Py_ssize_t frames = view[E_MESSAGE].len / 4;
    const Py_ssize_t slots = view[E_VALUES].len / 8;
    const Py_ssize_t known = view[E_SIZES].len / 8 - 1;
    const Py_ssize_t total = view[E_OUTPUTS].len / 8 / OUTPUT_FIELDS;
    if (width < 8 || width > 64 || view[E_TIME].len / 8 != frames
        || view[E_DATA].len / width != frames || view[E_DATA].len % width)
        return "the columns of frames have different lengths";
    if (view[E_TIMES].len / 8 != slots || view[E_ROLES].len / 4 != slots
        || view[E_KEPT].len != slots
        || view[E_COUNT].len / 8 != SAMPLE_COUNTS)
        return "the columns of samples have different lengths";
    if (known < 0 || view[E_STARTS].len / 8 != known + 1 || starts[0] != 0
        || starts[known] != total
        || view[E_OUTPUTS].len / 8 != total * OUTPUT_FIELDS
        || view[E_FACTORS].len / 8 != total * FACTORS)
        return "the plan has the wrong length";
    for (Py_ssize_t m = 0; m < known; m++)
        if (starts[m + 1] < starts[m]) return "the plan is out of order";
    for (Py_ssize_t o = 0; o < total; o++) {
        const char *const wrong = wrong_with_output(
            outputs + o * OUTPUT_FIELDS, view[E_GAPS].len / 8);
        if (wrong != NULL) return wrong;
    }
    return NULL;
}

const char bstm_place_doc[] =
"place(channel, can_id, extended, length, rows, standard, keys, messages,\n"
"      lengths, sizes, message, counts)\n\n"
"Write the message of each frame, -1 for none, and return the number of\n"
"slots of all. rows [channels]: row in standard [rows, 2048] and in the\n"
"rising keys (row * 2 ** 29 + id) of messages; lengths and sizes [m + 1].\n"
"counts: of unread interfaces, unknown ids, wrong lengths. ValueError where\n"
"sizes do not fit.";

PyObject *bstm_place(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *o[PLACE_BUFFERS];
    if (!PyArg_ParseTuple(args, "OOOOOOOOOOOO", &o[P_CHANNEL], &o[P_ID],
                          &o[P_EXTENDED], &o[P_LENGTH], &o[P_ROWS],
                          &o[P_STANDARD], &o[P_KEYS], &o[P_MESSAGES],
                          &o[P_LENGTHS], &o[P_SIZES], &o[P_MESSAGE],
                          &o[P_COUNT]))
        return NULL;
    static const int writable[PLACE_BUFFERS] = {[P_MESSAGE] = 1,
                                                [P_COUNT] = 1};
    static const int wide[PLACE_BUFFERS] = {2, 4, 1, 1, 8, 4, 8, 4, 8, 8, 4,
                                            8};
    Py_buffer view[PLACE_BUFFERS];
    if (bstm_log_buffers(PLACE_BUFFERS, o, writable, wide, view) < 0)
        return NULL;
    const char *wrong = wrong_with_place(view);
    const Py_ssize_t samples = wrong == NULL ? place(view, &wrong) : -1;
    for (int i = 0; i < PLACE_BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return PyLong_FromSsize_t(samples);
}

const char bstm_extract_doc[] =
"extract(message, time_us, data, width, sizes, starts, outputs, factors,\n"
"        gaps, times, roles, values, kept, counts)\n\n"
"Write the samples of each frame, one slot an output, frame after frame;\n"
"data [n, width]; starts [m + 1]: where the outputs of a message begin. Of\n"
"a message without any, only times and kept are written. kept is 0 for what\n"
"is no sample, which counts counts: not a number, out of range, not\n"
"available. ValueError where sizes do not fit.";

PyObject *bstm_extract(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *o[EXTRACT_BUFFERS];
    Py_ssize_t width;
    if (!PyArg_ParseTuple(args, "OOOnOOOOOOOOOO", &o[E_MESSAGE], &o[E_TIME],
                          &o[E_DATA], &width, &o[E_SIZES], &o[E_STARTS],
                          &o[E_OUTPUTS], &o[E_FACTORS], &o[E_GAPS],
                          &o[E_TIMES], &o[E_ROLES], &o[E_VALUES],
                          &o[E_KEPT], &o[E_COUNT]))
        return NULL;
    static const int writable[EXTRACT_BUFFERS] = {
        [E_TIMES] = 1, [E_ROLES] = 1, [E_VALUES] = 1, [E_KEPT] = 1,
        [E_COUNT] = 1};
    static const int wide[EXTRACT_BUFFERS] = {4, 8, 1, 8, 8, 8, 8, 8, 8, 4, 8,
                                              1, 8};
    Py_buffer view[EXTRACT_BUFFERS];
    if (bstm_log_buffers(EXTRACT_BUFFERS, o, writable, wide, view) < 0)
        return NULL;
    const char *wrong = wrong_with_extract(view, width);
    if (wrong == NULL) wrong = extract(view, width);
    for (int i = 0; i < EXTRACT_BUFFERS; i++) PyBuffer_Release(&view[i]);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    Py_RETURN_NONE;
}
