#include "inputs.h"

#include "motion_checks.h"

void inputs_init(Inputs *p, SampleMemoryInts *times,
                 SampleMemoryFloats *numbers)
{
    const int corners = p->corners = (int)p->options->corners;
    p->t = &times->samples;
    p->m = &numbers->samples;
    Checks *c = &p->checks;
    *c = (Checks){
        .plan = p->plan, .options = p->options,
        .t = &times->checks, .m = &numbers->checks,
        .corners = corners,
        .acceleration_role = ROLE_ACCELERATION_LONGITUDINAL,
        .torque_role = ROLE_POWERTRAIN_TORQUE,
    };
    c->speed_role[corners] = ROLE_VEHICLE_SPEED;
    c->pressure_role[0] = ROLE_PRIMARY_PRESSURE;
    c->pressure_role[1] = ROLE_SECONDARY_PRESSURE;
    c->temperature_role[c->temperatures++] = ROLE_AMBIENT_TEMPERATURE;
    for (int i = 0; i < corners; i++) {
        const int place = (int)p->options->place[i];
        p->wheel_role[i] = ROLE_WHEEL_SPEED_FL + place;
        p->pressure_role[i] = ROLE_WHEEL_PRESSURE_FL + place;
        p->measured_role[i] = ROLE_TEMP_FL_DISC + place * MEASURED_COUNT;
        c->speed_role[i] = p->wheel_role[i];
        c->pressure_role[2 + i] = p->pressure_role[i];
        for (int node = 0; node < MEASURED_COUNT; node++)
            c->temperature_role[c->temperatures++] =
                p->measured_role[i] + node;
    }
    p->observer = (Observer){
        .mass_kg = p->plan->mass_kg,
        .rotating = p->plan->rotating_kg / p->plan->mass_kg,
        .rolling = p->plan->constant / p->plan->mass_kg,
        .m = &numbers->observer,
    };
    p->stale = 1;
    p->pressing_pa = p->plan->on_pressure_pa;
    p->heading = 1.0;
}

/* Which wheels, and whether the vehicle speed, are used: those that the others
 * contradict are not, unless none is left. */
static int believed(const Inputs *p, int *counts, int vehicle)
{
    const double *left_out = p->checks.m->left_out;
    int some = vehicle && left_out[p->corners] == 0.0;
    for (int c = 0; c < p->corners && !some; c++)
        some = counts[c] && left_out[c] == 0.0;
    if (!some) return vehicle;
    for (int c = 0; c < p->corners; c++)
        if (left_out[c] != 0.0) counts[c] = 0;
    return vehicle && left_out[p->corners] == 0.0;
}

static double rear_pressure(const Inputs *p, double front)
{
    const double *x = p->table_front, *y = p->table_rear;
    const int64_t last = p->options->points - 1;
    if (front <= x[0]) return y[0];
    if (front >= x[last]) return y[last];
    int i = 0;
    while (front >= x[i + 1]) i++;
    return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i]);
}

static void refresh_pressures(Inputs *p)
{
    const double *value = p->m->value;
    const ObserverMemory *o = p->observer.m;
    const int by_secondary = inputs_valid(p, ROLE_SECONDARY_PRESSURE);
    const double axle =
        inputs_vehicle(p, ROLE_PRIMARY_PRESSURE, o->tare_primary)
        - o->tare_primary;
    const double other = value[ROLE_SECONDARY_PRESSURE] - o->tare_secondary;
    p->pressure_present = 0;
    for (int c = 0; c < p->corners; c++) {
        if (inputs_corner_known(p, c)) p->pressure_present = 1;
        double pressure =
            p->options->secondary[c] && by_secondary ? other : axle;
        if (inputs_valid(p, p->pressure_role[c]))
            pressure = value[p->pressure_role[c]];
        else if (p->options->place[c] >= 2 && p->options->points)
            pressure = rear_pressure(p, pressure);
        p->target[c] = pressure > 0.0 ? pressure : 0.0;
    }
}

/* Mean speed of the faster axle, and of the slower one, of the wheels that
 * count; UNKNOWN where an axle has none. */
static double axles(const Inputs *p, const int *counts, double *slow)
{
    double total[2] = {0.0, 0.0};
    int count[2] = {0, 0};
    for (int c = 0; c < p->corners; c++) {
        if (!counts[c]) continue;
        const int axle = p->options->place[c] >= 2;
        total[axle] += fabs(p->m->value[p->wheel_role[c]]);
        count[axle]++;
    }
    if (count[0] == 0 || count[1] == 0) return *slow = UNKNOWN;
    const double front = total[0] / (double)count[0];
    const double rear = total[1] / (double)count[1];
    *slow = front < rear ? front : rear;
    return front < rear ? rear : front;
}

