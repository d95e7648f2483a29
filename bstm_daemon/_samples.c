/* The compiled pass over samples: heat/sample_pass.py says what it does and
 * does the same operations in the same order; heat/sample_plan.py lays out
 * `ints` and `floats`.
 */
#include "_samples.h"

#include <math.h>

#define TAIL 4.0 /* filter times that Feed-Back runs on after release */
#define LIGHT_PRESSURE 2e4
#define LAW_FROM_K 200.0
#define LAW_STEP_K 20.0
#define LAW_PRESSURE_STEP 2.5e5
#define LAW_SPEED_STEP 1.0
#define LATE_US INT64_C(1000000)
#define AHEAD_US INT64_C(3600000000)
#define SETTLED_US (12 * INT64_C(3600000000))
#define CLOCK_SET_US (30 * 24 * INT64_C(3600000000))
#define CONFIRM_US INT64_C(10000000)
#define LIMIT_US (INT64_C(1) << 60)

enum {
    FLAG_SPEED = 1, FLAG_PRESSURE = 2, FLAG_ACCELERATION = 4,
    FLAG_TORQUE = 8, FLAG_AMBIENT = 16, FLAG_JUMP = 32, FLAG_SETTLED = 64,
    FLAG_CORNER_PRESSURE = 128, FLAG_SUBSTITUTED = 1 << 21
};

static double rear(const Pass *p, double front)
{
    const double *x = p->table_front, *y = p->table_rear;
    const int last = p->points - 1;
    if (front <= x[0]) return y[0];
    if (front >= x[last]) return y[last];
    int i = 0;
    while (front >= x[i + 1]) i++;
    return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i]);
}

static double pressure_of(const Pass *p, const int32_t *corner)
{
    const double *tare = p->observer.n + O_TARE_PRIMARY;
    if (bstm_valid(p, corner[C_PRESSURE])) return p->value[corner[C_PRESSURE]];
    double pressure = bstm_vehicle(p, R_PRIMARY, tare[0]) - tare[0];
    if (corner[C_SECONDARY] && bstm_valid(p, p->role[R_SECONDARY]))
        pressure = p->value[p->role[R_SECONDARY]] - tare[1];
    if (corner[C_REAR] && p->points) return rear(p, pressure);
    return pressure;
}

/* Whether a speed is present that nothing contradicts. */
static int sound_voice(const Pass *p, int vehicle_present)
{
    const double *out = p->checks.left_out;
    if (!p->checks.any_left_out) return 1;
    if (vehicle_present && out[p->corners] == 0.0) return 1;
    for (int c = 0; c < p->corners; c++)
        if (out[c] == 0.0
            && bstm_valid(p, p->corner[c * PER_CORNER_INTS + C_WHEEL]))
            return 1;
    return 0;
}

static void refresh(Pass *p)
{
    double total = 0.0, along = 0.0;
    int count = 0, own[MAX_CORNERS];
    const double *out = p->checks.left_out;
    const int vehicle_present = bstm_valid(p, p->role[R_SPEED]);
    const int sound = sound_voice(p, vehicle_present);
    for (int c = 0; c < p->corners; c++) {
        const int role = p->corner[c * PER_CORNER_INTS + C_WHEEL];
        own[c] = bstm_valid(p, role) && !(sound && out[c] != 0.0);
        if (own[c]) {
            total += fabs(p->value[role]);
            along += p->value[role];
            count++;
        }
    }
    if (vehicle_present && !(sound && out[p->corners] != 0.0)) {
        along = bstm_vehicle(p, R_SPEED, 0.0);
        p->speed = fabs(along);
    } else p->speed = count ? total / (double)count : 0.0;
    p->heading = along < 0.0 ? -1.0 : 1.0;
    p->speed_known = count > 0 || vehicle_present;
    for (int c = 0; c < p->corners; c++) {
        const int32_t *corner = p->corner + c * PER_CORNER_INTS;
        const int role = corner[C_WHEEL];
        p->wheel[c] = own[c] ? fabs(p->value[role]) : p->speed;
        const double pressure = pressure_of(p, corner);
        p->target[c] = pressure > 0.0 ? pressure : 0.0;
    }
    /* the foot is on the pedal: fusion counts the lightest pressure */
    p->on_pressure = p->f[F_ON_PRESSURE];
    if (p->ints[I_MODE] == MODE_FUSED && p->on_pressure > LIGHT_PRESSURE
        && bstm_vehicle(p, R_SWITCH, 0.0) > 0.0)
        p->on_pressure = LIGHT_PRESSURE;
    p->stale = 0;
}

