/* The observer of the car: mass, bias, drag and friction from its motion.
 * heat/observer.py says what it does and does the same operations in the
 * same order; heat/observer_layout.py has the reasons for the numbers.
 */
#include "_observer.h"

#include <string.h>

#define FELT_NOISE 0.05
#define TORQUE_NOISE 0.03
#define DRAG_TORQUE_NOISE 0.15
#define COMMON 8.0
#define GAIN_COMMON 30.0
#define ASSUMED_DOUBT 0.2
#define OUTLIER 4.0
#define WINDOW_S 0.5
#define RATE_S 0.5
#define SLOW_RATE_S 4.0
#define RESTART_S 12.0
#define ROUGH_S 10.0
#define ROUGH_MS2 1.5
#define GAIN_RATE 0.4
#define GAIN_NOISE 0.12
#define LEAST_SPEED 4.0
#define MOST_LATERAL 2.0
#define CALM_S 1.0
#define RELEASED_S 0.7
#define PRESSED_S 0.4
#define LEAST_BRAKE 150.0
#define WIND_SHARE 0.4
#define FORM_NOISE 0.05
#define DRIFT_S 60.0

#define COPY_S 60.0
#define EXTERNAL_S 2.0
#define EXTERNAL_HOLD_S 30.0
#define EXTERNAL_SHARE 0.4
#define PUSHED_MS2 0.35
#define IDLE_PUSH 0.15
#define IDLE_OUTLIER 2.5
#define GRADE_S 0.3
#define HEIGHT_PATH_M 1000.0
#define HEIGHT_NOISE_M 2.0
#define GAIN_LOW (-0.2)
#define GAIN_HIGH 0.2
#define UNFELT (-0.6)
#define CHANGED_LEAST 20.0
#define CHANGED_MOST 60.0
#define RADIUS_S 60.0
#define RADIUS_LIMIT 0.05
#define DEAD_MS2 2.0
#define DEAD_S 6.0
#define STOOD_S 30.0

enum { W_NONE, W_DRIVEN, W_BRAKED };

#define ROLLING_SD 0.02
#define LOAD_SD 0.03

void bstm_observer_new(Observer *o)
{
    double *n = o->n;
    const double resets = n[O_RESETS];
    for (int i = 0; i < OBSERVER_NUMBERS; i++) n[i] = 0.0;
    n[O_RESETS] = resets;
    n[O_STATE + X_MASS] = 1.0;
    n[O_STATE + X_BIAS] = -o->rolling;
    n[O_STATE + X_DRAG] = 1.0;
    n[O_STATE + X_GAIN] = 0.02;
    for (int i = 0; i < STATES; i++)
        n[O_COV + i * STATES + i] = BSTM_SD[i] * BSTM_SD[i];
    n[O_ROLLING_VAR] = ROLLING_SD * ROLLING_SD;
    n[O_RADIUS_RATIO] = 1.0;
    n[O_LAST_SPEED] = UNKNOWN;
    memcpy(n + O_RECENT, n, LEARNED * sizeof *n);
    memcpy(n + O_EARLIER, n, LEARNED * sizeof *n);
    memcpy(n + O_FIRST, n, LEARNED * sizeof *n);
    n[O_STARTED] = 1.0;
}

static void keep_copies(double *n, double dt_s)
{
    n[O_COPY_AGE] += dt_s;
    if (n[O_COPY_AGE] < COPY_S) return;
    memcpy(n + O_EARLIER, n + O_RECENT, LEARNED * sizeof *n);
    memcpy(n + O_RECENT, n, LEARNED * sizeof *n);
    n[O_COPY_AGE] = 0.0;
}

/* Forget what was learned within the last minutes. */
static void roll_back(double *n)
{
    memcpy(n, n + O_EARLIER, LEARNED * sizeof *n);
    memcpy(n + O_RECENT, n + O_EARLIER, LEARNED * sizeof *n);
    n[O_COPY_AGE] = 0.0;
}

/* What this drive has taught rests on a wrong scale. */
static void forget_drive(double *n)
{
    memcpy(n + O_EARLIER, n + O_FIRST, LEARNED * sizeof *n);
    roll_back(n);
}

