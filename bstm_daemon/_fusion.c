/* Brake power of each corner out of pressure and motion: heat/fusion.py says
 * what it does and does the same operations in the same order.
 */
#include "_samples.h"

#define BRAKING_S 0.3
#define SILENT_BEFORE_S 0.5
#define SILENT_SPEED 1.5
#define SILENT_SPREADS 3.0
#define ASSUMED_SPREADS 2.0
#define STEEPEST 2.0
#define SLIP_FORWARD 0.08
#define SLIPPING 0.06
#define MODEL_SHARE 0.015
#define ASSUMED_DOUBT 0.2
#define TORQUE_NOISE 0.03
#define DRAG_TORQUE_NOISE 0.15
#define ABS_SHARE 0.12
#define ASSIST_SHARE 0.15
#define SINGLE_SHARE 0.6
#define ABS_LOW 0.2
#define ABS_HIGH 1.5
#define STAND_TURNS 3.0
#define GRADE_NOISE 0.02
#define TARE_PA 3e4
#define TARE_S 5.0
#define TARE_PUSH 0.3

enum {
    FLAG_SUSPECTS = 1 << 11 | 1 << 13 | 1 << 14 | 1 << 16 | 1 << 19 | 1 << 20
};
/* the motion tells nothing of the brakes: a push, a scale, an input */
#define FLAG_BLIND (INT64_C(1) << 40 | INT64_C(1) << 42)
#define FLAG_UNSURE (INT64_C(1) << 11 | INT64_C(1) << 13 | INT64_C(1) << 14)
#define FLAG_UNPRESSED (INT64_C(1) << 45)

void bstm_fusion_feel(Pass *p, double h, double v)
{
    const double *f = p->f;
    double *n = p->observer.n;
    const int acceleration = p->role[R_ACCELERATION];
    const int motor = p->role[R_MOTOR];
    n[SUM_DRAG] += (f[F_QUADRATIC] * v + f[F_LINEAR]) * v / f[F_MASS] * h;
    if (!bstm_valid(p, acceleration) || (motor >= 0 && !bstm_valid(p, motor))
        || !(bstm_valid(p, p->role[R_TORQUE]) || p->ints[I_ASSUMED] != 0)
        || !p->speed_known || p->ints[I_SLOPE] != 0)
        return;
    const double torque = bstm_vehicle(p, R_TORQUE, f[F_TORQUE])
        + bstm_vehicle(p, R_MOTOR, 0.0);
    const double external = bstm_vehicle(p, R_EXTERNAL, 0.0);
    const double push = p->heading * (torque / f[F_RADIUS] + external);
    n[SUM_TIME] += h;
    n[SUM_FELT] += p->heading * p->value[acceleration] * h;
    n[SUM_PUSH] += push / f[F_MASS] * h;
}

/* Whether all wheels turn alike. */
static int rolls(const Pass *p)
{
    for (int c = 0; c < p->corners; c++) {
        const double apart = p->wheel[c] - p->speed;
        if (apart > SLIPPING * p->speed || apart < -SLIPPING * p->speed)
            return 0;
    }
    return 1;
}

/* Whether some wheels turn while others stand and nothing brakes them. */
static int on_stand(const Pass *p)
{
    double high = 0.0, low = STAND_TURNS;
    for (int c = 0; c < p->corners; c++) {
        const int role = p->corner[c * PER_CORNER_INTS + C_WHEEL];
        if (!bstm_valid(p, role)) continue;
        const double own = fabs(p->value[role]);
        if (own > high) high = own;
        if (own < low) low = own;
    }
    return high > STAND_TURNS && low < STANDING_MS;
}

/* A corner that no pressure of its own speaks for, though others have one. */
static int unheard(const Pass *p, int c, int pressed)
{
    if (!bstm_corner_known(p, c)) return 1;
    if (bstm_valid(p, p->corner[c * PER_CORNER_INTS + C_PRESSURE])) return 0;
    return !pressed || p->observer.brake_sum[c] <= 0.0;
}

/* What the pressures read while nobody brakes. */
static void tare_pressures(Pass *p, const Step *s)
{
    double *tare = p->observer.n + O_TARE_PRIMARY;
    const int role[2] = {p->role[R_PRIMARY], p->role[R_SECONDARY]};
    if (isnan(s->brake_switch) ? !(s->push > TARE_PUSH)
                               : s->brake_switch > 0.0)
        return;
    for (int i = 0; i < 2; i++) {
        if (!bstm_valid(p, role[i])) continue;
        const double read = p->value[role[i]];
        if (fabs(read) > TARE_PA) continue;
        tare[i] += (1.0 - exp(-s->dt_s / TARE_S)) * (read - tare[i]);
    }
}

