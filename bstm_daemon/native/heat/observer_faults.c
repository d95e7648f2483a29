#include "observer_faults.h"

int observer_faults_findings(const ObserverMemory *m)
{
    int found = 0;
    if (m->external_held_s > 0.0) found |= EXTERNAL_SUSPECTED;
    if (observer_faults_implausible_gain(m)) found |= GAIN_SUSPECT;
    if (observer_faults_implausible_radius(m)) found |= RADIUS_SUSPECT;
    if (m->unpressed_s > DEAD_S) found |= PRESSURE_DEAD;
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
    return fabs(m->radius_ratio - 1.0) > RADIUS_LIMIT;
}

void observer_faults_compare_radius(ObserverMemory *m, const Step *s)
{
    if (isnan(s->gnss_speed) || s->gnss_speed < REFERENCE_SPEED_MS
        || !s->steady)
        return;
    const double share = 1.0 - exp(-s->dt_s / RADIUS_S);
    m->radius_ratio += share * (s->speed / s->gnss_speed - m->radius_ratio);
}