/* Whether wheels and satellites disagree on the speed. */
static int strange_radius(const double *n)
{
    return fabs(n[O_RADIUS_RATIO] - 1.0) > RADIUS_LIMIT;
}

static void suspect_external(double *n, double seconds)
{
    n[O_EXTERNAL] += seconds;
    if (n[O_EXTERNAL] < EXTERNAL_S) return;
    if (n[O_EXTERNAL_HELD] <= 0.0) roll_back(n);
    n[O_EXTERNAL_HELD] = EXTERNAL_HOLD_S;
    n[O_EXTERNAL] = EXTERNAL_S;
}

static void trust(double *n, double seconds)
{
    n[O_EXTERNAL] -= 0.5 * seconds;
    if (n[O_EXTERNAL] < 0.0) n[O_EXTERNAL] = 0.0;
    n[O_EXTERNAL_HELD] -= seconds;
    if (n[O_EXTERNAL_HELD] < 0.0) n[O_EXTERNAL_HELD] = 0.0;
}

static void learn_motion(Observer *o, double felt, double push, double drag,
                         double rate)
{
    double *n = o->n;
    const double h[STATES] = {push - o->rotating * rate, 1.0, -drag, rate};
    const double relative = push < 0.0 ? DRAG_TORQUE_NOISE : TORQUE_NOISE;
    const double torque = relative * n[O_STATE + X_MASS] * push;
    const double noise = COMMON * (FELT_NOISE * FELT_NOISE + torque * torque);
    const double apart = felt - bstm_product(n + O_STATE, h);
    const double spread = bstm_quadratic(n + O_COV, h)
        + FELT_NOISE * FELT_NOISE + torque * torque;
    /* without torque only a slope's pull, which is not felt, gains speed */
    const int pushed = apart > (push < IDLE_PUSH ? IDLE_OUTLIER : OUTLIER)
        * sqrt(spread) && apart > PUSHED_MS2;
    if (pushed) suspect_external(n, WINDOW_S);
    if (pushed || fabs(apart) > OUTLIER * sqrt(spread)) return;
    trust(n, WINDOW_S);
    if (n[O_EXTERNAL_HELD] > 0.0) return;
    bstm_walk(n, 0, MOTION, WINDOW_S);
    bstm_update(n, 0, h, apart, noise);
}

static void learn_friction(Observer *o, double felt, double push, double drag,
                           double rate, double speed, double brake_n,
                           double pressure_pa, int torque_known)
{
    double *n = o->n;
    double uncertain, h[STATES];
    const double braking = bstm_braking(o, felt, push, drag, rate, &uncertain);
    const double given = brake_n / o->mass_kg * n[O_STATE + X_MASS];
    bstm_forms(speed, pressure_pa, h);
    const double level = bstm_product(n + O_STATE, h);
    const double assumed = torque_known ? 0.0 : ASSUMED_DOUBT;
    const double doubt = sqrt(FELT_NOISE * FELT_NOISE + uncertain * uncertain
                              + assumed * assumed);
    if (braking + 2.5 * doubt < EXTERNAL_SHARE * (given * exp(level))) {
        suspect_external(n, WINDOW_S);
        return;
    }
    trust(n, WINDOW_S);
    /* an assumed torque is the driver's word, not a measurement */
    if (!torque_known) return;
    if (n[O_EXTERNAL_HELD] > 0.0 || braking < 0.3 * given) return;
    const double white = FELT_NOISE / braking;
    const double wind = WIND_SHARE * (n[O_STATE + X_DRAG] * drag) / braking;
    /* an error of the motion's states is one of the friction for good */
    h[X_MASS] = -(push - o->rotating * rate) / braking;
    h[X_BIAS] = -1.0 / braking;
    h[X_DRAG] = drag / braking;
    h[X_GAIN] = -rate / braking;
    const double noise = 4.0 * (white * white) + COMMON * (wind * wind)
        + FORM_NOISE * FORM_NOISE;
    const double apart = log(braking / given) - level;
    const double spread = bstm_quadratic(n + O_COV, h) + white * white
        + wind * wind + FORM_NOISE * FORM_NOISE;
    if (fabs(apart) > OUTLIER * sqrt(spread)) return;
    bstm_update(n, MOTION, h, apart, noise);
}

