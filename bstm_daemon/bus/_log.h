/* What the sources of the extension module share. */
#ifndef BSTM_LOG_H
#define BSTM_LOG_H

#include "_buffers.h"

/* Frames to samples (_extract.c). */
PyObject *bstm_place(PyObject *self, PyObject *args);
PyObject *bstm_extract(PyObject *self, PyObject *args);
extern const char bstm_place_doc[], bstm_extract_doc[];

#endif
