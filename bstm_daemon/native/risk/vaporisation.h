/* Mean probability of vapour over many temperatures: mean_probability() of
 * model/risk/vaporisation.py, one temperature at a time.
 */
#ifndef BSTM_VAPORISATION_H
#define BSTM_VAPORISATION_H

#include <stddef.h>

typedef struct {
    const double *lines; /* [count][2], for each kelvin from low_k on */
    ptrdiff_t count;
    double low_k;
    double kelvins, probabilities; /* sums */
} Vapour;

void vaporisation_add(Vapour *sum, double kelvin);

/* Mean of `count` temperatures, NaN of none and where one is no number. */
double vaporisation_mean(const Vapour *sum, double count);

#endif
