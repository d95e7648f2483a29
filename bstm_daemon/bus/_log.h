/* What the sources of the extension module share. */
#ifndef BSTM_LOG_H
#define BSTM_LOG_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdint.h>

/* Contiguous buffers of the objects, writable where asked, with items of the
 * given width. Returns -1 with an exception and nothing held on failure. */
int bstm_log_buffers(int n, PyObject **object, const int *writable,
                     const int *wide, Py_buffer *view);

/* 8 bytes, the first lowest; written out, as compilers make one load of it. */
static inline uint64_t bstm_little(const uint8_t *at)
{
    return (uint64_t)at[0] | (uint64_t)at[1] << 8 | (uint64_t)at[2] << 16
        | (uint64_t)at[3] << 24 | (uint64_t)at[4] << 32
        | (uint64_t)at[5] << 40 | (uint64_t)at[6] << 48
        | (uint64_t)at[7] << 56;
}

/* Frames to samples (_extract.c). */
PyObject *bstm_place(PyObject *self, PyObject *args);
PyObject *bstm_extract(PyObject *self, PyObject *args);
extern const char bstm_place_doc[], bstm_extract_doc[];

#endif
