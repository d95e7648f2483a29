/* What is learned of the car: heat/learned.py says what this does and does
 * the same operations in the same order; heat/observer_rules.py has the
 * reasons for the numbers.
 */
#include "_observer.h"

#define REFERENCE_PRESSURE 1e6
#define FORM_LIMIT 1.5

const double BSTM_SD[STATES] = {0.2, 0.15, 0.3, 0.02, 0.25, 0.08, 0.08,
                                  0.02};
static const double WALK[STATES] = {1e-4, 3e-4, 2e-2, 1e-5, 5e-4, 1e-4, 1e-4,
                                    0.0};
static const double LOW[STATES] = {0.5, -0.9, 0.2, -0.15, -1.1, -0.4, -0.4,
                                   -0.4};
static const double HIGH[STATES] = {2.0, 0.6, 3.0, 0.25, 0.7, 0.4, 0.4, 0.4};

double bstm_clipped(double value, double low, double high)
{
    if (value < low) return low;
    return value > high ? high : value;
}

double bstm_quadratic(const double *cov, const double *h)
{
    double total = 0.0;
    for (int i = 0; i < STATES; i++) {
        double row = 0.0;
        for (int j = 0; j < STATES; j++) row += cov[i * STATES + j] * h[j];
        total += h[i] * row;
    }
    return total;
}

double bstm_product(const double *x, const double *h)
{
    double total = 0.0;
    for (int i = 0; i < STATES; i++) total += h[i] * x[i];
    return total;
}

/* One Kalman update of the states from *first* on, kept between LOW and
 * HIGH; those before are considered, not changed (Schmidt). */
void bstm_update(double *n, int first, const double *h, double apart,
                   double noise)
{
    double across[STATES], gain[STATES], *cov = n + O_COV;
    double spread = noise;
    for (int i = 0; i < STATES; i++) {
        across[i] = 0.0;
        for (int j = 0; j < STATES; j++)
            across[i] += cov[i * STATES + j] * h[j];
    }
    for (int i = 0; i < STATES; i++) spread += h[i] * across[i];
    for (int i = 0; i < STATES; i++) {
        gain[i] = i < first ? 0.0 : across[i] / spread;
        const double x = n[O_STATE + i] + gain[i] * apart;
        n[O_STATE + i] = bstm_clipped(x, LOW[i], HIGH[i]);
    }
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++)
            cov[i * STATES + j] -= gain[i] * across[j] + across[i] * gain[j]
                - gain[i] * spread * gain[j];
}

/* Let the variances of states grow, not beyond what they began with. */
void bstm_walk(double *n, int first, int last, double seconds)
{
    for (int i = first; i < last; i++) {
        double *own = n + O_COV + i * STATES + i;
        if (*own < BSTM_SD[i] * BSTM_SD[i]) *own += WALK[i] * WALK[i] * seconds;
    }
}

/* A filter's variance as the heat has it; *first* is that before learning. */
double bstm_published(double variance, double first)
{
    double unlearned = variance / first;
    if (unlearned > 1.0) unlearned = 1.0;
    return variance * (CAUTION + (1.0 - CAUTION) * unlearned);
}

void bstm_forms(double speed, double pressure_pa, double *h)
{
    const double v = speed > 1.0 ? speed : 1.0;
    const double p = pressure_pa > 5e4 ? pressure_pa : 5e4;
    for (int i = 0; i < MOTION; i++) h[i] = 0.0;
    h[X_LEVEL] = 1.0;
    h[X_SPEED] = bstm_clipped(log(v / REFERENCE_SPEED), -FORM_LIMIT, FORM_LIMIT);
    h[X_PRESSURE] = bstm_clipped(log(p / REFERENCE_PRESSURE), -FORM_LIMIT,
                            FORM_LIMIT);
    h[X_DRIFT] = 1.0;
}

double bstm_friction(const Observer *o, double speed, double pressure_pa,
                     double *variance)
{
    double h[STATES];
    bstm_forms(speed, pressure_pa, h);
    double first = 0.0;
    for (int i = MOTION; i < STATES; i++)
        first += h[i] * h[i] * (BSTM_SD[i] * BSTM_SD[i]);
    *variance = bstm_published(bstm_quadratic(o->n + O_COV, h), first);
    return bstm_product(o->n + O_STATE, h);
}

double bstm_braking(const Observer *o, double felt, double push, double drag,
                    double rate, double *spread)
{
    const double h[STATES] = {push - o->rotating * rate, 1.0, -drag, rate};
    *spread = sqrt(bstm_quadratic(o->n + O_COV, h));
    return bstm_product(o->n + O_STATE, h) - felt;
}

/* Whether everything learned is a number with a variance. */
int bstm_sound(const double *n)
{
    double total = 0.0;
    for (int i = 0; i < LEARNED; i++) total += n[i];
    if (!isfinite(total)) return 0;
    for (int i = 0; i < STATES; i++)
        if (!(n[O_COV + i * STATES + i] > 0.0)) return 0;
    return n[O_ROLLING_VAR] > 0.0;
}
