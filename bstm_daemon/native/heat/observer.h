/* The vehicle observer, described in model/heat/observer.py; both forms do
 * the same operations in the same order.
 */
#ifndef BSTM_OBSERVER_H
#define BSTM_OBSERVER_H

#include "learned.h"
#include "observer_faults.h"

typedef struct {
    double mass_kg, rotating, rolling;
    ObserverMemory *m;
} Observer;

/* Update the filters with a finished step; returns bits of findings. */
int observer_observe(Observer *o, const Step *s);

/* Deceleration by the brakes [m/s2] and its standard deviation. */
double observer_braking(const Observer *o, double accel, double drive,
                        double drag, double rate, double *std);

#endif
