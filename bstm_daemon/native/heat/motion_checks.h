/* Checks of the accelerometer and of all speeds against each other, described
 * in model/heat/motion_checks.py; both forms do the same operations in the
 * same order.
 */
#ifndef BSTM_MOTION_CHECKS_H
#define BSTM_MOTION_CHECKS_H

#include "generated.h"

/* Follow speed and accelerometer through a step; noise: not to use. */
void motion_checks_compare_motion(CheckMemoryFloats *m, const Readings *now,
                                  int speeds, int noise);
/* Compare what speed and yaw rate make of a bend with what is felt. */
void motion_checks_compare_turns(CheckMemoryFloats *m, const Readings *now);
int motion_checks_too_slow_in_bends(const CheckMemoryFloats *m);
int motion_checks_stand_shown(const CheckMemoryFloats *m);
int motion_checks_contradicted(const CheckMemoryFloats *m);
int motion_checks_wrong_scale(const CheckMemoryFloats *m);
int motion_checks_leaps(const CheckMemoryFloats *m, double median);
/* Forget what proved the speeds where all of them leap. */
void motion_checks_watch_leap(CheckMemoryFloats *m, const Readings *now,
                              double median, int count);
int motion_checks_unproven(const CheckMemoryFloats *m, double braked_j);
int motion_checks_all_frozen(const CheckMemoryFloats *m);

#endif
