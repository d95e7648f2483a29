/* A pass over samples, as its two sources share it: _samples_bind.c points it
 * into what comes from Python and checks that, _samples.c runs it.
 * heat/sample_plan.py lays out `ints` and `floats`, heat/sample_state.py the
 * memory.
 */
#ifndef BSTM_SAMPLES_H
#define BSTM_SAMPLES_H

#include "_observer.h"

#define PLAN_LAYOUT 5

enum { DONE, FULL, SETTLE, JUMP, DROP };
enum {
    I_LAYOUT, I_ROLES, I_CORNERS, I_MODE, I_SLOPE, I_POINTS, I_PRESSURE,
    I_ASSUMED, I_LAW, HEADER
};
enum {
    R_SPEED, R_PRIMARY, R_SECONDARY, R_ACCELERATION, R_TORQUE, R_EXTERNAL,
    R_AMBIENT, R_RAIN, R_SWITCH, R_ESC, R_MOTOR, R_LATERAL, R_YAW, R_GEAR,
    R_CLUTCH, R_ABS, R_TC, R_ALTITUDE, R_GNSS_SPEED, VEHICLE_ROLES
};
enum { C_WHEEL, C_PRESSURE, C_SECONDARY, C_REAR, C_MEASURED };
enum { MEASURED = 6, PER_CORNER_INTS = C_MEASURED + MEASURED };
enum {
    F_STEP, F_MASS, F_ROTATING, F_RADIUS, F_QUADRATIC, F_LINEAR, F_CONSTANT,
    F_AMBIENT, F_TORQUE, F_ON_PRESSURE, F_ON_FORCE, F_FILTER, F_SETTLING,
    F_UNPRESSED, VEHICLE_FLOATS
};
enum { T_PER_PA, T_PUSHOUT, T_LAG, T_SHARE, PER_CORNER_FLOATS };
enum { S_NOW, S_GRID, S_PENDING, S_LATE, S_DROPPED, S_JUMPS, TIMES };
enum {
    N_FILTERED, N_SPEED, N_DISTANCE, N_FORCE, N_ENERGY_FB, N_TOTAL_FB, N_TAIL,
    N_UNPRESSED, NUMBERS
};
enum { PER_CORNER_SUMS = 7, FIRST_MEASURED = 9 };
enum { CHANNELS = FIRST_MEASURED + MEASURED, VEHICLE_CHANNELS = 15 };
enum { MODE_FF, MODE_FB, MODE_MEASURED, MODE_FUSED };
enum { OWN, OTHER, NONE }; /* source of a corner's power */
enum { LIMITS = 4 }; /* low, high, step, rate */
enum { LAW_POINTS = 81, LAW = 3 * LAW_POINTS }; /* T, p, v */

typedef struct {
    const int32_t *ints, *role, *corner;  /* role: the vehicle's roles */
    const double *f, *corner_f, *table_front, *table_rear, *timeout;
    const double *law; /* friction, per corner; NULL: nominal everywhere */
    int roles, corners, points;
    int64_t *t, *stamp;
    double *n, *lagged, *energy_ff, *pressure_sum, *on_time, *total_ff, *value;
    double *interface_k, *told_k; /* as the step began; told last */
    int32_t *flags;
    double *rows, *vehicle_rows;
    int64_t *row_times;
    ptrdiff_t room, steps;
    int stale, speed_known;
    double on_pressure, speed, heading, wheel[MAX_CORNERS], target[MAX_CORNERS];
    Checks checks;
    Observer observer;
} Pass;

static inline int bstm_valid(const Pass *p, int role)
{
    return role >= 0 && p->stamp[role] != NEVER
        && (double)(p->t[S_NOW] - p->stamp[role]) <= p->timeout[role];
}

static inline double bstm_vehicle(const Pass *p, int which, double otherwise)
{
    const int role = p->role[which];
    return bstm_valid(p, role) ? p->value[role] : otherwise;
}

/* Whether the pressure of a corner is present. */
static inline int bstm_corner_known(const Pass *p, int c)
{
    const int32_t *corner = p->corner + c * PER_CORNER_INTS;
    return bstm_valid(p, corner[C_PRESSURE])
        || bstm_valid(p, p->role[R_PRIMARY])
        || (corner[C_SECONDARY] && bstm_valid(p, p->role[R_SECONDARY]));
}

/* What the values that are held for h seconds say of the car's motion. */
void bstm_fusion_feel(Pass *p, double h, double v);

/* Learn from the step that ends and give each corner's power [W], its
 * standard deviation, and what is learned as channels of the vehicle's row
 * from the grade on; returns bits of the flags. */
int64_t bstm_fusion_close(Pass *p, const Readings *now, int64_t flags,
                          double *power, double *spread, double *learned);

/* Take samples until they or the rows end; returns the next one's index. */
ptrdiff_t bstm_consume(Pass *p, const int64_t *times, const int32_t *roles,
                       const double *values, ptrdiff_t index, ptrdiff_t count,
                       int *code);

#endif