/* The friction's passing part fades; all else walks slowly. */
static void let_friction_pass(double *n, double dt_s)
{
    const double keep = exp(-dt_s / DRIFT_S);
    double *cov = n + O_COV;
    bstm_walk(n, MOTION, STATES, dt_s);
    n[O_STATE + X_DRIFT] *= keep;
    for (int i = 0; i < STATES; i++) {
        cov[i * STATES + X_DRIFT] *= keep;
        cov[X_DRIFT * STATES + i] *= keep;
    }
    cov[X_DRIFT * STATES + X_DRIFT] += (1.0 - keep * keep)
        * (BSTM_SD[X_DRIFT] * BSTM_SD[X_DRIFT]);
}

/* Whether the accelerometer follows the wheels by another scale. */
static int strange_gain(const double *n)
{
    return n[O_CHANGED] > CHANGED_LEAST
        && (n[O_ALIKE] < GAIN_LOW * n[O_CHANGED]
            || n[O_ALIKE] > GAIN_HIGH * n[O_CHANGED]);
}

/* Whether it does not follow them at all, as on a stand. */
static int unfelt(const double *n)
{
    return n[O_CHANGED] > CHANGED_LEAST
        && n[O_ALIKE] < UNFELT * n[O_CHANGED];
}

/* Body pitch and scale: what is felt when the wheels' rate changes fast. */
static void learn_gain(Observer *o, const Step *s, int learns)
{
    double *n = o->n;
    const double rate = n[O_RATE] - n[O_SLOW_RATE];
    const double more = n[O_FELT] - n[O_RATE]
        - (n[O_SLOW_FELT] - n[O_SLOW_RATE]);
    n[O_GAIN_TIME] += s->dt_s;
    if (n[O_GAIN_TIME] < WINDOW_S) return;
    n[O_GAIN_TIME] = 0.0;
    if (!s->steady || s->speed < LEAST_SPEED || fabs(rate) < GAIN_RATE
        || n[O_ROUGH] > ROUGH_MS2 * ROUGH_MS2)
        return;
    n[O_ALIKE] += more * rate;
    n[O_CHANGED] += rate * rate;
    if (n[O_CHANGED] > CHANGED_MOST) {
        const double faded = CHANGED_MOST / n[O_CHANGED];
        n[O_ALIKE] *= faded;
        n[O_CHANGED] *= faded;
    }
    if (unfelt(n)) suspect_external(n, WINDOW_S);
    if (strange_gain(n)) {
        forget_drive(n);
    }
    if (!learns || strange_gain(n)) return;
    const double h[STATES] = {0.0, 0.0, 0.0, rate};
    const double apart = more - n[O_STATE + X_GAIN] * rate;
    if (fabs(apart) > 3.0 * GAIN_NOISE) return;
    bstm_update(n, 0, h, apart, GAIN_COMMON * GAIN_NOISE * GAIN_NOISE);
}

static void follow(Observer *o, const Step *s)
{
    double *n = o->n;
    if (n[O_LAST_SPEED] < 0.0) {
        n[O_LAST_SPEED] = s->end_speed;
        n[O_FELT] = n[O_SLOW_FELT] = s->felt;
        n[O_RATE] = n[O_SLOW_RATE] = 0.0;
        n[O_GAIN_TIME] = -RESTART_S;
    }
    const double rate = (s->end_speed - n[O_LAST_SPEED]) / s->dt_s;
    const double share = 1.0 - exp(-s->dt_s / RATE_S);
    const double slow = 1.0 - exp(-s->dt_s / SLOW_RATE_S);
    const double jump = rate - n[O_RATE];
    n[O_ROUGH] += (1.0 - exp(-s->dt_s / ROUGH_S)) * (jump * jump - n[O_ROUGH]);
    n[O_LAST_SPEED] = s->end_speed;
    n[O_RATE] += share * (rate - n[O_RATE]);
    n[O_FELT] += share * (s->felt - n[O_FELT]);
    n[O_SLOW_RATE] += slow * (n[O_RATE] - n[O_SLOW_RATE]);
    n[O_SLOW_FELT] += slow * (n[O_FELT] - n[O_SLOW_FELT]);
}