static void describe(const Pass *p, const Readings *now, int64_t flags,
                     Step *s)
{
    const double *n = p->observer.n, dt_s = now->dt_s;
    const int whole = n[SUM_TIME] > dt_s - 1e-9;
    const double yaw = fabs(bstm_vehicle(p, R_YAW, 0.0)) * p->speed;
    const double side = fabs(bstm_vehicle(p, R_LATERAL, 0.0));
    s->dt_s = dt_s;
    s->speed = p->n[N_SPEED] / dt_s;
    s->end_speed = p->speed;
    s->felt = whole ? n[SUM_FELT] / dt_s : (double)NAN;
    s->push = whole ? n[SUM_PUSH] / dt_s : (double)NAN;
    s->drag = n[SUM_DRAG] / dt_s;
    s->lateral = yaw > side ? yaw : side;
    s->gear = bstm_vehicle(p, R_GEAR, 0.0);
    s->clutch = bstm_vehicle(p, R_CLUTCH, 0.0);
    s->height = bstm_vehicle(p, R_ALTITUDE, (double)NAN);
    s->gnss_speed = bstm_vehicle(p, R_GNSS_SPEED, (double)NAN);
    s->forward = p->heading > 0.0;
    s->brake_n = s->pressure_pa = 0.0;
    s->brake_switch = now->brake_switch;
    s->pressed = now->brake_switch > 0.0;
    s->pressure_known = s->wheel_pressures = 1;
    int some = 0, none = 0;
    for (int c = 0; c < p->corners; c++) {
        const double brake_n = p->observer.brake_sum[c] / dt_s;
        const double pressure = p->pressure_sum[c] / dt_s;
        s->brake_n += brake_n;
        if (pressure > s->pressure_pa) s->pressure_pa = pressure;
        if (p->on_time[c] > 0.0) some = 1;
        else none = 1;
        if (!bstm_corner_known(p, c)) s->pressure_known = 0;
        if (!bstm_valid(p, p->corner[c * PER_CORNER_INTS + C_PRESSURE]))
            s->wheel_pressures = 0;
    }
    if (some) s->pressed = 1;
    s->torque_known = bstm_valid(p, p->role[R_TORQUE]);
    s->on_stand = !s->pressed && on_stand(p);
    const int acts = bstm_vehicle(p, R_ABS, 0.0) > 0.0
        || now->esc_active > 0.0 || bstm_vehicle(p, R_TC, 0.0) > 0.0;
    s->steady = !acts && rolls(p) && (flags & FLAG_SUSPECTS) == 0
        && !(some && none && !s->wheel_pressures);
}

/* How a force that no pressure tells of falls on the corners [shares]. */
static void divide(const Pass *p, const Readings *now, int pressed,
                   double *part)
{
    const int tc = bstm_vehicle(p, R_TC, 0.0) > 0.0;
    const int single = tc || now->esc_active > 0.0;
    double total = 0.0, slipping = 0.0, slip[MAX_CORNERS];
    for (int c = 0; c < p->corners; c++) {
        const double apart = p->speed > 0.0
            ? (p->speed - p->wheel[c]) / p->speed : 0.0;
        double own = tc ? -apart - SLIP_FORWARD : apart;
        if (own < 0.0 || !single) own = 0.0;
        slip[c] = unheard(p, c, pressed) ? own : 0.0;
        slipping += slip[c];
    }
    for (int c = 0; c < p->corners; c++) {
        const double share = p->corner_f[c * PER_CORNER_FLOATS + T_SHARE];
        part[c] = unheard(p, c, pressed) ? share : 0.0;
        if (slipping > 0.01) part[c] = slip[c];
        total += part[c];
    }
    for (int c = 0; c < p->corners; c++)
        part[c] = total > 0.0 ? part[c] / total : 0.0;
}

/* Power [W] of the braking that no pressure tells of. */
static double unpressed(Pass *p, const Step *s, double excess, double slow,
                        double doubt)
{
    double *n = p->observer.n;
    const double mass_kg = p->f[F_MASS] / n[O_STATE + X_MASS];
    const double spreads = s->torque_known ? SILENT_SPREADS : ASSUMED_SPREADS;
    double least = p->f[F_ON_FORCE] / mass_kg;
    if (least < spreads * doubt) least = spreads * doubt;
    const double held = n[O_SILENT] >= SILENT_BEFORE_S ? 0.5 * least : least;
    if (s->speed < SILENT_SPEED || !(slow > held)
        || fabs(n[O_FELT] - n[O_RATE]) > STEEPEST) {
        n[O_SILENT] = n[O_SILENT_ENERGY] = 0.0;
        return 0.0;
    }
    n[O_SILENT] += s->dt_s;
    n[O_SILENT_ENERGY] += mass_kg * excess * s->speed * s->dt_s;
    if (n[O_SILENT] < SILENT_BEFORE_S) return 0.0;
    const double power = n[O_SILENT_ENERGY] / s->dt_s;
    n[O_SILENT_ENERGY] = 0.0;
    return power > 0.0 ? power : 0.0;
}

