/* The observer of the car: model/heat/observer.py says what it does; both
 * forms do the same operations in the same order.
 */
#ifndef BSTM_OBSERVER_H
#define BSTM_OBSERVER_H

#include "learned.h"
#include "observer_faults.h"

typedef struct {
    double mass_kg, rotating, rolling;
    ObserverMemory *m;
} Observer;

/* Learn from a step that ends; returns bits of what was found. */
int observer_observe(Observer *o, const Step *s);

/* Deceleration by the brakes [m/s2] and its standard deviation. */
double observer_braking(const Observer *o, double accel, double drive,
                        double drag, double rate, double *std);

#endif
