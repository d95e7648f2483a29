#include "sample_pass.h"

#include <string.h>

#include "friction_law.h"
#include "fusion.h"

/* Change of the filtered speed over h; its mean is left in *middle. */
static double filter_speed(Inputs *p, double h, double v, double *middle)
{
    PassMemoryFloats *m = p->m;
    *middle = v;
    if (!p->speed_known) {
        m->filtered_speed = UNKNOWN;
        return 0.0;
    }
    if (m->filtered_speed < 0.0 || p->spinning) {
        m->filtered_speed = v;
        m->tail_s = 0.0;
        return 0.0;
    }
    const double before = m->filtered_speed;
    m->filtered_speed = v + (before - v) * exp(-h / p->plan->filter_s);
    *middle = 0.5 * (before + m->filtered_speed);
    return m->filtered_speed - before;
}

/* Whether the motion brakes by force_s [N s], without a pressure. */
static int brakes(const Inputs *p, double h, double force_s)
{
    const PlanNumbersFloats *f = p->plan;
    PassMemoryFloats *m = p->m;
    const double torque =
        inputs_vehicle(p, ROLE_POWERTRAIN_TORQUE, f->assumed_torque_nm);
    const double motor =
        p->heading * inputs_vehicle(p, ROLE_MOTOR_TORQUE, 0.0);
    /* Eq 4.11 takes what the motor recovers for braking */
    double drive = p->heading * torque > 0.0 ? p->heading * torque : 0.0;
    drive = (drive - (motor < 0.0 ? motor : 0.0)) / f->radius_m;
    const double shown = (force_s / h - drive) / f->mass_kg;
    m->decel_shown += (1.0 - exp(-h / PEDAL_S)) * (shown - m->decel_shown);
    if (p->pedal == PEDAL_BRAKES) {
        m->pedal_seen = 1.0;
        m->pedal_lost = 0.0;
        return force_s > f->on_force_n * h;
    }
    const double error = p->spinning ? 1.0 : DRIVE_ERROR;
    const int enough = force_s > (f->on_force_n + error * drive) * h;
    if (p->pedal != PEDAL_AT_REST) return enough;
    const int felt = p->options->slope == SLOPE_ACCELEROMETER
        && inputs_valid(p, ROLE_ACCELERATION_LONGITUDINAL);
    const double low = PEDAL_LOW_MS2 + (felt ? 0.0 : SLOPE_MS2);
    const double engine =
        inputs_valid(p, ROLE_POWERTRAIN_TORQUE) ? 0.0 : ENGINE_MS2;
    const double high = low + PEDAL_MORE_MS2 + engine;
    double least = m->pedal_seen != 0.0 ? low + engine : high;
    if (m->decel_shown > least && p->speed > SWITCH_MS)
        m->pedal_lost += m->decel_shown * h;
    if (m->pedal_lost > PEDAL_LOST_MS) m->pedal_seen = 0.0;
    if (m->pedal_seen == 0.0) return force_s > (f->on_force_n + drive) * h;
    /* assistants brake without the pedal; the torque shows them */
    least = inputs_valid(p, ROLE_BRAKE_TORQUE) ? high : low;
    return enough && m->decel_shown > least;
}

/* Eq 4.11 without the change of speed, times h; that change acts on
 * *inertia_kg. */
static double outer_impulse(const Inputs *p, double h, double v,
                            double *inertia_kg)
{
    const PlanNumbersFloats *f = p->plan;
    const int acceleration = ROLE_ACCELERATION_LONGITUDINAL;
    const double drag =
        v > 0.0 ? (f->quadratic * v + f->linear) * v + f->constant : 0.0;
    const double torque =
        inputs_vehicle(p, ROLE_POWERTRAIN_TORQUE, f->assumed_torque_nm);
    const double external = inputs_vehicle(p, ROLE_EXTERNAL_FORCE, 0.0);
    const double driving = p->heading * (torque / f->radius_m + external);
    const double impulse = (driving - drag) * h;
    if (p->options->slope == SLOPE_ACCELEROMETER
        && inputs_valid(p, acceleration)) {
        const double accel = p->heading * p->m->value[acceleration];
        *inertia_kg = f->rotating_kg;
        return impulse - f->mass_kg * accel * h;
    }
    *inertia_kg = f->mass_kg + f->rotating_kg;
    return impulse;
}

