#include "learned.h"

#include <string.h>

void learned_begin(Learned *k, double rolling)
{
    memset(k, 0, sizeof *k);
    k->x[MASS] = k->x[DRAG] = 1.0;
    k->x[BIAS] = -rolling;
    k->x[GAIN] = PITCH;
    for (int i = 0; i < STATES; i++)
        k->cov[i * STATES + i] = P0_STD[i] * P0_STD[i];
    k->rolling_var = ROLLING_STD * ROLLING_STD;
}

double learned_friction(const Learned *k, double speed, double pressure_pa,
                        double *variance)
{
    double h[STATES], prior_var = 0.0;
    learned_friction_row(speed, pressure_pa, h);
    for (int i = FIRST_FRICTION; i < STATES; i++)
        prior_var += h[i] * h[i] * (P0_STD[i] * P0_STD[i]);
    *variance =
        learned_published_variance(learned_quadratic(k->cov, h), prior_var);
    return learned_product(k->x, h);
}

void learned_update(Learned *k, int first, const double *h, double innovation,
                    double noise)
{
    double ph[STATES], gain[STATES], *cov = k->cov;
    double innovation_var = noise;
    for (int i = 0; i < STATES; i++) {
        ph[i] = 0.0;
        for (int j = 0; j < STATES; j++) ph[i] += cov[i * STATES + j] * h[j];
    }
    for (int i = 0; i < STATES; i++) innovation_var += h[i] * ph[i];
    for (int i = 0; i < STATES; i++) {
        gain[i] = i < first ? 0.0 : ph[i] / innovation_var;
        const double x = k->x[i] + gain[i] * innovation;
        k->x[i] = learned_clipped(x, MIN_STATE[i], MAX_STATE[i]);
    }
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++)
            cov[i * STATES + j] -= gain[i] * ph[j] + ph[i] * gain[j]
                - gain[i] * innovation_var * gain[j];
}

void learned_add_process_noise(Learned *k, int first, int last, double seconds)
{
    for (int i = first; i < last; i++) {
        double *own = k->cov + i * STATES + i;
        if (*own < P0_STD[i] * P0_STD[i]) *own += Q[i] * Q[i] * seconds;
    }
}

int learned_plausible(const Learned *k)
{
    double total = 0.0;
    for (int i = 0; i < STATES; i++) total += k->x[i];
    for (int i = 0; i < STATES * STATES; i++) total += k->cov[i];
    total += k->rolling_error;
    total += k->rolling_var;
    if (!isfinite(total)) return 0;
    for (int i = 0; i < STATES; i++)
        if (!(k->cov[i * STATES + i] > 0.0)) return 0;
    return k->rolling_var > 0.0;
}

double learned_published_variance(double variance, double prior_var)
{
    double unlearned = variance / prior_var;
    if (unlearned > 1.0) unlearned = 1.0;
    return variance * (CAUTION + (1.0 - CAUTION) * unlearned);
}

double learned_clipped(double value, double low, double high)
{
    if (value < low) return low;
    return value > high ? high : value;
}

void learned_friction_row(double speed, double pressure_pa, double *h)
{
    const double v = speed > 1.0 ? speed : 1.0;
    const double p = pressure_pa > 5e4 ? pressure_pa : 5e4;
    for (int i = 0; i < STATES; i++) h[i] = 0.0;
    h[LEVEL] = h[DRIFT] = 1.0;
    h[SPEED] = learned_clipped(log(v / REFERENCE_SPEED_MS), -FORM_LIMIT,
                               FORM_LIMIT);
    h[PRESSURE] = learned_clipped(log(p / REFERENCE_PRESSURE_PA), -FORM_LIMIT,
                                  FORM_LIMIT);
}

double learned_quadratic(const double *cov, const double *h)
{
    double total = 0.0;
    for (int i = 0; i < STATES; i++) {
        double row = 0.0;
        for (int j = 0; j < STATES; j++) row += cov[i * STATES + j] * h[j];
        total += h[i] * row;
    }
    return total;
}

double learned_product(const double *x, const double *h)
{
    double total = 0.0;
    for (int i = 0; i < STATES; i++) total += h[i] * x[i];
    return total;
}
