/* The pass over samples, described in model/heat/sample_pass.py; both
 * forms do the same operations in the same order. python/kernel.c checks what
 * comes from Python.
 */
#ifndef BSTM_SAMPLE_PASS_H
#define BSTM_SAMPLE_PASS_H

#include <stddef.h>

#include "inputs.h"

typedef struct {
    Inputs in;
    int32_t *flags;
    double *rows, *vehicle_rows;
    int64_t *row_times;
    ptrdiff_t room, steps;
} Pass;

/* Consume samples until they or the rows end; returns the next one's index. */
ptrdiff_t sample_pass(Pass *p, const int64_t *times, const int32_t *roles,
                      const double *values, ptrdiff_t index, ptrdiff_t count,
                      int *code);

#endif
