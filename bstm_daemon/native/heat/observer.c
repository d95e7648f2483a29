#include "observer.h"

#include <string.h>

#include "observer_faults.h"

double observer_braking(const Observer *o, double accel, double drive,
                        double drag, double rate, double *std)
{
    const double h[STATES] = {drive - o->rotating * rate, 1.0, -drag, rate};
    *std = sqrt(learned_quadratic(o->m->known.cov, h));
    return learned_product(o->m->known.x, h) - accel;
}

/* Start again from the configured values. */
static void begin(Observer *o)
{
    ObserverMemory *m = o->m, fresh = {.resets = m->resets};
    memcpy(fresh.brake_sum, m->brake_sum, sizeof fresh.brake_sum);
    learned_begin(&fresh.known, o->rolling);
    fresh.recent = fresh.earlier = fresh.first = fresh.known;
    fresh.started = 1.0;
    for (int i = 0; i < GROUND_SPEEDS; i++) fresh.radius_ratio[i] = 1.0;
    fresh.last_speed = UNKNOWN;
    *m = fresh;
}

static void keep_copies(ObserverMemory *m, double dt_s)
{
    m->copy_age_s += dt_s;
    if (m->copy_age_s < COPY_S) return;
    m->earlier = m->recent;
    m->recent = m->known;
    m->copy_age_s = 0.0;
}

/* Forget what was learned within the last minutes. */
static void roll_back(ObserverMemory *m)
{
    m->known = m->recent = m->earlier;
    m->copy_age_s = 0.0;
}

/* Forget this drive: its data have a wrong scale. */
static void forget_drive(ObserverMemory *m)
{
    m->earlier = m->first;
    roll_back(m);
}

static void suspect_external(ObserverMemory *m, double seconds)
{
    m->external_s += seconds;
    if (m->external_s < EXTERNAL_S) return;
    if (m->external_held_s <= 0.0) roll_back(m);
    m->external_held_s = EXTERNAL_HOLD_S;
    m->external_s = EXTERNAL_S;
    m->proof_s = PROOF_S;
}

static void release_external(ObserverMemory *m, double seconds)
{
    m->external_s -= 0.5 * seconds;
    if (m->external_s < 0.0) m->external_s = 0.0;
    m->external_held_s -= seconds;
    if (m->external_held_s < 0.0) m->external_held_s = 0.0;
}

static void learn_motion(Observer *o, double accel, double drive, double drag,
                         double rate)
{
    ObserverMemory *m = o->m;
    const double h[STATES] = {drive - o->rotating * rate, 1.0, -drag, rate};
    const double relative = drive < 0.0 ? DRAG_TORQUE_NOISE : TORQUE_NOISE;
    const double torque = relative * m->known.x[MASS] * drive;
    const double noise =
        CORRELATED_WINDOWS * (ACCEL_NOISE * ACCEL_NOISE + torque * torque);
    const double innovation = accel - learned_product(m->known.x, h);
    const double std = sqrt(learned_quadratic(m->known.cov, h)
                            + ACCEL_NOISE * ACCEL_NOISE + torque * torque);
    const double most = drive < IDLE_DRIVE_MS2 ? IDLE_OUTLIER : OUTLIER;
    const int pushed =
        innovation > most * std && innovation > EXTERNAL_MS2;
    if (pushed) suspect_external(m, WINDOW_S);
    observer_faults_count_drive(m, innovation, std, m->known.x[MASS] * drive);
    if (pushed || fabs(innovation) > OUTLIER * std) return;
    release_external(m, WINDOW_S);
    if (m->external_held_s > 0.0) return;
    learned_add_process_noise(&m->known, 0, FIRST_FRICTION, WINDOW_S);
    learned_update(&m->known, 0, h, innovation, noise);
}