static int pressure_known(const Pass *p)
{
    for (int c = 0; c < p->corners; c++)
        if (bstm_corner_known(p, c)) return 1;
    return 0;
}

/* All of Eq 4.11 but the change of speed, times h; that change acts on
 * *inertia_kg. */
static double outer_impulse(const Pass *p, double h, double v,
                            double *inertia_kg)
{
    const double *f = p->f;
    const double drag = v > 0.0
        ? (f[F_QUADRATIC] * v + f[F_LINEAR]) * v + f[F_CONSTANT] : 0.0;
    const double torque = bstm_vehicle(p, R_TORQUE, f[F_TORQUE]);
    const double external = bstm_vehicle(p, R_EXTERNAL, 0.0);
    const double driving = p->heading * (torque / f[F_RADIUS] + external);
    const double impulse = (driving - drag) * h;
    const int acceleration = p->role[R_ACCELERATION];
    if (p->ints[I_SLOPE] == 0 && bstm_valid(p, acceleration)) {
        const double felt =
            f[F_MASS] * (p->heading * p->value[acceleration]) * h;
        *inertia_kg = f[F_ROTATING];
        return impulse - felt;
    }
    *inertia_kg = f[F_MASS] + f[F_ROTATING];
    return impulse;
}

/* Change of the filtered speed over h; its mean is left in *middle. */
static double filter_speed(Pass *p, double h, double v, double *middle)
{
    *middle = v;
    if (!p->speed_known) {
        p->n[N_FILTERED] = UNKNOWN;
        return 0.0;
    }
    if (p->n[N_FILTERED] < 0.0) {
        p->n[N_FILTERED] = v;
        return 0.0;
    }
    const double before = p->n[N_FILTERED];
    p->n[N_FILTERED] = v + (before - v) * exp(-h / p->f[F_FILTER]);
    *middle = 0.5 * (before + p->n[N_FILTERED]);
    return p->n[N_FILTERED] - before;
}

/* Linear between the points, constant outside (heat/friction_law.py). */
static double look_up(const double *table, double position)
{
    if (!(position > 0.0)) position = 0.0;
    if (position > LAW_POINTS - 1.0) position = LAW_POINTS - 1.0;
    int i = (int)position;
    if (i > LAW_POINTS - 2) i = LAW_POINTS - 2;
    return table[i] + (position - (double)i) * (table[i + 1] - table[i]);
}

static double friction_factor(const double *law, double interface_k,
                              double pressure_pa, double speed)
{
    double factor =
        look_up(law + LAW_POINTS, pressure_pa * (1.0 / LAW_PRESSURE_STEP))
        * look_up(law + 2 * LAW_POINTS, speed * (1.0 / LAW_SPEED_STEP));
    if (interface_k > 0.0)
        factor *= look_up(law, (interface_k - LAW_FROM_K) * (1.0 / LAW_STEP_K));
    return factor;
}

static int feed_back_known(const Pass *p)
{
    return p->speed_known
        && (bstm_valid(p, p->role[R_TORQUE]) || p->ints[I_ASSUMED] != 0);
}

