/* What the extension modules of this folder ask of Python's buffers. */
#ifndef BSTM_BUFFERS_H
#define BSTM_BUFFERS_H

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

#endif