static void follow_grade(Observer *o, const Step *s)
{
    double *n = o->n;
    const double bias = n[O_STATE + X_BIAS] + o->rolling + n[O_ROLLING];
    const double gain = 1.0 + n[O_STATE + X_GAIN];
    const double upward = n[O_FELT] - gain * n[O_RATE] - bias;
    const double sine = bstm_clipped(upward / GRAVITY, -0.5, 0.5);
    n[O_SINE] += (1.0 - exp(-s->dt_s / GRADE_S)) * (sine - n[O_SINE]);
    if (isnan(s->height) || n[O_EXTERNAL_HELD] > 0.0 || strange_gain(n)) {
        n[O_HEIGHT_PATH] = 0.0;
        return;
    }
    if (n[O_HEIGHT_PATH] <= 0.0) {
        n[O_HEIGHT_LAST] = s->height;
        n[O_HEIGHT_WORK] = 0.0;
    }
    const double path = s->speed * s->dt_s;
    n[O_HEIGHT_WORK] += (upward + n[O_ROLLING]) * path;
    n[O_HEIGHT_PATH] += path;
    if (n[O_HEIGHT_PATH] < HEIGHT_PATH_M) return;
    const double climbed = GRAVITY * (s->height - n[O_HEIGHT_LAST]);
    const double found = (n[O_HEIGHT_WORK] - climbed) / n[O_HEIGHT_PATH];
    const double sd = 1.5 * GRAVITY * HEIGHT_NOISE_M / n[O_HEIGHT_PATH];
    const double apart = found - n[O_ROLLING];
    const double rolling = n[O_ROLLING_VAR];
    const double spread =
        n[O_COV + X_BIAS * STATES + X_BIAS] + rolling + sd * sd;
    n[O_HEIGHT_PATH] = 0.0;
    if (fabs(apart) > OUTLIER * sqrt(spread)) return;
    /* who is surer of himself moves less; without torque the bias is free */
    const double h[STATES] = {0.0, 1.0};
    bstm_update(n, 0, h, apart, rolling + sd * sd);
    const double share = rolling / spread;
    n[O_ROLLING] += share * apart;
    n[O_ROLLING_VAR] *= 1.0 - share;
    n[O_ROLLING_VAR] += 1e-6;
}

/* Sums over half seconds of one kind; returns whether one is complete. */
static int gather(double *n, const Step *s, int kind, double first_speed)
{
    if (kind != (int)n[W_KIND] || kind == W_NONE) {
        n[W_KIND] = (double)kind;
        n[W_TIME] = 0.0;
        for (int i = W_FELT; i <= W_SPEED; i++) n[i] = 0.0;
        n[W_FIRST_SPEED] = first_speed;
        if (kind == W_NONE) return 0;
    }
    n[W_TIME] += s->dt_s;
    n[W_FELT] += s->felt * s->dt_s;
    n[W_PUSH] += s->push * s->dt_s;
    n[W_DRAG] += s->drag * s->dt_s;
    n[W_BRAKE] += s->brake_n * s->dt_s;
    n[W_PRESSURE] += s->pressure_pa * s->dt_s;
    n[W_SPEED] += s->speed * s->dt_s;
    return n[W_TIME] > WINDOW_S - 1e-6;
}

static void learn(Observer *o, const Step *s)
{
    double *n = o->n;
    const int kind = (int)n[W_KIND];
    const double t = n[W_TIME];
    const double rate = (s->end_speed - n[W_FIRST_SPEED]) / t;
    if (kind == W_DRIVEN)
        learn_motion(o, n[W_FELT] / t, n[W_PUSH] / t, n[W_DRAG] / t, rate);
    else
        learn_friction(o, n[W_FELT] / t, n[W_PUSH] / t, n[W_DRAG] / t, rate,
                       n[W_SPEED] / t, n[W_BRAKE] / t, n[W_PRESSURE] / t,
                       s->torque_known);
    n[W_KIND] = (double)W_NONE;
}

static int kind_of(const double *n, const Step *s)
{
    if (n[O_CALM] < CALM_S) return W_NONE;
    if (n[O_RELEASED] >= RELEASED_S)
        return s->torque_known ? W_DRIVEN : W_NONE;
    if (n[O_PRESSED] >= PRESSED_S && s->brake_n > LEAST_BRAKE) return W_BRAKED;
    return W_NONE;
}