/* Whether any system slows or spins single wheels. */
static int intervenes(const Inputs *p)
{
    return inputs_vehicle(p, ROLE_ABS_ACTIVE, 0.0) > 0.0
        || inputs_vehicle(p, ROLE_ESC_ACTIVE, 0.0) > 0.0
        || inputs_vehicle(p, ROLE_TC_ACTIVE, 0.0) > 0.0;
}

/* Set what the brakes of each axle read, and the two circuits; where left and
 * right contradict each other, nobody knows which is right, and both brake by
 * the higher. */
static void refresh_twins(Inputs *p)
{
    const ObserverMemory *o = p->observer.m;
    double one = p->m->value[ROLE_PRIMARY_PRESSURE] - o->tare_primary;
    double two = p->m->value[ROLE_SECONDARY_PRESSURE] - o->tare_secondary;
    if (!(one > 0.0)) one = 0.0;
    if (!(two > 0.0)) two = 0.0;
    const int compared = p->options->mode == MODE_FUSED
        && inputs_valid(p, ROLE_PRIMARY_PRESSURE)
        && inputs_valid(p, ROLE_SECONDARY_PRESSURE);
    p->twin_low[2] = !compared ? NAN : one < two ? one : two;
    p->twin_high[2] = !compared ? NAN : one > two ? one : two;
    for (int axle = 0; axle < 2; axle++) {
        double low = NAN, high = NAN;
        int count = 0;
        for (int c = 0; c < p->corners; c++) {
            if (p->options->place[c] / 2 != axle || !inputs_corner_known(p, c))
                continue;
            if (count == 0 || p->target[c] < low) low = p->target[c];
            if (count == 0 || p->target[c] > high) high = p->target[c];
            count++;
        }
        p->twin_low[axle] = count == 2 ? low : NAN;
        p->twin_high[axle] = count == 2 ? high : NAN;
        if (count < 2 || p->checks.m->twin_fault_s[axle] < TWIN.comes_s
            || intervenes(p))
            continue;
        for (int c = 0; c < p->corners; c++)
            if (p->options->place[c] / 2 == axle) p->target[c] = high;
    }
}

/* What shows braking where no pressure does. */
static int pedal(const Inputs *p)
{
    const int roles[] = {ROLE_BRAKE_SWITCH, ROLE_BRAKE_PEDAL_TRAVEL,
                         ROLE_BRAKE_TORQUE};
    const double least[] = {
        0.0, PEDAL_REST,
        TORQUE_REST * p->plan->on_force_n * p->plan->radius_m};
    int found = PEDAL_UNKNOWN;
    for (int i = 0; i < 3; i++) {
        if (!inputs_valid(p, roles[i])) continue;
        if (fabs(p->m->value[roles[i]]) > least[i]) return PEDAL_BRAKES;
        found = PEDAL_AT_REST;
    }
    /* the torque shows what an intervention brakes, the pedal does not */
    const int covered =
        inputs_valid(p, ROLE_BRAKE_TORQUE) && p->m->pedal_seen != 0.0;
    if (intervenes(p) && !covered) return PEDAL_UNKNOWN;
    return found;
}

/* The speed without the axle that the engine spins. */
static void refresh_ground_speed(Inputs *p, const int *counts)
{
    p->pedal = pedal(p);
    p->ground_speed = p->speed;
    p->spinning = 0;
    const double torque = inputs_vehicle(p, ROLE_POWERTRAIN_TORQUE, 0.0);
    const int drives = p->heading * torque > 0.0 && !intervenes(p);
    if (p->pressure_present || p->pedal == PEDAL_BRAKES || !drives) return;
    double slow;
    const double fast = axles(p, counts, &slow);
    /* an axle at rest may be two dead sensors */
    if (slow > STANDING_MS && fast > (1.0 + SLIP_FORWARD) * slow) {
        p->spinning = 1;
        p->ground_speed = p->speed < slow ? p->speed : slow;
    }
}

