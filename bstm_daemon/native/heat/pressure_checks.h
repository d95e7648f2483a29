/* Checks of the pressures, described in model/heat/pressure_checks.py; both
 * forms do the same operations in the same order. Nothing here knows Python.
 */
#ifndef BSTM_PRESSURE_CHECKS_H
#define BSTM_PRESSURE_CHECKS_H

#include "generated.h"

void pressure_checks_hold_pressures(CheckMemoryFloats *m, const Readings *now,
                                    int pressures, int unsure);
void pressure_checks_compare_switch(CheckMemoryFloats *m, const Readings *now);
void pressure_checks_compare_zero(CheckMemoryFloats *m, const Readings *now,
                                  int pressures);
void pressure_checks_compare_twins(CheckMemoryFloats *m, const Readings *now);

#endif