static void integrate(Pass *p, int64_t time_us)
{
    if (time_us <= p->t[S_NOW]) return;
    if (p->stale) refresh(p);
    const double h = (double)(time_us - p->t[S_NOW]) * 1e-6;
    const double v = p->speed;
    double highest = 0.0;
    for (int c = 0; c < p->corners; c++) {
        const double *k = p->corner_f + c * PER_CORNER_FLOATS;
        const double target = p->target[c];
        double pressure;
        /* a pressure measured at the wheel has the lag in it */
        if (k[T_LAG] > 0.0
            && !bstm_valid(p, p->corner[c * PER_CORNER_INTS + C_PRESSURE])) {
            const double decay = exp(-h / k[T_LAG]);
            const double apart = p->lagged[c] - target;
            pressure = target + apart * (k[T_LAG] * (1.0 - decay) / h);
            p->lagged[c] = target + apart * decay;
        } else {
            pressure = target;
            p->lagged[c] = target;
        }
        const double pushing = pressure - k[T_PUSHOUT];
        const int pressed = pressure > p->on_pressure;
        if (pressed && pushing > 0.0) {
            double grip = k[T_PER_PA];
            if (p->law != NULL)
                grip *= friction_factor(p->law + c * LAW, p->interface_k[c],
                                        pressure, p->wheel[c]);
            const double power = grip * pushing * (p->wheel[c] / p->f[F_RADIUS]);
            p->energy_ff[c] += power * h;
            p->observer.brake_sum[c] += grip * pushing / p->f[F_RADIUS] * h;
        }
        p->pressure_sum[c] += pressure * h;
        if (pressed) p->on_time[c] += h;
        if (pressure > highest) highest = pressure;
    }
    double middle, inertia_kg;
    const double gained = filter_speed(p, h, v, &middle);
    const double impulse = outer_impulse(p, h, v, &inertia_kg);
    const double force_s = impulse - inertia_kg * gained;
    const int pressed = pressure_known(p) ? highest > p->on_pressure
                                          : force_s > p->f[F_ON_FORCE] * h;
    if (pressed)
        p->n[N_TAIL] = inertia_kg > p->f[F_ROTATING] ? TAIL * p->f[F_FILTER]
                                                     : 0.0;
    const double braked = impulse * v - inertia_kg * (gained * middle);
    if (pressed || p->n[N_TAIL] > 0.0) {
        p->n[N_FORCE] += force_s;
        p->n[N_ENERGY_FB] += braked;
    } else if (p->f[F_UNPRESSED] > 0.0 && feed_back_known(p)
               && force_s > p->f[F_ON_FORCE] * h) {
        p->n[N_FORCE] += p->f[F_UNPRESSED] * force_s;
        p->n[N_UNPRESSED] += p->f[F_UNPRESSED] * braked;
        for (int c = 0; c < p->corners; c++) p->on_time[c] += h;
    }
    if (!pressed) {
        const double left = p->n[N_TAIL] - h;
        p->n[N_TAIL] = left > 0.0 ? left : 0.0;
    }
    if (p->ints[I_MODE] == MODE_FUSED) bstm_fusion_feel(p, h, v);
    p->n[N_SPEED] += v * h;
    p->n[N_DISTANCE] += v * h;
    p->t[S_NOW] = time_us;
}

static void clear(Pass *p)
{
    p->n[N_SPEED] = p->n[N_FORCE] = p->n[N_ENERGY_FB] = 0.0;
    p->n[N_UNPRESSED] = 0.0;
    for (int c = 0; c < p->corners; c++)
        p->energy_ff[c] = p->pressure_sum[c] = p->on_time[c] =
            p->observer.brake_sum[c] = 0.0;
    for (int i = SUM_TIME; i <= SUM_DRAG; i++) p->observer.n[i] = 0.0;
}

