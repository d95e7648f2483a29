/* Current inputs of the pass, described in model/heat/inputs.py; both forms do
 * the same operations in the same order.
 */
#ifndef BSTM_INPUTS_H
#define BSTM_INPUTS_H

#include "checks.h"
#include "observer.h"

typedef struct {
    const PlanNumbersInts *options;
    const PlanNumbersFloats *plan;
    const double *table_front, *table_rear, *laws;
    PassMemoryInts *t;
    PassMemoryFloats *m;
    int corners, wheel_role[MAX_CORNERS], pressure_role[MAX_CORNERS];
    int measured_role[MAX_CORNERS]; /* the first */
    Checks checks;
    Observer observer;
    int stale, speed_known, pressure_present;
    int spinning, apart, on_stand, pedal;
    double pressing_pa, speed, ground_speed, heading;
    double wheel[MAX_CORNERS], target[MAX_CORNERS];
    double twin_low[TWINS], twin_high[TWINS];
} Inputs;

static inline int inputs_mapped(const Inputs *p, int role)
{
    return p->plan->timeout[role] >= 0.0;
}

static inline int inputs_valid(const Inputs *p, int role)
{
    return p->t->stamp[role] != NEVER
        && (double)(p->t->now - p->t->stamp[role]) <= p->plan->timeout[role];
}

static inline double inputs_vehicle(const Inputs *p, int role,
                                    double otherwise)
{
    return inputs_valid(p, role) ? p->m->value[role] : otherwise;
}

static inline double inputs_reading(const Inputs *p, int role)
{
    return inputs_vehicle(p, role, (double)NAN);
}

static inline int inputs_corner_known(const Inputs *p, int c)
{
    return inputs_valid(p, p->pressure_role[c])
        || inputs_valid(p, ROLE_PRIMARY_PRESSURE)
        || (p->options->secondary[c]
            && inputs_valid(p, ROLE_SECONDARY_PRESSURE));
}

/* The rest is 0 or set by the caller, which checks the values from Python. */
void inputs_init(Inputs *p, SampleMemoryInts *times,
                 SampleMemoryFloats *numbers);
void inputs_refresh(Inputs *p);
double inputs_input_age_s(const Inputs *p);
int inputs_feed_back_known(const Inputs *p);
void inputs_heat_sources(const Inputs *p, int *source, int *at_risk);
int64_t inputs_input_flags(const Inputs *p);

/* All that the checks need except at_risk. */
void inputs_readings(const Inputs *p, double dt_s, const int *source,
                     Readings *now);

#endif
