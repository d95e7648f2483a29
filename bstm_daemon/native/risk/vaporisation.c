#include "vaporisation.h"

#include <math.h>

void vaporisation_add(Vapour *sum, double kelvin)
{
    sum->kelvins += kelvin;
    if (!(kelvin > sum->low_k)) return;
    const double above_k = kelvin - sum->low_k;
    if (above_k < (double)sum->count) {
        const double *const line = sum->lines + 2 * (ptrdiff_t)above_k;
        sum->probabilities += line[0] + line[1] * kelvin;
    } else {
        sum->probabilities += 1.0;
    }
}

double vaporisation_mean(const Vapour *sum, double count)
{
    if (!(count > 0.0) || isnan(sum->kelvins)) return (double)NAN;
    return sum->probabilities / count;
}