/* Integrate Feed-Forward; returns the highest mean pressure. */
static double integrate_corners(Inputs *p, double h)
{
    const PlanNumbersFloats *f = p->plan;
    PassMemoryFloats *m = p->m;
    double highest = 0.0;
    for (int c = 0; c < p->corners; c++) {
        const double target = p->target[c], lag_s = f->lag_s[c];
        double pressure;
        /* a pressure measured at the wheel includes the lag */
        if (lag_s > 0.0 && !inputs_valid(p, p->pressure_role[c])) {
            const double decay = exp(-h / lag_s);
            const double behind = m->lagged_pa[c] - target;
            pressure = target + behind * (lag_s * (1.0 - decay) / h);
            m->lagged_pa[c] = target + behind * decay;
        } else {
            pressure = target;
            m->lagged_pa[c] = target;
        }
        const double pushing = pressure - f->pushout_pa[c];
        const int pressed = pressure > p->pressing_pa;
        if (pressed && pushing > 0.0) {
            double grip = f->torque_per_pa[c];
            if (p->laws != NULL)
                grip *= friction_factor(p->laws + c * 3 * LAW_POINTS,
                                        m->interface_k[c], pressure,
                                        p->wheel[c]);
            const double power =
                grip * pushing * (p->wheel[c] / f->radius_m);
            m->energy_ff[c] += power * h;
            p->observer.m->brake_sum[c] += grip * pushing / f->radius_m * h;
        }
        m->pressure_sum[c] += pressure * h;
        if (pressed) m->on_time[c] += h;
        if (pressure > highest) highest = pressure;
    }
    return highest;
}

/* Integrate the held values from now to time_us. */
static void integrate(Inputs *p, int64_t time_us)
{
    const PlanNumbersFloats *f = p->plan;
    PassMemoryFloats *m = p->m;
    if (time_us <= p->t->now) return;
    if (p->stale) inputs_refresh(p);
    const double h = (double)(time_us - p->t->now) * 1e-6;
    const double v = p->ground_speed;
    double middle, inertia_kg;
    const double highest = integrate_corners(p, h);
    const double gained = filter_speed(p, h, v, &middle);
    const double impulse = outer_impulse(p, h, v, &inertia_kg);
    const double force_s = impulse - inertia_kg * gained;
    const int pressed = p->pressure_present ? highest > p->pressing_pa
                                            : brakes(p, h, force_s);
    if (pressed)
        m->tail_s = inertia_kg > f->rotating_kg ? TAIL * f->filter_s : 0.0;
    const double braked = impulse * v - inertia_kg * (gained * middle);
    if (pressed || m->tail_s > 0.0) {
        m->force_sum += force_s;
        m->energy_fb += braked;
    } else if (f->unpressed_share > 0.0 && inputs_feed_back_known(p)
               && force_s > f->on_force_n * h) {
        m->force_sum += f->unpressed_share * force_s;
        m->unpressed_j += f->unpressed_share * braked;
        for (int c = 0; c < p->corners; c++) m->on_time[c] += h;
    }
    if (!pressed) {
        const double left = m->tail_s - h;
        m->tail_s = left > 0.0 ? left : 0.0;
    }
    if (p->options->mode == MODE_FUSED) fusion_accumulate_motion(p, h);
    m->speed_sum += p->speed * h;
    m->distance += p->speed * h;
    p->t->now = time_us;
}

/* Reset the sums of a step. */
static void clear(Inputs *p)
{
    PassMemoryFloats *m = p->m;
    ObserverMemory *o = p->observer.m;
    m->unpressed_j = m->speed_sum = m->force_sum = m->energy_fb = 0.0;
    for (int c = 0; c < p->corners; c++)
        m->energy_ff[c] = m->pressure_sum[c] = m->on_time[c] =
            o->brake_sum[c] = 0.0;
    o->sum_time = o->sum_accel = o->sum_drive = o->sum_drag = 0.0;
}

/* Write the row of the step that ends now and start the next; whether the bus
 * fell silent in it. */
