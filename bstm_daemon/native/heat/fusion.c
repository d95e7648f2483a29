#include "fusion.h"

#include "motion_checks.h"

void fusion_accumulate_motion(Inputs *p, double h)
{
    const double v = p->speed;
    const PlanNumbersFloats *f = p->plan;
    ObserverMemory *m = p->observer.m;
    const int acceleration = ROLE_ACCELERATION_LONGITUDINAL;
    m->sum_drag += (f->quadratic * v + f->linear) * v / f->mass_kg * h;
    if (!inputs_valid(p, acceleration)
        || (inputs_mapped(p, ROLE_MOTOR_TORQUE)
            && !inputs_valid(p, ROLE_MOTOR_TORQUE))
        || !(inputs_valid(p, ROLE_POWERTRAIN_TORQUE)
             || p->options->torque_assumed)
        || !p->speed_known || p->options->slope != SLOPE_ACCELEROMETER)
        return;
    const double torque =
        inputs_vehicle(p, ROLE_POWERTRAIN_TORQUE, f->assumed_torque_nm)
        + inputs_vehicle(p, ROLE_MOTOR_TORQUE, 0.0);
    const double external = inputs_vehicle(p, ROLE_EXTERNAL_FORCE, 0.0);
    const double drive = p->heading * (torque / f->radius_m + external);
    m->sum_time += h;
    m->sum_accel += p->heading * p->m->value[acceleration] * h;
    m->sum_drive += drive / f->mass_kg * h;
}

/* Whether all wheels turn alike. */
static int rolls(const Inputs *p)
{
    for (int c = 0; c < p->corners; c++) {
        const double slip_share = p->wheel[c] - p->speed;
        if (slip_share > SLIPPING * p->speed || slip_share < -SLIPPING * p->speed)
            return 0;
    }
    return 1;
}

/* Whether the corner has no pressure, though others may have. */
static int without_pressure(const Inputs *p, int c, int pressed)
{
    if (!inputs_corner_known(p, c)) return 1;
    if (inputs_valid(p, p->pressure_role[c])) return 0;
    return !pressed || p->observer.m->brake_sum[c] <= 0.0;
}

/* Offsets of the pressure sensors, read with the brake released. */
static void tare_pressures(Inputs *p, const Step *s)
{
    ObserverMemory *m = p->observer.m;
    double *const tare[] = {&m->tare_primary, &m->tare_secondary};
    static const int role[] = {ROLE_PRIMARY_PRESSURE, ROLE_SECONDARY_PRESSURE};
    if (isnan(s->brake_switch) ? !(s->drive > TARE_DRIVE_MS2)
                               : s->brake_switch > 0.0)
        return;
    const double share = 1.0 - exp(-s->dt_s / TARE_S);
    for (int i = 0; i < 2; i++) {
        const double measured_pa = p->m->value[role[i]];
        if (inputs_valid(p, role[i]) && fabs(measured_pa) <= TARE_PA)
            *tare[i] += share * (measured_pa - *tare[i]);
    }
}

static void describe(const Inputs *p, const Readings *now, int64_t flags,
                     Step *s)
{
    const ObserverMemory *m = p->observer.m;
    const double dt_s = now->dt_s;
    const int whole = m->sum_time > dt_s - 1e-9;
    const double yaw = fabs(inputs_vehicle(p, ROLE_YAW_RATE, 0.0)) * p->speed;
    const double side =
        fabs(inputs_vehicle(p, ROLE_ACCELERATION_LATERAL, 0.0));
    s->dt_s = dt_s;
    s->speed = p->m->speed_sum / dt_s;
    s->end_speed = p->speed;
    s->accel = whole ? m->sum_accel / dt_s : (double)NAN;
    s->drive = whole ? m->sum_drive / dt_s : (double)NAN;
    s->drag = m->sum_drag / dt_s;
    s->lateral = yaw > side ? yaw : side;
    s->gear = inputs_vehicle(p, ROLE_GEAR, 0.0);
    s->clutch = inputs_vehicle(p, ROLE_CLUTCH_OPEN, 0.0);
    s->height = inputs_vehicle(p, ROLE_ALTITUDE, (double)NAN);
    for (int i = 0; i < GROUND_SPEEDS; i++)
        s->ground_speeds[i] = inputs_reading(p, GROUND_SPEED_ROLES[i]);
    s->forward = p->heading > 0.0;
    s->brake_n = s->pressure_pa = 0.0;
    s->brake_switch = now->brake_switch;
    s->pressure_known = s->wheel_pressures = 1;
    int some = 0, none = 0;
    double light_n = 0.0;
    for (int c = 0; c < p->corners; c++) {
        const double pressure = p->m->pressure_sum[c] / dt_s;
        const double pushing = pressure - p->plan->pushout_pa[c];
        if (pushing > 0.0)
            light_n += p->plan->torque_per_pa[c] * pushing
                / p->plan->radius_m;
        s->brake_n += m->brake_sum[c] / dt_s;
        if (pressure > s->pressure_pa) s->pressure_pa = pressure;
        if (p->m->on_time[c] > 0.0) some = 1;
        else none = 1;
        if (!inputs_corner_known(p, c)) s->pressure_known = 0;
        if (!inputs_valid(p, p->pressure_role[c])) s->wheel_pressures = 0;
    }
    /* a foot that only rests on the pedal brakes by a pressure that is too
       low to count as heat; without a switch it may do so whenever the
       pressure is not up */
    const double travel_m = inputs_reading(p, ROLE_BRAKE_PEDAL_TRAVEL);
    const int brakes = now->brake_switch > 0.0 || some;
    const int rests = travel_m <= PEDAL_REST && s->brake_n < LEAST_BRAKE_N;
    s->pressed = brakes && !rests;
    const int light = brakes ? rests : isnan(now->brake_switch);
    s->light_n = light ? light_n : 0.0;
    s->torque_known = inputs_valid(p, ROLE_POWERTRAIN_TORQUE);
    s->on_stand = !s->pressed && p->apart;
    s->wrong_scale = motion_checks_wrong_scale(p->checks.m);
    s->steady = !now->intervenes && rolls(p) && (flags & SUSPECTS) == 0
        && (s->wheel_pressures || !(s->pressed && some && none));
}

