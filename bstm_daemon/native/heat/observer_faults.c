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
    for (int i = 0; i < GROUND_SPEEDS; i++)
        if (fabs(m->radius_ratio[i] - 1.0) > RADIUS_LIMIT) return 1;
    return 0;
}

void observer_faults_compare_radius(ObserverMemory *m, const Step *s)
{
    if (!s->steady) return;
    const double share = 1.0 - exp(-s->dt_s / RADIUS_S);
    for (int i = 0; i < GROUND_SPEEDS; i++) {
        const double ground_ms = s->ground_speeds[i];
        if (!isnan(ground_ms) && ground_ms >= REFERENCE_SPEED_MS)
            m->radius_ratio[i] +=
                share * (s->speed / ground_ms - m->radius_ratio[i]);
    }
}