static void learn_friction(Observer *o, double accel, double drive,
                           double drag, double rate, const Step *s)
{
    ObserverMemory *m = o->m;
    const double t = m->window_s;
    double braking_std, h[STATES];
    const double braking =
        observer_braking(o, accel, drive, drag, rate, &braking_std);
    const double ff_decel = m->window_brake / t / o->mass_kg * m->known.x[MASS];
    learned_friction_row(m->window_speed / t, m->window_pressure / t, h);
    const double level = learned_product(m->known.x, h);
    const double assumed = s->torque_known ? 0.0 : ASSUMED_TORQUE_STD;
    const double std = sqrt(ACCEL_NOISE * ACCEL_NOISE
                            + braking_std * braking_std + assumed * assumed);
    const double least = EXTERNAL_SHARE * (ff_decel * exp(level));
    if (braking + 2.5 * std < least) {
        suspect_external(m, WINDOW_S);
        return;
    }
    release_external(m, WINDOW_S);
    if (braking - 2.5 * std > least) {
        m->proof_s -= WINDOW_S;
        if (m->proof_s < 0.0) m->proof_s = 0.0;
    }
    /* an assumed torque is no measurement */
    if (!s->torque_known) return;
    observer_faults_compare_forces(m, ff_decel, braking, braking_std);
    if (m->external_held_s > 0.0 || braking < 0.3 * ff_decel) return;
    const double white = ACCEL_NOISE / braking;
    const double wind = WIND_SHARE * (m->known.x[DRAG] * drag) / braking;
    /* an error of the motion's states stays in the friction */
    h[MASS] = -(drive - o->rotating * rate) / braking;
    h[BIAS] = -1.0 / braking;
    h[DRAG] = drag / braking;
    h[GAIN] = -rate / braking;
    const double noise = 4.0 * (white * white)
        + CORRELATED_WINDOWS * (wind * wind) + MODEL_NOISE * MODEL_NOISE;
    const double innovation = log(braking / ff_decel) - level;
    const double innovation_var = learned_quadratic(m->known.cov, h)
        + white * white + wind * wind + MODEL_NOISE * MODEL_NOISE;
    if (observer_faults_is_outlier(m, innovation, sqrt(innovation_var))) return;
    learned_update(&m->known, FIRST_FRICTION, h, innovation, noise);
}

/* Let the drift of the friction decay; add noise to all else. */
static void decay_drift(ObserverMemory *m, double dt_s)
{
    const double keep = exp(-dt_s / DRIFT_S);
    double *cov = m->known.cov;
    learned_add_process_noise(&m->known, FIRST_FRICTION, STATES, dt_s);
    m->known.x[DRIFT] *= keep;
    for (int i = 0; i < STATES; i++) {
        cov[i * STATES + DRIFT] *= keep;
        cov[DRIFT * STATES + i] *= keep;
    }
    cov[DRIFT * STATES + DRIFT] += (1.0 - keep * keep)
        * (P0_STD[DRIFT] * P0_STD[DRIFT]);
}

/* Compare changes of accel with those of dv/dt: pitch and scale. */
static void learn_gain(Observer *o, const Step *s, int learns)
{
    ObserverMemory *m = o->m;
    const double rate = m->rate - m->slow_rate;
    const double more = m->accel_measured - m->rate
        - (m->slow_accel - m->slow_rate);
    m->gain_time_s += s->dt_s;
    if (m->gain_time_s < WINDOW_S) return;
    m->gain_time_s = 0.0;
    if (!s->steady || s->speed < LEAST_SPEED_MS || fabs(rate) < GAIN_RATE_MS2
        || m->roughness > ROUGHNESS_MS2 * ROUGHNESS_MS2)
        return;
    m->gain_product += more * rate;
    m->gain_square += rate * rate;
    if (m->gain_square > GAIN_SQUARE_MOST) {
        const double faded = GAIN_SQUARE_MOST / m->gain_square;
        m->gain_product *= faded;
        m->gain_square *= faded;
    }
    if (observer_faults_motion_unmeasured(m)) suspect_external(m, WINDOW_S);
    if (observer_faults_implausible_gain(m)) forget_drive(m);
    if (!learns || observer_faults_implausible_gain(m)) return;
    const double h[STATES] = {0.0, 0.0, 0.0, rate};
    const double innovation = more - m->known.x[GAIN] * rate;
    if (fabs(innovation) > 3.0 * GAIN_NOISE) return;
    learned_update(&m->known, 0, h, innovation,
                   CORRELATED_GAIN_WINDOWS * GAIN_NOISE * GAIN_NOISE);
}