static int missing(const Pass *p)
{
    int flags = 0, speed = bstm_valid(p, p->role[R_SPEED]);
    for (int c = 0; c < p->corners && !speed; c++)
        speed = bstm_valid(p, p->corner[c * PER_CORNER_INTS + C_WHEEL]);
    if (!speed) flags |= FLAG_SPEED;
    for (int c = 0; c < p->corners; c++)
        if (!bstm_corner_known(p, c))
            flags |= FLAG_PRESSURE | FLAG_CORNER_PRESSURE << c;
    if (!bstm_valid(p, p->role[R_ACCELERATION])) flags |= FLAG_ACCELERATION;
    if (!bstm_valid(p, p->role[R_TORQUE])) flags |= FLAG_TORQUE;
    if (!bstm_valid(p, p->role[R_AMBIENT])) flags |= FLAG_AMBIENT;
    return flags;
}

static void newest(const Pass *p, int role, int64_t *stamp)
{
    if (role >= 0 && p->stamp[role] > *stamp) *stamp = p->stamp[role];
}

/* Age [s] of the mandatory input that is silent longest; nan before it. */
static double input_age_s(const Pass *p)
{
    int64_t speed = NEVER, pressure = NEVER;
    newest(p, p->role[R_SPEED], &speed);
    newest(p, p->role[R_PRIMARY], &pressure);
    newest(p, p->role[R_SECONDARY], &pressure);
    for (int c = 0; c < p->corners; c++) {
        const int32_t *corner = p->corner + c * PER_CORNER_INTS;
        newest(p, corner[C_WHEEL], &speed);
        newest(p, corner[C_PRESSURE], &pressure);
    }
    const int64_t oldest =
        p->ints[I_PRESSURE] && pressure < speed ? pressure : speed;
    if (oldest == NEVER) return (double)NAN;
    return (double)(p->t[S_NOW] - oldest) * 1e-6;
}

/* How each corner's power is known, and whether it may have some. */
static void heat_answers(const Pass *p, int *answer, int *at_risk)
{
    const int torque = bstm_valid(p, p->role[R_TORQUE]);
    const int acceleration = p->role[R_ACCELERATION];
    const int feed_back =
        p->speed_known && (torque || p->ints[I_ASSUMED] != 0);
    const int complete = p->speed_known && (torque || p->role[R_TORQUE] < 0)
        && (p->ints[I_SLOPE] != 0 || acceleration < 0
            || bstm_valid(p, acceleration));
    for (int c = 0; c < p->corners; c++) {
        const int pressure = bstm_corner_known(p, c);
        const int feed_forward = p->speed_known && pressure;
        int own, other;
        if (p->ints[I_MODE] == MODE_FB) {
            own = complete || (feed_back && !feed_forward);
            other = feed_forward;
        } else {
            const int disc = p->corner[c * PER_CORNER_INTS + C_MEASURED];
            own = feed_forward
                || (p->ints[I_MODE] == MODE_MEASURED && bstm_valid(p, disc));
            other = feed_back;
        }
        answer[c] = own ? OWN : other ? OTHER : NONE;
        if (p->speed_known) at_risk[c] = p->speed > STANDING_MS;
        else if (pressure) at_risk[c] = p->target[c] > p->f[F_ON_PRESSURE];
        else at_risk[c] = bstm_last_speed(&p->checks) > PARKING_MS;
    }
}

static double reading(const Pass *p, int role)
{
    return bstm_valid(p, role) ? p->value[role] : (double)NAN;
}