void inputs_refresh(Inputs *p)
{
    const double *value = p->m->value;
    double total = 0.0, along = 0.0;
    int count = 0, present[MAX_CORNERS], counts[MAX_CORNERS];
    const int vehicle = inputs_valid(p, ROLE_VEHICLE_SPEED);
    for (int c = 0; c < p->corners; c++)
        present[c] = counts[c] = inputs_valid(p, p->wheel_role[c]);
    const int by_vehicle = believed(p, counts, vehicle);
    for (int c = 0; c < p->corners; c++) {
        if (!counts[c]) continue;
        total += fabs(value[p->wheel_role[c]]);
        along += value[p->wheel_role[c]];
        count++;
    }
    if (by_vehicle) {
        along = value[ROLE_VEHICLE_SPEED];
        p->speed = fabs(along);
    } else p->speed = count ? total / (double)count : 0.0;
    p->heading = along < 0.0 ? -1.0 : 1.0;
    p->speed_known = count > 0 || vehicle;
    double slow;
    const double fast = axles(p, present, &slow);
    const int resting = 0.0 <= slow && slow < STANDING_MS;
    p->apart = resting && fast > STAND_TURNS_MS;
    p->on_stand = resting && motion_checks_stand_shown(p->checks.m);
    for (int c = 0; c < p->corners; c++) {
        const double turning = fabs(value[p->wheel_role[c]]);
        /* there a wheel at rest is no dead sensor */
        const int rests = turning < STANDING_MS && present[c];
        const int known = counts[c] || (p->on_stand && rests);
        p->wheel[c] = known ? turning : p->speed;
    }
    refresh_pressures(p);
    refresh_twins(p);
    refresh_ground_speed(p, counts);
    /* the foot is on the pedal: fusion counts the lightest pressure */
    p->pressing_pa = p->plan->on_pressure_pa;
    if (p->options->mode == MODE_FUSED && p->pressing_pa > LIGHT_PRESSURE_PA
        && inputs_vehicle(p, ROLE_BRAKE_SWITCH, 0.0) > 0.0)
        p->pressing_pa = LIGHT_PRESSURE_PA;
    p->stale = 0;
}

static void newest(const Inputs *p, int role, int64_t *stamp)
{
    if (inputs_mapped(p, role) && p->t->stamp[role] > *stamp)
        *stamp = p->t->stamp[role];
}

double inputs_input_age_s(const Inputs *p)
{
    int64_t speed = NEVER, pressure = NEVER;
    newest(p, ROLE_VEHICLE_SPEED, &speed);
    newest(p, ROLE_PRIMARY_PRESSURE, &pressure);
    newest(p, ROLE_SECONDARY_PRESSURE, &pressure);
    for (int c = 0; c < p->corners; c++) {
        newest(p, p->wheel_role[c], &speed);
        newest(p, p->pressure_role[c], &pressure);
    }
    const int64_t oldest =
        p->options->pressure_mapped && pressure < speed ? pressure : speed;
    if (oldest == NEVER) return (double)NAN;
    return (double)(p->t->now - oldest) * 1e-6;
}

int inputs_feed_back_known(const Inputs *p)
{
    return p->speed_known && (inputs_valid(p, ROLE_POWERTRAIN_TORQUE)
                              || p->options->torque_assumed);
}

void inputs_heat_sources(const Inputs *p, int *source, int *at_risk)
{
    const int64_t mode = p->options->mode;
    const int feed_back = inputs_feed_back_known(p);
    const int complete = p->speed_known
        && (inputs_valid(p, ROLE_POWERTRAIN_TORQUE)
            || !inputs_mapped(p, ROLE_POWERTRAIN_TORQUE))
        && (p->options->slope != SLOPE_ACCELEROMETER
            || !inputs_mapped(p, ROLE_ACCELERATION_LONGITUDINAL)
            || inputs_valid(p, ROLE_ACCELERATION_LONGITUDINAL));
    for (int c = 0; c < p->corners; c++) {
        const int pressure = inputs_corner_known(p, c);
        const int feed_forward = p->speed_known && pressure;
        int own, other;
        if (mode == MODE_FB) {
            own = complete || (feed_back && !feed_forward);
            other = feed_forward;
        } else {
            own = feed_forward || (mode == MODE_MEASURED
                                   && inputs_valid(p, p->measured_role[c]));
            other = feed_back;
        }
        source[c] = own ? OWN : other ? OTHER : NONE;
        if (p->speed_known) at_risk[c] = p->speed > STANDING_MS;
        else if (pressure)
            at_risk[c] = p->target[c] > p->plan->on_pressure_pa;
        else at_risk[c] = p->checks.m->last_speed > PARKING_MS;
    }
}

