#include "observer_faults.h"

void observer_faults_compare_forces(ObserverMemory *m, double x, double y,
                                    double std)
{
    const double keep = 1.0 - 1.0 / BALANCE_WINDOWS;
    m->balance_count = keep * m->balance_count + 1.0;
    m->balance_x = keep * m->balance_x + x;
    m->balance_y = keep * m->balance_y + y;
    m->balance_xx = keep * m->balance_xx + x * x;
    m->balance_xy = keep * m->balance_xy + x * y;
    m->balance_yy = keep * m->balance_yy + y * y;
    m->balance_std = keep * m->balance_std + std;
}

int observer_faults_is_outlier(ObserverMemory *m, double innovation,
                               double std)
{
    if (fabs(innovation) <= OUTLIER * std) {
        m->outlier_s -= WINDOW_S;
        if (m->outlier_s < 0.0) m->outlier_s = 0.0;
        return 0;
    }
    if (innovation > OUTLIER_MORE || innovation < -OUTLIER_LESS) {
        m->outlier_s += WINDOW_S;
        if (m->outlier_s > OUTLIER_MOST_S) m->outlier_s = OUTLIER_MOST_S;
    }
    return 1;
}

void observer_faults_count_drive(ObserverMemory *m, double innovation,
                                 double std, double drive)
{
    if (drive < IDLE_DRIVE_MS2) return;
    if (fabs(innovation) <= OUTLIER * std) {
        m->held_back_s -= WINDOW_S;
        if (m->held_back_s < 0.0) m->held_back_s = 0.0;
    } else if (innovation < -HELD_BACK * drive) {
        m->held_back_s += WINDOW_S;
        if (m->held_back_s > OUTLIER_MOST_S) m->held_back_s = OUTLIER_MOST_S;
    }
}

/* Whether braking by motion and by pressure differ by a constant. */
static int unbalanced(const ObserverMemory *m)
{
    const double n = m->balance_count;
    if (n < BALANCE_LEAST) return 0;
    const double mean_x = m->balance_x / n, mean_y = m->balance_y / n;
    const double var_x = m->balance_xx / n - mean_x * mean_x;
    if (var_x < BALANCE_SPREAD_MS2 * BALANCE_SPREAD_MS2) return 0;
    const double cov = m->balance_xy / n - mean_x * mean_y;
    const double slope = cov / var_x;
    const double at_0 = mean_y - slope * mean_x;
    double rest = m->balance_yy / n - mean_y * mean_y - slope * cov;
    if (rest < 0.0) rest = 0.0;
    /* the windows scatter, and share the error of the learned states */
    const double std = m->balance_std / n;
    double var_0 = rest * (1.0 + mean_x * mean_x / var_x) / n;
    var_0 = CORRELATED_WINDOWS * var_0 + std * std;
    const double margin = BALANCE_STDS * sqrt(var_0);
    double less = BALANCE_SHARE * mean_x, more = BALANCE_MORE_SHARE * mean_x;
    if (less < BALANCE_MS2) less = BALANCE_MS2;
    if (more < BALANCE_MORE_MS2) more = BALANCE_MORE_MS2;
    if (slope < BALANCE_STEEP && at_0 + margin < -less) return 1;
    return slope > BALANCE_MORE_FLAT && at_0 - margin > more;
}

/* Whether less mass was learned than the car has. */
static int implausible_mass(const ObserverMemory *m)
{
    const double ratio = m->known.x[MASS];
    const double cov = m->known.cov[MASS * STATES + MASS];
    return m->started != 0.0
        && ratio - MASS_STDS * sqrt(cov) > 1.0 / LEAST_MASS;
}

int observer_faults_findings(const ObserverMemory *m, const Step *s)
{
    int found = 0;
    if (m->external_held_s > 0.0) found |= EXTERNAL_SUSPECTED;
    if (observer_faults_implausible_gain(m) || s->wrong_scale) found |= GAIN_SUSPECT;
    if (observer_faults_implausible_radius(m)) found |= RADIUS_SUSPECT;
    if (m->unpressed_s > DEAD_S) found |= PRESSURE_DEAD;
    if (unbalanced(m) || implausible_mass(m) || m->outlier_s > OUTLIER_S
        || m->held_back_s > OUTLIER_S)
        found |= FORCES_CONTRADICT;
    if (m->proof_s > 0.0) found |= FORCES_UNPROVEN;
    return found;
}

int observer_faults_implausible_gain(const ObserverMemory *m)
{
    const double square = m->gain_square, product = m->gain_product;
    return square > GAIN_SQUARE_LEAST
        && (product < GAIN_LOW * square || product > GAIN_HIGH * square);
}

int observer_faults_motion_unmeasured(const ObserverMemory *m)
{
    const double square = m->gain_square;
    return square > GAIN_SQUARE_LEAST && m->gain_product < UNMEASURED * square;
}

int observer_faults_implausible_radius(const ObserverMemory *m)
{
    for (int i = 0; i < GROUND_SPEEDS; i++)
        if (fabs(m->radius_ratio[i] - 1.0) > RADIUS_LIMIT) return 1;
    return 0;
}

void observer_faults_compare_radius(ObserverMemory *m, const Step *s)
{
    if (!s->steady || fabs(m->rate) > RADIUS_RATE_MS2) return;
    const double share = 1.0 - exp(-s->dt_s / RADIUS_S);
    for (int i = 0; i < GROUND_SPEEDS; i++) {
        const double ground_ms = s->ground_speeds[i];
        if (!isnan(ground_ms) && ground_ms >= REFERENCE_SPEED_MS)
            m->radius_ratio[i] +=
                share * (s->speed / ground_ms - m->radius_ratio[i]);
    }
}