static int close_step(Pass *pass)
{
    Inputs *p = &pass->in;
    PassMemoryFloats *m = p->m;
    const double dt_s = (double)p->options->step_us * 1e-6;
    const int air = ROLE_AMBIENT_TEMPERATURE;
    int source[MAX_CORNERS];
    Readings now;
    inputs_heat_sources(p, source, now.at_risk);
    inputs_readings(p, dt_s, source, &now);
    int64_t flags = *pass->flags | inputs_input_flags(p);
    flags |= checks_close(&p->checks, &now);
    /* on a silent bus the last air temperature is better than the default */
    double ambient_k = inputs_mapped(p, air) && p->t->stamp[air] != NEVER
        ? m->value[air] : p->plan->ambient_k;
    if (flags & FLAG_AMBIENT_SUSPECT) {
        const double history_k = p->checks.m->air_k;
        if (ambient_k < p->plan->ambient_k) ambient_k = p->plan->ambient_k;
        if (ambient_k < history_k) ambient_k = history_k;
    }
    double wetness = inputs_vehicle(p, ROLE_RAIN, 0.0);
    if (wetness < 0.0) wetness = 0.0;
    if (wetness > 1.0) wetness = 1.0;
    const double unpressed = m->unpressed_j > 0.0 ? m->unpressed_j : 0.0;
    const double energy =
        (m->energy_fb > 0.0 ? m->energy_fb : 0.0) + unpressed;
    const double power_fb = energy / dt_s, speed = m->speed_sum / dt_s;
    m->total_fb += energy;
    double *whole = pass->vehicle_rows + pass->steps * VEHICLE_CHANNELS;
    const int fuses = p->options->mode == MODE_FUSED;
    Fused fused;
    if (fuses) {
        fused = fusion_fuse(p, &now, flags, whole + VEHICLE_GRADE);
        flags |= fused.flags;
    } else
        for (int i = VEHICLE_GRADE; i < VEHICLE_FLAGS; i++)
            whole[i] = (double)NAN;
    double *row = pass->rows + pass->steps * p->corners * CHANNELS;
    for (int c = 0; c < p->corners; c++, row += CHANNELS) {
        const double power_ff = m->energy_ff[c] / dt_s;
        const double share = p->plan->force_share[c];
        /* a disc at rest turns no motion into heat */
        const double moved =
            p->on_stand && p->wheel[c] < STANDING_MS ? 0.0 : share;
        double chosen = power_ff + moved * (unpressed / dt_s);
        if (fuses) chosen = fused.power[c];
        else if ((p->options->mode == MODE_FB) == (source[c] != OTHER))
            chosen = moved * power_fb;
        if (source[c] == OTHER && now.at_risk[c])
            flags |= FLAG_HEAT_SUBSTITUTED;
        m->total_ff[c] += m->energy_ff[c];
        row[CHANNEL_SPEED_MS] = speed;
        row[CHANNEL_PRESSURE_PA] = m->pressure_sum[c] / dt_s;
        row[CHANNEL_BRAKE_ON] = m->on_time[c] / dt_s;
        row[CHANNEL_WETNESS] = wetness;
        row[CHANNEL_AMBIENT_K] = ambient_k;
        row[CHANNEL_BRAKE_POWER_W] = chosen;
        row[CHANNEL_BRAKE_ENERGY_FF_J] = m->total_ff[c];
        row[CHANNEL_BRAKE_ENERGY_FB_J] = share * m->total_fb;
        row[CHANNEL_BRAKE_POWER_STD_W] =
            fuses ? fused.power_std[c] : (double)NAN;
        for (int node = 0; node < MEASURED_COUNT; node++)
            row[MEASURED_FROM + node] =
                inputs_reading(p, p->measured_role[c] + node);
    }
    whole[VEHICLE_SPEED_MS] = speed;
    whole[VEHICLE_DISTANCE_M] = m->distance;
    whole[VEHICLE_BRAKE_FORCE_N] =
        (m->force_sum > 0.0 ? m->force_sum : 0.0) / dt_s;
    whole[VEHICLE_INPUT_AGE_S] = inputs_input_age_s(p);
    whole[VEHICLE_FLAGS] = (double)flags;
    pass->row_times[pass->steps] = p->t->grid;
    pass->steps++;
    *pass->flags = 0;
    p->t->grid += p->options->step_us;
    clear(p);
    memcpy(m->interface_k, m->next_interface_k, sizeof m->interface_k);
    /* a value may have timed out: compute speeds and pressures again */
    p->stale = 1;
    if (m->unseen != 0.0 || !(flags & (FLAG_SILENT | FLAG_ASLEEP))) return 0;
    m->unseen = 1.0;
    return 1;
}