/* Whether no corner lacks pressure, but all of them have too little. */
static int too_little(const Inputs *p)
{
    const ObserverMemory *m = p->observer.m;
    if (!(m->slow_braking > MOST_FRICTION * m->slow_brake)) return 0;
    for (int c = 0; c < p->corners; c++)
        if (!(m->brake_sum[c] > 0.0)) return 0;
    return 1;
}

/* Shares of the corners in a brake force without pressure. */
static void divide(const Inputs *p, const Readings *now, int pressed,
                   double *part)
{
    const int tc = inputs_vehicle(p, ROLE_TC_ACTIVE, 0.0) > 0.0;
    const int single = tc || now->esc_active > 0.0;
    double total = 0.0, slipping = 0.0, slip[MAX_CORNERS];
    for (int c = 0; c < p->corners; c++) {
        const double slip_share = p->speed > 0.0
            ? (p->speed - p->wheel[c]) / p->speed : 0.0;
        double own = tc ? -slip_share - SLIP_FORWARD : slip_share;
        if (own < 0.0 || !single) own = 0.0;
        slip[c] = without_pressure(p, c, pressed) ? own : 0.0;
        slipping += slip[c];
    }
    for (int c = 0; c < p->corners; c++) {
        const double share = p->plan->force_share[c];
        part[c] = without_pressure(p, c, pressed) ? share : 0.0;
        if (slipping > 0.01) part[c] = slip[c];
        total += part[c];
    }
    for (int c = 0; c < p->corners; c++)
        part[c] = total > 0.0 ? part[c] / total : 0.0;
}

/* Power [W] of the braking without pressure. */
static double unpressed(Inputs *p, const Step *s, double excess, double slow,
                        double std)
{
    ObserverMemory *m = p->observer.m;
    const double mass_kg = p->plan->mass_kg / m->known.x[MASS];
    const double stds = s->torque_known ? SILENT_STDS : ASSUMED_STDS;
    double least = p->plan->on_force_n / mass_kg;
    if (least < stds * std) least = stds * std;
    const double held = m->silent_s >= SILENT_BEFORE_S ? 0.5 * least : least;
    if (s->speed < SILENT_SPEED_MS || !(slow > held)
        || fabs(m->accel_measured - m->rate) > STEEPEST_MS2) {
        m->silent_s = m->silent_energy = 0.0;
        return 0.0;
    }
    m->silent_s += s->dt_s;
    m->silent_energy += mass_kg * excess * s->speed * s->dt_s;
    if (m->silent_s < SILENT_BEFORE_S) return 0.0;
    const double power = m->silent_energy / s->dt_s;
    m->silent_energy = 0.0;
    return power > 0.0 ? power : 0.0;
}