static void tell(const Observer *o, const Step *s, double *learned)
{
    const double *n = o->n, *cov = n + O_COV;
    const double ratio = n[O_STATE + X_MASS], sine = n[O_SINE];
    const double mass_kg = o->mass_kg / ratio;
    const double drag = n[O_STATE + X_DRAG] / ratio;
    double variance;
    const double level = bstm_friction(o, 10.0, 1e6, &variance);
    const double bias_var = cov[X_BIAS * STATES + X_BIAS] + n[O_ROLLING_VAR];
    const double known = isnan(s->felt) ? (double)NAN : 0.0;
    learned[0] = sine / sqrt(1.0 - sine * sine) + known;
    learned[1] = sqrt(bias_var + GRADE_NOISE * GRADE_NOISE) / GRAVITY + known;
    learned[2] = mass_kg;
    learned[3] = mass_kg * (sqrt(cov[0]) / ratio);
    learned[4] = n[O_STATE + X_BIAS] + o->rolling + n[O_ROLLING];
    learned[5] = sqrt(bias_var);
    learned[6] = exp(level);
    learned[7] = exp(level) * sqrt(variance + cov[0] / (ratio * ratio));
    learned[8] = drag;
    learned[9] = sqrt(cov[X_DRAG * STATES + X_DRAG]) / ratio;
}

int64_t bstm_fusion_close(Pass *p, const Readings *now, int64_t flags,
                          double *power, double *spread, double *learned)
{
    Observer *o = &p->observer;
    double *n = o->n;
    Step s;
    describe(p, now, flags, &s);
    tare_pressures(p, &s);
    int64_t found = (int64_t)bstm_observe(o, &s) << 40;
    tell(o, &s, learned);
    double variance, doubt = 0.0, extra = 0.0;
    const double ratio = n[O_STATE + X_MASS];
    double scale = exp(bstm_friction(o, s.speed, s.pressure_pa, &variance));
    variance += bstm_published(n[O_COV] / (ratio * ratio),
                               BSTM_SD[0] * BSTM_SD[0])
        + MODEL_SHARE * MODEL_SHARE;
    const int feels = !isnan(s.felt) && s.forward
        && (found & FLAG_BLIND) == 0 && (flags & FLAG_UNSURE) == 0;
    if (feels) {
        const double given = s.brake_n / o->mass_kg * ratio * scale;
        const double braking =
            bstm_braking(o, s.felt, s.push, s.drag, n[O_RATE], &doubt);
        /* of the driveline's torque the retarding one is known worst */
        const double torque = s.torque_known
            ? (s.push < 0.0 ? DRAG_TORQUE_NOISE : TORQUE_NOISE) * ratio * s.push
            : ASSUMED_DOUBT;
        doubt = sqrt(doubt * doubt + torque * torque);
        const double share = 1.0 - exp(-s.dt_s / BRAKING_S);
        n[O_SLOW_BRAKING] += share * (braking - n[O_SLOW_BRAKING]);
        n[O_SLOW_BRAKE] += share * (given - n[O_SLOW_BRAKE]);
        if (bstm_vehicle(p, R_ABS, 0.0) > 0.0 && !s.wheel_pressures
            && n[O_SLOW_BRAKE] > 0.0) {
            double real = n[O_SLOW_BRAKING] / n[O_SLOW_BRAKE];
            if (real < ABS_LOW) real = ABS_LOW;
            if (real > ABS_HIGH) real = ABS_HIGH;
            scale *= real;
            variance += ABS_SHARE * ABS_SHARE;
        }
        if (!s.wheel_pressures)
            extra = unpressed(p, &s, braking - given,
                              n[O_SLOW_BRAKING] - n[O_SLOW_BRAKE], doubt);
    } else {
        n[O_SLOW_BRAKING] = n[O_SLOW_BRAKE] = 0.0;
        n[O_SILENT] = n[O_SILENT_ENERGY] = 0.0;
    }
    const int single =
        bstm_vehicle(p, R_TC, 0.0) > 0.0 || now->esc_active > 0.0;
    const double mass_kg = o->mass_kg / ratio;
    const double vague =
        single || !s.torque_known ? SINGLE_SHARE : ASSIST_SHARE;
    double part[MAX_CORNERS];
    divide(p, now, s.brake_n > 0.0, part);
    for (int c = 0; c < p->corners; c++) {
        const double pressed = scale * (p->energy_ff[c] / s.dt_s);
        const double turning = p->speed > 0.0 ? p->wheel[c] / p->speed : 1.0;
        const double other = extra * part[c] * turning;
        double own = vague * other;
        if (other > 0.0) {
            const double unsure = mass_kg * doubt * s.speed * part[c];
            own = sqrt(own * own + unsure * unsure);
        }
        power[c] = pressed + other;
        spread[c] = sqrt(pressed * pressed * variance + own * own);
        if (other > 0.0) found |= FLAG_UNPRESSED;
    }
    return found;
}
