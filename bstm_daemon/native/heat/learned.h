/* Learned parameters of the car, described in model/heat/learned.py; both
 * forms do the same operations in the same order.
 */
#ifndef BSTM_LEARNED_H
#define BSTM_LEARNED_H

#include "generated.h"

void learned_begin(Learned *k, double rolling);
double learned_friction(const Learned *k, double speed, double pressure_pa,
                        double *variance);
void learned_update(Learned *k, int first, const double *h, double innovation,
                    double noise);
void learned_add_process_noise(Learned *k, int first, int last,
                               double seconds);
int learned_plausible(const Learned *k);
double learned_published_variance(double variance, double prior_var);
double learned_clipped(double value, double low, double high);
void learned_friction_row(double speed, double pressure_pa, double *h);
double learned_quadratic(const double *cov, const double *h);
double learned_product(const double *x, const double *h);

#endif