/* The learned values as the vehicle's channels from the grade on. */
static void learned_channels(const Observer *o, const Step *s, double *channel)
{
    const Learned *k = &o->m->known;
    const double ratio = k->x[MASS], sine = o->m->sine;
    const double mass_kg = o->mass_kg / ratio;
    double variance;
    const double level = learned_friction(k, REFERENCE_SPEED_MS,
                                          REFERENCE_PRESSURE_PA, &variance);
    const double bias_var = k->cov[BIAS * STATES + BIAS] + k->rolling_var;
    const double known = isnan(s->accel) ? (double)NAN : 0.0;
    *channel++ = sine / sqrt(1.0 - sine * sine) + known;
    *channel++ =
        sqrt(bias_var + GRADE_NOISE * GRADE_NOISE) / GRAVITY_MS2 + known;
    *channel++ = mass_kg;
    *channel++ = mass_kg * (sqrt(k->cov[0]) / ratio);
    *channel++ = k->x[BIAS] + o->rolling + k->rolling_error;
    *channel++ = sqrt(bias_var);
    *channel++ = exp(level);
    *channel++ = exp(level) * sqrt(variance + k->cov[0] / (ratio * ratio));
    *channel++ = k->x[DRAG] / ratio;
    *channel = sqrt(k->cov[DRAG * STATES + DRAG]) / ratio;
}

/* Standard deviation of the driving acceleration [m/s2]. */
static double torque_std(const Step *s, double ratio)
{
    if (!s->torque_known) return ASSUMED_TORQUE_STD;
    const double share = s->drive < 0.0 ? DRAG_TORQUE_NOISE : TORQUE_NOISE;
    return share * ratio * s->drive;
}

Fused fusion_fuse(Inputs *p, const Readings *now, int64_t flags,
                  double *learned)
{
    Observer *o = &p->observer;
    ObserverMemory *m = o->m;
    Step s;
    describe(p, now, flags, &s);
    tare_pressures(p, &s);
    Fused fused;
    int64_t found = (int64_t)observer_observe(o, &s) << FLAG_SHIFT;
    learned_channels(o, &s, learned);
    const Learned *k = &m->known;
    double variance, std = 0.0, extra = 0.0;
    const double ratio = k->x[MASS];
    double scale = exp(learned_friction(k, s.speed, s.pressure_pa, &variance));
    variance += learned_published_variance(k->cov[0] / (ratio * ratio),
                                           P0_STD[0] * P0_STD[0])
        + MODEL_SHARE * MODEL_SHARE;
    if (found & FLAG_FORCES_CONTRADICT) {
        /* what was learned may hide heat */
        if (scale < 1.0) scale = 1.0;
        found |= FLAG_ACCELERATION_SUSPECT | FLAG_TORQUE_SUSPECT;
    }
    const int blind = (found & BLIND) || (flags & UNSURE);
    if (!isnan(s.accel) && s.forward && !blind) {
        const double ff_decel = s.brake_n / o->mass_kg * ratio * scale;
        const double braking =
            observer_braking(o, s.accel, s.drive, s.drag, m->rate, &std);
        const double torque = torque_std(&s, ratio);
        std = sqrt(std * std + torque * torque);
        const double share = 1.0 - exp(-s.dt_s / BRAKING_S);
        m->slow_braking += share * (braking - m->slow_braking);
        m->slow_brake += share * (ff_decel - m->slow_brake);
        if (inputs_vehicle(p, ROLE_ABS_ACTIVE, 0.0) > 0.0 && !s.wheel_pressures
            && m->slow_brake > 0.0) {
            double real = m->slow_braking / m->slow_brake;
            if (real < ABS_LOW) real = ABS_LOW;
            if (real > ABS_HIGH) real = ABS_HIGH;
            scale *= real;
            variance += ABS_SHARE * ABS_SHARE;
        }
        if (!s.wheel_pressures)
            extra = unpressed(p, &s, braking - ff_decel,
                              m->slow_braking - m->slow_brake, std);
    } else {
        m->slow_braking = m->slow_brake = 0.0;
        m->silent_s = m->silent_energy = 0.0;
    }
    const int single =
        inputs_vehicle(p, ROLE_TC_ACTIVE, 0.0) > 0.0 || now->esc_active > 0.0;
    const double mass_kg = o->mass_kg / ratio;
    const double vague =
        single || !s.torque_known ? SINGLE_SHARE : ASSIST_SHARE;
    double part[MAX_CORNERS];
    divide(p, now, s.brake_n > 0.0 && !too_little(p), part);
    for (int c = 0; c < p->corners; c++) {
        const double pressed = scale * (p->m->energy_ff[c] / s.dt_s);
        const double turning = p->speed > 0.0 ? p->wheel[c] / p->speed : 1.0;
        const double other = extra * part[c] * turning;
        double own = vague * other;
        if (other > 0.0) {
            const double unsure = mass_kg * std * s.speed * part[c];
            own = sqrt(own * own + unsure * unsure);
        }
        fused.power[c] = pressed + other;
        fused.power_std[c] = sqrt(pressed * pressed * variance + own * own);
        if (other > 0.0) found |= FLAG_BRAKING_UNPRESSED;
    }
    fused.flags = found;
    return fused;
}
