/* What the sources of the extension module share of Python. */
#ifndef BSTM_KERNEL_H
#define BSTM_KERNEL_H

#include <Python.h>

/* Contiguous buffers of the objects, writable where asked, with items of the
 * given width. Returns -1 with an exception and nothing held on failure. */
int bstm_buffers(int n, PyObject **object, const int *writable,
                 const int *wide, Py_buffer *view);

/* The pass over samples (native/heat/sample_bind.c). */
PyObject *bstm_sample_pass(PyObject *self, PyObject *args);
extern const char bstm_sample_pass_doc[];

#endif
