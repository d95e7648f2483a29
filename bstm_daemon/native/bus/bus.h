/* The functions of the module, what they ask of Python's buffers, and received
 * frames as records: receive.c fills them, records.c puts them in order of time
 * and takes their samples. frame_records.py has the same layout.
 */
#ifndef BSTM_BUS_H
#define BSTM_BUS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdint.h>

static inline void bstm_release(int n, Py_buffer *view)
{
    for (int i = 0; i < n; i++) PyBuffer_Release(&view[i]);
}

/* Whether buffers have items of the given widths; -1 with an exception and
 * nothing held where one has not. */
static inline int bstm_widths(int n, Py_buffer *view, const int *wide)
{
    for (int i = 0; i < n; i++)
        if (view[i].itemsize != wide[i]) {
            PyErr_Format(PyExc_ValueError,
                         "buffer %d holds items of %zd bytes, not %d", i,
                         view[i].itemsize, wide[i]);
            bstm_release(n, view);
            return -1;
        }
    return 0;
}

/* 8 bytes, the first lowest; written out, as compilers make one load of it. */
static inline uint64_t bstm_little(const uint8_t *at)
{
    return (uint64_t)at[0] | (uint64_t)at[1] << 8 | (uint64_t)at[2] << 16
        | (uint64_t)at[3] << 24 | (uint64_t)at[4] << 32
        | (uint64_t)at[5] << 40 | (uint64_t)at[6] << 48
        | (uint64_t)at[7] << 56;
}

/* Whether a CAN FD frame can have this many bytes (ISO 11898-1). */
static inline int bstm_is_fd_length(unsigned length)
{
    return length <= 8 || length == 12 || length == 16 || length == 20
        || length == 24 || length == 32 || length == 48 || length == 64;
}

enum { DATA_BYTES = 64 };

typedef struct {
    int64_t stamp_ns; /* wall time */
    int64_t time_us;  /* on the axis of the service */
    uint32_t id;      /* without its flags; of an error frame its classes */
    int32_t bus;
    uint8_t extended, length, error, remote;
    uint32_t reserved;
    uint8_t data[DATA_BYTES]; /* zero behind length */
} Record;

/* The records in `store`; NULL with an exception where it has another size. */
static inline Record *bstm_records(const Py_buffer *store, Py_ssize_t first,
                                   Py_ssize_t end)
{
    const Py_ssize_t room = store->len / (Py_ssize_t)sizeof(Record);
    if (store->len % (Py_ssize_t)sizeof(Record) || first < 0 || end < first
        || end > room || (uintptr_t)store->buf % sizeof(int64_t)) {
        PyErr_SetString(PyExc_ValueError, "records are out of range");
        return NULL;
    }
    return store->buf;
}

PyObject *bstm_scan(PyObject *self, PyObject *args);
PyObject *bstm_extract(PyObject *self, PyObject *args);
PyObject *bstm_receive(PyObject *self, PyObject *args);
PyObject *bstm_place_in_time(PyObject *self, PyObject *args);
PyObject *bstm_sort(PyObject *self, PyObject *args);
PyObject *bstm_take(PyObject *self, PyObject *args);
extern const char bstm_scan_doc[], bstm_extract_doc[], bstm_receive_doc[],
    bstm_place_in_time_doc[], bstm_sort_doc[], bstm_take_doc[];

#endif