static void filter_motion(Observer *o, const Step *s)
{
    ObserverMemory *m = o->m;
    if (m->last_speed < 0.0) {
        m->last_speed = s->end_speed;
        m->accel_measured = m->slow_accel = s->accel;
        m->rate = m->slow_rate = 0.0;
        m->gain_time_s = -RESTART_S;
    }
    const double rate = (s->end_speed - m->last_speed) / s->dt_s;
    const double share = 1.0 - exp(-s->dt_s / RATE_S);
    const double slow = 1.0 - exp(-s->dt_s / SLOW_RATE_S);
    const double jump = rate - m->rate;
    m->roughness +=
        (1.0 - exp(-s->dt_s / ROUGHNESS_S)) * (jump * jump - m->roughness);
    m->last_speed = s->end_speed;
    m->rate += share * (rate - m->rate);
    m->accel_measured += share * (s->accel - m->accel_measured);
    m->slow_rate += slow * (m->rate - m->slow_rate);
    m->slow_accel += slow * (m->accel_measured - m->slow_accel);
}

static void follow_grade(Observer *o, const Step *s)
{
    ObserverMemory *m = o->m;
    const double bias = m->known.x[BIAS] + o->rolling + m->known.rolling_error;
    const double gain = 1.0 + m->known.x[GAIN];
    const double upward = m->accel_measured - gain * m->rate - bias;
    const double sine = learned_clipped(upward / GRAVITY_MS2, -0.5, 0.5);
    m->sine += (1.0 - exp(-s->dt_s / GRADE_S)) * (sine - m->sine);
    if (isnan(s->height) || m->external_held_s > 0.0 || observer_faults_implausible_gain(m)) {
        m->height_path = 0.0;
        return;
    }
    if (m->height_path <= 0.0) {
        m->height_last = s->height;
        m->height_work = 0.0;
    }
    const double path = s->speed * s->dt_s;
    m->height_work += (upward + m->known.rolling_error) * path;
    m->height_path += path;
    if (m->height_path < HEIGHT_PATH_M) return;
    const double climbed = GRAVITY_MS2 * (s->height - m->height_last);
    const double found = (m->height_work - climbed) / m->height_path;
    const double std = 1.5 * GRAVITY_MS2 * HEIGHT_NOISE_M / m->height_path;
    const double innovation = found - m->known.rolling_error;
    const double rolling = m->known.rolling_var;
    const double innovation_var =
        m->known.cov[BIAS * STATES + BIAS] + rolling + std * std;
    m->height_path = 0.0;
    if (fabs(innovation) > OUTLIER * sqrt(innovation_var)) return;
    /* weight by variance; without torque the bias is free */
    const double h[STATES] = {0.0, 1.0};
    learned_update(&m->known, 0, h, innovation, rolling + std * std);
    const double share = rolling / innovation_var;
    m->known.rolling_error += share * innovation;
    m->known.rolling_var *= 1.0 - share;
    m->known.rolling_var += 1e-6;
}

/* Sum half a second of one kind; returns whether it is complete. */
static int accumulate_window(ObserverMemory *m, const Step *s, double kind,
                             double first_speed)
{
    if (kind != m->window_kind || kind == WINDOW_NONE) {
        m->window_kind = kind;
        m->window_s = m->window_accel = m->window_drive = 0.0;
        m->window_drag = m->window_brake = 0.0;
        m->window_pressure = m->window_speed = 0.0;
        m->window_first_speed = first_speed;
        if (kind == WINDOW_NONE) return 0;
    }
    m->window_s += s->dt_s;
    m->window_accel += s->accel * s->dt_s;
    m->window_drive += s->drive * s->dt_s;
    m->window_drag += s->drag * s->dt_s;
    m->window_brake += (s->pressed ? s->brake_n : s->light_n) * s->dt_s;
    m->window_pressure += s->pressure_pa * s->dt_s;
    m->window_speed += s->speed * s->dt_s;
    return m->window_s > WINDOW_S - 1e-6;
}