/* Restart the open step at time_us. */
static void start_axis(Inputs *p, int64_t time_us)
{
    const int64_t step_us = p->options->step_us;
    int64_t whole = time_us / step_us;
    if (time_us % step_us < 0) whole--;
    p->t->now = time_us;
    p->t->grid = (whole + 1) * step_us;
    clear(p);
    p->stale = 1;
}

static int march_to(Pass *pass, int64_t time_us)
{
    Inputs *p = &pass->in;
    while (p->t->grid <= time_us) {
        if (pass->steps == pass->room) return FULL;
        integrate(p, p->t->grid);
        if (close_step(pass)) return LOST;
    }
    integrate(p, time_us);
    p->t->pending = NEVER;
    return DONE;
}

static int move_axis(Pass *pass, int64_t time_us, int64_t ahead)
{
    Inputs *p = &pass->in;
    p->t->pending = NEVER;
    p->t->jumps++;
    const int settled = ahead > 0 && ahead <= CLOCK_SET_US;
    *pass->flags |= settled ? FLAG_SETTLED : FLAG_CLOCK_JUMP;
    if (settled) checks_settle(&p->checks);
    else {
        checks_shift(&p->checks, ahead);
        for (int r = 0; r < ROLES; r++)
            if (p->t->stamp[r] != NEVER) p->t->stamp[r] += ahead;
    }
    start_axis(p, time_us);
    return settled ? SETTLE : JUMP;
}

static int move_to(Pass *pass, int64_t time_us)
{
    Inputs *p = &pass->in;
    PassMemoryInts *t = p->t;
    if (time_us > LIMIT_US || time_us < -LIMIT_US) {
        t->dropped++;
        return DROP;
    }
    if (t->now == NEVER) {
        start_axis(p, time_us);
        return DONE;
    }
    const int64_t ahead = time_us - t->now;
    if (ahead >= -LATE_US && ahead <= AHEAD_US) {
        if (ahead < 0) {
            t->late++;
            return DONE;
        }
        return march_to(pass, time_us);
    }
    const int64_t since = t->pending == NEVER ? 0 : time_us - t->pending;
    if (since == 0 || since > CONFIRM_US || since < -CONFIRM_US) {
        t->pending = time_us;
        t->dropped++;
        return DROP;
    }
    if (ahead > 0 && ahead <= SETTLED_US) return march_to(pass, time_us);
    if (ahead > 0 && ahead <= CLOCK_SET_US && p->m->unseen == 0.0) {
        p->m->unseen = 1.0;
        return LOST;
    }
    return move_axis(pass, time_us, ahead);
}

/* The rate of change of a late sample is unknown and not checked. */
static void take(Inputs *p, int64_t time_us, int role, double value)
{
    if (!isfinite(value)) return;
    const int64_t now = p->t->now, at = time_us > now ? time_us : now;
    const int64_t since =
        at == time_us && inputs_valid(p, role) ? p->t->stamp[role] : NEVER;
    if (checks_admit(&p->checks, at, role, value, p->m->value[role], since)) {
        p->m->value[role] = value;
        p->t->stamp[role] = at;
    }
}

/* Whether the first speed after a silence has come just now. */
static int is_back(Inputs *p)
{
    PassMemoryFloats *m = p->m;
    if (m->unseen == 0.0) return 0;
    inputs_refresh(p);
    p->stale = 1;
    if (!p->speed_known) return 0;
    m->unseen = 0.0;
    m->speed_after = p->speed;
    return 1;
}

ptrdiff_t sample_pass(Pass *p, const int64_t *times, const int32_t *roles,
                      const double *values, ptrdiff_t index, ptrdiff_t count,
                      int *code)
{
    for (; index < count; index++) {
        *code = move_to(p, times[index]);
        if (*code == FULL || *code == LOST) return index;
        const int role = roles[index];
        if (*code != DROP && role >= 0 && role < ROLES)
            take(&p->in, times[index], role, values[index]);
        p->in.stale = 1;
        const int moved = *code == SETTLE || *code == JUMP;
        if (!moved && is_back(&p->in)) *code = BACK;
        if (moved || *code == BACK) return index + 1;
    }
    *code = DONE;
    return index;
}
