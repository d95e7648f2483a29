/* Friction of a brake over its nominal one, as model/heat/friction_law.py. */
#ifndef BSTM_FRICTION_LAW_H
#define BSTM_FRICTION_LAW_H

#include "generated.h"

/* Linear between the points, constant outside. */
static inline double look_up(const double *table, double position)
{
    if (!(position > 0.0)) position = 0.0;
    if (position > LAW_POINTS - 1.0) position = LAW_POINTS - 1.0;
    int i = (int)position;
    if (i > LAW_POINTS - 2) i = LAW_POINTS - 2;
    return table[i] + (position - (double)i) * (table[i + 1] - table[i]);
}

static inline double friction_factor(const double *law, double temperature_k,
                                     double pressure_pa, double speed_ms)
{
    double factor =
        look_up(law + LAW_POINTS, pressure_pa * (1.0 / PRESSURE_STEP_PA))
        * look_up(law + 2 * LAW_POINTS, speed_ms * (1.0 / SPEED_STEP_MS));
    if (temperature_k > 0.0)
        factor *= look_up(law, (temperature_k - TEMPERATURE_FROM_K)
                                   * (1.0 / TEMPERATURE_STEP_K));
    return factor;
}

#endif
