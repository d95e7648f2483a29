/* Advance of a check's count, as model/heat/check_rules.py. */
#ifndef BSTM_CHECK_RULES_H
#define BSTM_CHECK_RULES_H

#include "generated.h"

enum { PASSED, FAILED, OPEN };

/* The count of a check a step later; OPEN: it could not be made. */
static inline double check_rules_advance(Hysteresis h, double fault_s,
                                         int outcome, double dt_s)
{
    if (outcome == OPEN) return fault_s;
    const int latched = fault_s >= h.comes_s;
    if (outcome == FAILED) {
        fault_s = fault_s + dt_s;
        if (latched || fault_s >= h.comes_s) return h.comes_s + h.goes_s;
        return fault_s;
    }
    fault_s = fault_s - dt_s;
    return fault_s <= (latched ? h.comes_s : 0.0) ? 0.0 : fault_s;
}

#endif
