/* What the car's motion tells of the car itself: heat/observer.py says what
 * it does, heat/observer_layout.py how the memory is laid out and why the
 * numbers below are what they are.
 */
#ifndef BSTM_OBSERVER_H
#define BSTM_OBSERVER_H

#include "_plausibility.h"

#define GRAVITY 9.80665

/* States of the motion, then those of the friction. */
enum {
    X_MASS, X_BIAS, X_DRAG, X_GAIN, X_LEVEL, X_SPEED, X_PRESSURE, X_DRIFT,
    STATES, MOTION = X_LEVEL
};

/* The memory, in the order of heat/observer_layout.py. */
enum {
    O_STATE,
    O_COV = O_STATE + STATES,
    O_ROLLING = O_COV + STATES * STATES,
    O_ROLLING_VAR,
    LEARNED,
    O_RECENT = LEARNED,            /* copies of what is learned */
    O_EARLIER = O_RECENT + LEARNED,
    O_FIRST = O_EARLIER + LEARNED, /* as this drive began */
    O_COPY_AGE = O_FIRST + LEARNED,
    O_STARTED, O_RESETS,
    O_LAST_SPEED, O_RATE, O_FELT, O_SLOW_RATE, O_SLOW_FELT, O_GAIN_TIME,
    O_ROUGH,
    O_CALM, O_RELEASED, O_PRESSED, O_LAST_GEAR, O_LAST_CLUTCH,
    O_EXTERNAL, O_EXTERNAL_HELD, O_ALIKE, O_CHANGED, O_RADIUS_RATIO,
    O_UNPRESSED,
    O_STOOD,
    W_KIND, W_TIME, W_FELT, W_PUSH, W_DRAG, W_BRAKE, W_PRESSURE, W_SPEED,
    W_FIRST_SPEED,
    O_SINE, O_HEIGHT_LAST, O_HEIGHT_WORK, O_HEIGHT_PATH,
    O_TARE_PRIMARY, O_TARE_SECONDARY,
    O_SLOW_BRAKING, O_SLOW_BRAKE, O_SILENT, O_SILENT_ENERGY,
    SUM_TIME, SUM_FELT, SUM_PUSH, SUM_DRAG,
    OBSERVER_NUMBERS
};

/* What a step was: means over it, nan where not known. Forces over the
 * configured mass [m/s2]. */
typedef struct {
    double dt_s, speed, end_speed, felt, push, drag;
    double brake_n, pressure_pa, brake_switch, lateral, gear, clutch, height, gnss_speed;
    int steady;         /* no intervention, no slip, nothing suspect */
    int forward, pressed, pressure_known, wheel_pressures;
    int torque_known;   /* measured, not assumed */
    int on_stand;       /* some wheels turn, others stand */
} Step;

typedef struct {
    double mass_kg, rotating, rolling; /* J / R^2 / m; g f_r [m/s2] */
    double *n;
    double *brake_sum;  /* per corner, of the open step [N s] */
} Observer;

enum {
    EXTERNAL_SUSPECTED = 1, OBSERVER_RESET = 2, GAIN_SUSPECT = 4,
    RADIUS_SUSPECT = 8, PRESSURE_DEAD = 16
};

/* Learn from a step that ends; returns bits of the above. */
int bstm_observe(Observer *o, const Step *s);

/* Deceleration by the brakes [m/s2 of the learned mass], as felt in a step;
 * *spread is its standard deviation without that of the mass. */
double bstm_braking(const Observer *o, double felt, double push, double drag,
                    double rate, double *spread);

/* ln of the friction scale and, in *variance, that of it over the mass. */
double bstm_friction(const Observer *o, double speed, double pressure_pa,
                     double *variance);

/* What is learned and how it changes (_learned.c). */
#define REFERENCE_SPEED 10.0
#define CAUTION 0.2

extern const double BSTM_SD[STATES];
double bstm_published(double variance, double first);
double bstm_clipped(double value, double low, double high);
double bstm_quadratic(const double *cov, const double *h);
double bstm_product(const double *x, const double *h);
void bstm_update(double *n, int first, const double *h, double apart,
                 double noise);
void bstm_walk(double *n, int first, int last, double seconds);
void bstm_forms(double speed, double pressure_pa, double *h);
int bstm_sound(const double *n);

/* Begin anew, from what the configuration says. */
void bstm_observer_new(Observer *o);

#endif