/* Whether no change of speed was compared with the accelerometer. A satellite
   speed is no substitute: it does not check the latter. */
static int unproven(const Inputs *p)
{
    if (!inputs_mapped(p, ROLE_ACCELERATION_LONGITUDINAL)) return 0;
    double pressed_j = 0.0;
    for (int c = 0; c < p->corners; c++) pressed_j += p->m->total_ff[c];
    const double braked_j = p->m->total_fb;
    return motion_checks_unproven(
        p->checks.m, pressed_j > braked_j ? pressed_j : braked_j);
}

int64_t inputs_input_flags(const Inputs *p)
{
    int64_t flags = 0;
    if (p->m->pedal_lost > PEDAL_LOST_MS && !p->pressure_present)
        flags |= FLAG_SWITCH_CONTRADICTS;
    if (p->on_stand)
        flags |= FLAG_SPEED_SUSPECT | FLAG_ACCELERATION_CONTRADICTS;
    int speed = inputs_valid(p, ROLE_VEHICLE_SPEED);
    for (int c = 0; c < p->corners && !speed; c++)
        speed = inputs_valid(p, p->wheel_role[c]);
    if (!speed) flags |= FLAG_SPEED_MISSING;
    for (int c = 0; c < p->corners; c++)
        if (!inputs_corner_known(p, c))
            flags |= FLAG_PRESSURE_MISSING | CORNER_PRESSURE << c;
    if (!inputs_valid(p, ROLE_ACCELERATION_LONGITUDINAL))
        flags |= FLAG_ACCELERATION_MISSING;
    if (!inputs_valid(p, ROLE_POWERTRAIN_TORQUE)) flags |= FLAG_TORQUE_MISSING;
    if (!inputs_valid(p, ROLE_AMBIENT_TEMPERATURE))
        flags |= FLAG_AMBIENT_MISSING;
    if (unproven(p)) flags |= FLAG_SPEED_UNPROVEN;
    return flags;
}

static double secured(const Inputs *p)
{
    const double brake = inputs_reading(p, ROLE_PARK_BRAKE);
    const double ignition = inputs_reading(p, ROLE_IGNITION);
    if (brake > 0.0 || ignition == 0.0) return 1.0;
    return isnan(brake) && isnan(ignition) ? (double)NAN : 0.0;
}

static int pressure_of(const Inputs *p, int c)
{
    if (inputs_valid(p, p->pressure_role[c])) return 2 + c;
    return p->options->secondary[c]
        && inputs_valid(p, ROLE_SECONDARY_PRESSURE);
}

void inputs_readings(const Inputs *p, double dt_s, const int *source,
                     Readings *now)
{
    const int corners = p->corners;
    now->now = p->t->now;
    now->dt_s = dt_s;
    now->speed = p->speed;
    now->speed_known = p->speed_known;
    now->brake_switch = inputs_reading(p, ROLE_BRAKE_SWITCH);
    now->esc_active = inputs_vehicle(p, ROLE_ESC_ACTIVE, 0.0);
    now->intervenes = intervenes(p);
    now->secured = secured(p);
    now->acceleration =
        p->heading * inputs_reading(p, ROLE_ACCELERATION_LONGITUDINAL);
    now->lateral = inputs_reading(p, ROLE_ACCELERATION_LATERAL);
    now->yaw_rate = inputs_reading(p, ROLE_YAW_RATE);
    now->ambient_k = inputs_reading(p, ROLE_AMBIENT_TEMPERATURE);
    now->braking = now->brake_switch > 0.0;
    now->speeds[corners] = fabs(inputs_reading(p, ROLE_VEHICLE_SPEED));
    now->pressures[0] = inputs_reading(p, ROLE_PRIMARY_PRESSURE);
    now->pressures[1] = inputs_reading(p, ROLE_SECONDARY_PRESSURE);
    for (int c = 0; c < corners; c++) {
        if (p->target[c] > p->plan->on_pressure_pa) now->braking = 1;
        now->speeds[c] = fabs(inputs_reading(p, p->wheel_role[c]));
        now->pressures[2 + c] = inputs_reading(p, p->pressure_role[c]);
        now->pressure_of[c] = pressure_of(p, c);
        now->heat_known[c] = source[c] != NONE;
    }
    for (int i = 0; i < TWINS; i++) {
        now->twin_low[i] = p->twin_low[i];
        now->twin_high[i] = p->twin_high[i];
    }
}