/* What the checks need of the step that ends now. */
static void read_all(const Pass *p, Readings *now, const int *answer)
{
    const int k = p->corners;
    now->now = p->t[S_NOW];
    now->dt_s = (double)(int64_t)p->f[F_STEP] * 1e-6;
    now->speed = p->speed;
    now->speed_known = p->speed_known;
    now->brake_switch = bstm_vehicle(p, R_SWITCH, (double)NAN);
    now->esc_active = bstm_vehicle(p, R_ESC, 0.0);
    now->acceleration = p->heading * bstm_vehicle(p, R_ACCELERATION, (double)NAN);
    now->braking = now->brake_switch > 0.0;
    now->voice[k] = fabs(reading(p, p->role[R_SPEED]));
    now->pressure[0] = reading(p, p->role[R_PRIMARY]);
    now->pressure[1] = reading(p, p->role[R_SECONDARY]);
    for (int c = 0; c < k; c++) {
        const int32_t *corner = p->corner + c * PER_CORNER_INTS;
        if (p->target[c] > p->f[F_ON_PRESSURE]) now->braking = 1;
        now->voice[c] = fabs(reading(p, corner[C_WHEEL]));
        now->pressure[2 + c] = reading(p, corner[C_PRESSURE]);
        now->source[c] = 0;
        if (bstm_valid(p, corner[C_PRESSURE])) now->source[c] = 2 + c;
        else if (corner[C_SECONDARY] && bstm_valid(p, p->role[R_SECONDARY]))
            now->source[c] = 1;
        now->heat_known[c] = answer[c] != NONE;
    }
}

static void close_step(Pass *p)
{
    int answer[MAX_CORNERS];
    Readings now;
    heat_answers(p, answer, now.at_risk);
    read_all(p, &now, answer);
    int64_t flags = *p->flags | missing(p);
    flags |= bstm_checks_close(&p->checks, &now);
    const double dt_s = (double)(int64_t)p->f[F_STEP] * 1e-6;
    /* the air of a silent car is still nearer the last one than the default */
    const int air = p->role[R_AMBIENT];
    const double ambient = air >= 0 && p->stamp[air] != NEVER
        ? p->value[air] : p->f[F_AMBIENT];
    double wetness = bstm_vehicle(p, R_RAIN, 0.0);
    if (wetness < 0.0) wetness = 0.0;
    if (wetness > 1.0) wetness = 1.0;
    const double counted = p->n[N_ENERGY_FB], more = p->n[N_UNPRESSED];
    const double unpressed = more > 0.0 ? more : 0.0;
    const double energy = (counted > 0.0 ? counted : 0.0) + unpressed;
    const double power_fb = energy / dt_s;
    const double speed = p->n[N_SPEED] / dt_s;
    p->n[N_TOTAL_FB] += energy;
    double fused[MAX_CORNERS], spread[MAX_CORNERS];
    double *whole = p->vehicle_rows + p->steps * VEHICLE_CHANNELS;
    const int fuses = p->ints[I_MODE] == MODE_FUSED;
    if (fuses)
        flags |= bstm_fusion_close(p, &now, flags, fused, spread, whole + 4);
    else
        for (int i = 4; i < VEHICLE_CHANNELS; i++) whole[i] = (double)NAN;
    double *row = p->rows + p->steps * p->corners * CHANNELS;
    for (int c = 0; c < p->corners; c++, row += CHANNELS) {
        const double power_ff = p->energy_ff[c] / dt_s;
        const double share = p->corner_f[c * PER_CORNER_FLOATS + T_SHARE];
        p->total_ff[c] += p->energy_ff[c];
        row[0] = speed;
        row[1] = p->pressure_sum[c] / dt_s;
        row[2] = p->on_time[c] / dt_s;
        row[3] = wetness;
        row[4] = ambient;
        if (fuses) row[5] = fused[c];
        else row[5] = (p->ints[I_MODE] == MODE_FB) == (answer[c] != OTHER)
            ? share * power_fb : power_ff + share * (unpressed / dt_s);
        if (answer[c] == OTHER && now.at_risk[c]) flags |= FLAG_SUBSTITUTED;
        row[6] = p->total_ff[c];
        row[7] = share * p->n[N_TOTAL_FB];
        row[8] = fuses ? spread[c] : (double)NAN;
        const int32_t *measured =
            p->corner + c * PER_CORNER_INTS + C_MEASURED;
        for (int i = 0; i < MEASURED; i++)
            row[FIRST_MEASURED + i] =
                bstm_valid(p, measured[i]) ? p->value[measured[i]] : (double)NAN;
    }
    whole[0] = speed;
    whole[1] = p->n[N_DISTANCE];
    whole[2] = (p->n[N_FORCE] > 0.0 ? p->n[N_FORCE] : 0.0) / dt_s;
    whole[3] = input_age_s(p);
    whole[VEHICLE_CHANNELS - 1] = (double)flags;
    p->row_times[p->steps] = p->t[S_GRID];
    p->steps++;
    *p->flags = 0;
    p->t[S_GRID] += (int64_t)p->f[F_STEP];
    clear(p);
    for (int c = 0; c < p->corners; c++) p->interface_k[c] = p->told_k[c];
    p->stale = 1;
}

