/* What the sources of the extension module share. */
#ifndef BSTM_LOG_H
#define BSTM_LOG_H

#include "buffers.h"

/* Frames to samples (extract.c). */
PyObject *bstm_extract(PyObject *self, PyObject *args);
extern const char bstm_extract_doc[];

#endif
