/* Fault detection on the observer's inputs, described in
 * model/heat/observer_faults.py; both forms do the same operations in the same
 * order.
 */
#ifndef BSTM_OBSERVER_FAULTS_H
#define BSTM_OBSERVER_FAULTS_H

#include "generated.h"

int observer_faults_findings(const ObserverMemory *m, const Step *s);
int observer_faults_implausible_gain(const ObserverMemory *m);
int observer_faults_motion_unmeasured(const ObserverMemory *m);
int observer_faults_implausible_radius(const ObserverMemory *m);
/* Count windows in which a drive [m/s2] moves the car too little. */
void observer_faults_count_drive(ObserverMemory *m, double innovation,
                                 double std, double drive);
/* Whether ln friction is not to be learned; count what contradicts. */
int observer_faults_is_outlier(ObserverMemory *m, double innovation,
                               double std);
void observer_faults_compare_forces(ObserverMemory *m, double x, double y,
                                    double std);
void observer_faults_compare_radius(ObserverMemory *m, const Step *s);

#endif