/* How long nothing has disturbed, and the brake is on or off. */
static void keep_times(double *n, const Step *s)
{
    const int shifted =
        s->gear != n[O_LAST_GEAR] || s->clutch != n[O_LAST_CLUTCH];
    n[O_LAST_GEAR] = s->gear;
    n[O_LAST_CLUTCH] = s->clutch;
    const int calm = s->steady && s->forward && !shifted
        && s->speed > LEAST_SPEED && s->lateral < MOST_LATERAL
        && !strange_gain(n) && !strange_radius(n);
    n[O_CALM] = calm ? n[O_CALM] + s->dt_s : 0.0;
    n[O_RELEASED] = s->pressure_known && !s->pressed
        ? n[O_RELEASED] + s->dt_s : 0.0;
    n[O_PRESSED] = s->pressed ? n[O_PRESSED] + s->dt_s : 0.0;
}

/* People and luggage get in and out while the car stands. */
static void keep_load(double *n, const Step *s)
{
    if (s->speed > STANDING_MS) {
        if (n[O_STOOD] > STOOD_S) {
            double *own = n + O_COV;
            *own += LOAD_SD * LOAD_SD;
            if (*own > BSTM_SD[0] * BSTM_SD[0]) *own = BSTM_SD[0] * BSTM_SD[0];
        }
        n[O_STOOD] = 0.0;
    } else n[O_STOOD] += s->dt_s;
}

static void compare_radius(double *n, const Step *s)
{
    if (isnan(s->gnss_speed) || s->gnss_speed < REFERENCE_SPEED || !s->steady)
        return;
    const double share = 1.0 - exp(-s->dt_s / RADIUS_S);
    n[O_RADIUS_RATIO] +=
        share * (s->speed / s->gnss_speed - n[O_RADIUS_RATIO]);
}

/* Hard braking again and again, and no pressure ever. */
static void watch_pressure(Observer *o, const Step *s)
{
    double *n = o->n, spread;
    if (s->brake_n > 0.0) {
        n[O_UNPRESSED] = 0.0;
        return;
    }
    const double braking = bstm_braking(o, n[O_FELT], s->push, s->drag,
                                        n[O_RATE], &spread);
    if (s->brake_switch != 0.0 && s->torque_known && s->pressure_known
        && s->steady
        && s->speed > LEAST_SPEED
        && -n[O_RATE] > DEAD_MS2 && braking - 2.5 * spread > DEAD_MS2)
        n[O_UNPRESSED] += s->dt_s;
}

int bstm_observe(Observer *o, const Step *s)
{
    double *n = o->n;
    int found = 0;
    if (n[O_STARTED] == 0.0) bstm_observer_new(o);
    keep_load(n, s);
    let_friction_pass(n, s->dt_s);
    if (isnan(s->felt) || isnan(s->push)) {
        n[O_LAST_SPEED] = UNKNOWN;
        n[O_CALM] = n[O_HEIGHT_PATH] = 0.0;
        gather(n, s, W_NONE, 0.0);
    } else {
        const double first_speed =
            n[O_LAST_SPEED] < 0.0 ? s->end_speed : n[O_LAST_SPEED];
        follow(o, s);
        keep_times(n, s);
        if (s->on_stand) suspect_external(n, s->dt_s);
        compare_radius(n, s);
        if (strange_radius(n)) forget_drive(n);
        watch_pressure(o, s);
        learn_gain(o, s, n[O_CALM] >= CALM_S && n[O_EXTERNAL_HELD] <= 0.0);
        if (gather(n, s, kind_of(n, s), first_speed)) learn(o, s);
        follow_grade(o, s);
        keep_copies(n, s->dt_s);
    }
    if (!bstm_sound(n)) {
        n[O_RESETS] += 1.0;
        bstm_observer_new(o);
        found |= OBSERVER_RESET;
    }
    if (n[O_EXTERNAL_HELD] > 0.0) found |= EXTERNAL_SUSPECTED;
    if (strange_gain(n)) found |= GAIN_SUSPECT;
    if (strange_radius(n)) found |= RADIUS_SUSPECT;
    if (n[O_UNPRESSED] > DEAD_S) found |= PRESSURE_DEAD;
    return found;
}