static void learn_window(Observer *o, const Step *s)
{
    ObserverMemory *m = o->m;
    const double t = m->window_s;
    const double rate = (s->end_speed - m->window_first_speed) / t;
    const double accel = m->window_accel / t, drive = m->window_drive / t;
    const double drag = m->window_drag / t;
    if (m->window_kind == WINDOW_DRIVEN) {
        double variance;
        const double scale = exp(learned_friction(
            &m->known, m->window_speed / t, m->window_pressure / t, &variance));
        const double light =
            m->window_brake / t / o->mass_kg * m->known.x[MASS] * scale;
        learn_motion(o, accel + light, drive, drag, rate);
    } else {
        learn_friction(o, accel, drive, drag, rate, s);
    }
    m->window_kind = WINDOW_NONE;
}

static double window_kind(const ObserverMemory *m, const Step *s)
{
    if (m->calm_s < CALM_S) return WINDOW_NONE;
    if (m->released_s >= RELEASED_S)
        return s->torque_known ? WINDOW_DRIVEN : WINDOW_NONE;
    if (m->pressed_s >= PRESSED_S && s->brake_n > LEAST_BRAKE_N)
        return WINDOW_BRAKED;
    return WINDOW_NONE;
}

/* Update the times since a disturbance, of brake on and brake off. */
static void keep_times(ObserverMemory *m, const Step *s)
{
    const int shifted =
        s->gear != m->last_gear || s->clutch != m->last_clutch;
    m->last_gear = s->gear;
    m->last_clutch = s->clutch;
    const int calm = s->steady && s->forward && !shifted
        && s->speed > LEAST_SPEED_MS && s->lateral < MOST_LATERAL_MS2
        && !observer_faults_implausible_gain(m) && !observer_faults_implausible_radius(m);
    m->calm_s = calm ? m->calm_s + s->dt_s : 0.0;
    m->released_s = s->pressure_known && !s->pressed
        ? m->released_s + s->dt_s : 0.0;
    m->pressed_s = s->pressed ? m->pressed_s + s->dt_s : 0.0;
}

/* Raise the variance of the mass after a stop: its load may change. */
static void widen_mass(ObserverMemory *m, const Step *s)
{
    if (s->speed > STANDING_MS) {
        if (m->stood_s > STOOD_S) {
            double *own = m->known.cov;
            *own += LOAD_STD * LOAD_STD;
            if (*own > P0_STD[0] * P0_STD[0]) *own = P0_STD[0] * P0_STD[0];
        }
        m->stood_s = 0.0;
    } else m->stood_s += s->dt_s;
}

/* Sum the time of hard braking since the last pressure. */
static void watch_pressure(Observer *o, const Step *s)
{
    ObserverMemory *m = o->m;
    double std;
    if (s->brake_n > 0.0) {
        m->unpressed_s = 0.0;
        return;
    }
    const double braking = observer_braking(o, m->accel_measured, s->drive,
                                            s->drag, m->rate, &std);
    if (s->brake_switch != 0.0 && s->torque_known && s->pressure_known
        && s->steady
        && s->speed > LEAST_SPEED_MS
        && -m->rate > DEAD_MS2 && braking - 2.5 * std > DEAD_MS2)
        m->unpressed_s += s->dt_s;
}

int observer_observe(Observer *o, const Step *s)
{
    ObserverMemory *m = o->m;
    int found = 0;
    if (m->started == 0.0) begin(o);
    widen_mass(m, s);
    decay_drift(m, s->dt_s);
    if (isnan(s->accel) || isnan(s->drive)) {
        m->last_speed = UNKNOWN;
        m->calm_s = m->height_path = 0.0;
        accumulate_window(m, s, WINDOW_NONE, 0.0);
    } else {
        const double first_speed =
            m->last_speed < 0.0 ? s->end_speed : m->last_speed;
        filter_motion(o, s);
        keep_times(m, s);
        if (s->on_stand) suspect_external(m, s->dt_s);
        observer_faults_compare_radius(m, s);
        if (s->wrong_scale || observer_faults_implausible_radius(m))
            forget_drive(m);
        watch_pressure(o, s);
        learn_gain(o, s, m->calm_s >= CALM_S && m->external_held_s <= 0.0);
        if (accumulate_window(m, s, window_kind(m, s), first_speed))
            learn_window(o, s);
        follow_grade(o, s);
        keep_copies(m, s->dt_s);
    }
    if (!learned_plausible(&m->known)) {
        m->resets += 1.0;
        begin(o);
        found |= OBSERVER_RESET;
    }
    return found | observer_faults_findings(m, s);
}
