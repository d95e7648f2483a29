/* The functions of the module, and received frames as records: receive.c fills
 * them, records.c puts them in order of time and takes their samples.
 * frame_records.py has the same layout.
 */
#ifndef BSTM_BUS_H
#define BSTM_BUS_H

#include "buffers.h"

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
