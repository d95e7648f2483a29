/* The frames of a log into samples; bus/signals/columns.py drives it. What the
 * plan leaves to decoder.py is handed back, frame by frame.
 */
#include "bus.h"
#include "plan.h"

enum { R_UNKNOWN_INTERFACE, R_UNKNOWN_ID, R_WRONG_LENGTH, FRAME_COUNTS };
enum {
    E_CHANNEL, E_ID, E_EXTENDED, E_LENGTH, E_TIME, E_DATA, E_BUSES, E_TIMES,
    E_ROLES, E_VALUES, E_FRAME_COUNTS, E_SAMPLE_COUNTS, BUFFERS
};

typedef struct {
    Py_ssize_t at, samples;
} Place;

static const char *extract(const Py_buffer *view, const Plan *plan,
                           Place *place)
{
    const int16_t *const channel = view[E_CHANNEL].buf;
    const uint32_t *const id = view[E_ID].buf;
    const uint8_t *const extended = view[E_EXTENDED].buf;
    const uint8_t *const length = view[E_LENGTH].buf;
    const int64_t *const time_us = view[E_TIME].buf;
    const uint8_t *const data = view[E_DATA].buf;
    const int64_t *const buses = view[E_BUSES].buf;
    int64_t *const times = view[E_TIMES].buf;
    int32_t *const roles = view[E_ROLES].buf;
    double *const values = view[E_VALUES].buf;
    int64_t *const frame_counts = view[E_FRAME_COUNTS].buf;
    int64_t *const sample_counts = view[E_SAMPLE_COUNTS].buf;
    const Py_ssize_t frames = view[E_TIME].len / 8;
    const Py_ssize_t width = frames ? view[E_DATA].len / frames : 0;
    const Py_ssize_t channels = view[E_BUSES].len / 8;
    const Py_ssize_t room = view[E_TIMES].len / 8;
    for (; place->at < frames; place->at++) {
        const Py_ssize_t i = place->at;
        if (channel[i] < 0 || channel[i] >= channels)
            return "a channel is out of range";
        if (buses[channel[i]] < 0) {
            frame_counts[R_UNKNOWN_INTERFACE]++;
            continue;
        }
        const Py_ssize_t message = message_of(plan, buses[channel[i]], id[i],
                                              extended[i], length[i]);
        if (message < 0) {
            const int is_known = message == WRONG_LENGTH;
            frame_counts[is_known ? R_WRONG_LENGTH : R_UNKNOWN_ID]++;
            continue;
        }
        if (plan->by_hand[message]) return NULL;
        if (length[i] > width) return "a frame is longer than its column";
        if (size_of(plan, message) > room - place->samples)
            return "the columns of samples are full";
        const Py_ssize_t end = place->samples
            + samples_of(plan, message, data + i * width,
                         roles + place->samples, values + place->samples,
                         sample_counts);
        while (place->samples < end) times[place->samples++] = time_us[i];
    }
    return NULL;
}

static const char *wrong_with(const Py_buffer *view, const Place *place)
{
    const Py_ssize_t frames = view[E_TIME].len / 8;
    const Py_ssize_t room = view[E_TIMES].len / 8;
    if (view[E_CHANNEL].len / 2 != frames || view[E_ID].len / 4 != frames
        || view[E_EXTENDED].len != frames || view[E_LENGTH].len != frames
        || (view[E_DATA].len != frames * 8 && view[E_DATA].len != frames * 64))
        return "the columns of frames have different lengths";
    if (view[E_ROLES].len / 4 != room || view[E_VALUES].len / 8 != room
        || view[E_FRAME_COUNTS].len / 8 != FRAME_COUNTS
        || view[E_SAMPLE_COUNTS].len / 8 != SAMPLE_COUNTS)
        return "the columns of samples have different lengths";
    if (place->at < 0 || place->samples < 0 || place->samples > room)
        return "a place is outside the columns";
    return NULL;
}

const char bstm_extract_doc[] =
"extract(plan, first, samples, channel, can_id, extended, length, time_us,\n"
"        data, buses, times, roles, values, frame_counts, sample_counts)\n\n"
"Write the samples of the frames from `first` on behind those there are, up\n"
"to a frame whose message is marked by_hand. plan: a tuple, as plan_tables.py\n"
"has it; data [n, 8] or [n, 64]; buses: of each channel, -1 unread. Adds to\n"
"frame_counts: of unread interfaces, unknown ids, wrong lengths; to\n"
"sample_counts: not a number, out of range, not available. Returns (the frame\n"
"it stopped at, samples). ValueError where sizes do not fit.";

PyObject *bstm_extract(PyObject *Py_UNUSED(self), PyObject *args)
{
    static const int wide[BUFFERS] = {2, 4, 1, 1, 8, 1, 8, 8, 4, 8, 8, 8};
    PyObject *tables;
    Py_buffer view[BUFFERS];
    Place place;
    Plan plan;
    if (!PyArg_ParseTuple(args, "Onny*y*y*y*y*y*y*w*w*w*w*w*", &tables,
                          &place.at, &place.samples, &view[E_CHANNEL],
                          &view[E_ID], &view[E_EXTENDED], &view[E_LENGTH],
                          &view[E_TIME], &view[E_DATA], &view[E_BUSES],
                          &view[E_TIMES], &view[E_ROLES], &view[E_VALUES],
                          &view[E_FRAME_COUNTS], &view[E_SAMPLE_COUNTS])
        || bstm_widths(BUFFERS, view, wide) < 0)
        return NULL;
    if (hold_plan(tables, &plan) < 0) {
        bstm_release(BUFFERS, view);
        return NULL;
    }
    const char *wrong = wrong_with(view, &place);
    if (wrong == NULL) wrong = extract(view, &plan, &place);
    bstm_release(BUFFERS, view);
    bstm_release(PLAN_BUFFERS, plan.view);
    if (wrong != NULL) {
        PyErr_SetString(PyExc_ValueError, wrong);
        return NULL;
    }
    return Py_BuildValue("nn", place.at, place.samples);
}
