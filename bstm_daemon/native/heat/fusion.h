/* Brake power of each corner, fused from pressure and motion; described in
 * model/heat/fusion.py; both forms do the same operations in the same order.
 */
#ifndef BSTM_FUSION_H
#define BSTM_FUSION_H

#include "inputs.h"

/* Power of a step and its standard deviation per corner [W]. */
typedef struct {
    int64_t flags;
    double power[MAX_CORNERS], power_std[MAX_CORNERS];
} Fused;

void fusion_accumulate_motion(Inputs *p, double h);

/* Learn from the step that ends and give each corner's power; the vehicle's
 * channels from the grade on are written into *learned. */
Fused fusion_fuse(Inputs *p, const Readings *now, int64_t flags,
                  double *learned);

#endif