static void start_axis(Pass *p, int64_t time_us)
{
    const int64_t step = (int64_t)p->f[F_STEP];
    int64_t whole = time_us / step;
    if (time_us % step < 0) whole--;
    p->t[S_NOW] = time_us;
    p->t[S_GRID] = (whole + 1) * step;
    clear(p);
    p->stale = 1;
}

static int march_to(Pass *p, int64_t time_us)
{
    while (p->t[S_GRID] <= time_us) {
        if (p->steps == p->room) return FULL;
        integrate(p, p->t[S_GRID]);
        close_step(p);
    }
    integrate(p, time_us);
    p->t[S_PENDING] = NEVER;
    return DONE;
}

static int move_to(Pass *p, int64_t time_us)
{
    int64_t *t = p->t;
    if (time_us > LIMIT_US || time_us < -LIMIT_US) {
        t[S_DROPPED]++;
        return DROP;
    }
    if (t[S_NOW] == NEVER) {
        start_axis(p, time_us);
        return DONE;
    }
    const int64_t ahead = time_us - t[S_NOW];
    if (ahead >= -LATE_US && ahead <= AHEAD_US) {
        if (ahead < 0) {
            t[S_LATE]++;
            return DONE;
        }
        return march_to(p, time_us);
    }
    const int64_t apart = t[S_PENDING] == NEVER ? 0 : time_us - t[S_PENDING];
    if (t[S_PENDING] == NEVER || apart == 0 || apart > CONFIRM_US
        || apart < -CONFIRM_US) {
        t[S_PENDING] = time_us;
        t[S_DROPPED]++;
        return DROP;
    }
    if (ahead > 0 && ahead <= SETTLED_US) return march_to(p, time_us);
    t[S_PENDING] = NEVER;
    t[S_JUMPS]++;
    const int settled = ahead > 0 && ahead <= CLOCK_SET_US;
    *p->flags |= settled ? FLAG_SETTLED : FLAG_JUMP;
    if (settled) bstm_checks_settle(&p->checks);
    else {
        bstm_checks_shift(&p->checks, ahead);
        for (int r = 0; r < p->roles; r++)
            if (p->stamp[r] != NEVER) p->stamp[r] += ahead;
    }
    start_axis(p, time_us);
    return settled ? SETTLE : JUMP;
}

/* Of a late sample nobody knows how fast it came from the one before. */
static void take(Pass *p, int64_t time_us, int role, double value)
{
    const int64_t now = p->t[S_NOW], at = time_us > now ? time_us : now;
    const int64_t since =
        at == time_us && bstm_valid(p, role) ? p->stamp[role] : NEVER;
    if (bstm_checks_admit(&p->checks, at, role, value, p->value[role],
                          since)) {
        p->value[role] = value;
        p->stamp[role] = at;
    }
}

ptrdiff_t bstm_consume(Pass *p, const int64_t *times, const int32_t *roles,
                       const double *values, ptrdiff_t index, ptrdiff_t count,
                       int *code)
{
    for (; index < count; index++) {
        *code = move_to(p, times[index]);
        if (*code == FULL) return index;
        const int role = roles[index];
        if (*code != DROP && role >= 0 && role < p->roles
            && isfinite(values[index]))
            take(p, times[index], role, values[index]);
        p->stale = 1;
        if (*code == SETTLE || *code == JUMP) return index + 1;
    }
    *code = DONE;
    return index;
}
