/* Parameters and materials of a brake corner: the maths of materials.py. Part
 * of _reality.c. */
#ifndef BSTM_REALITY_MATERIALS_H
#define BSTM_REALITY_MATERIALS_H
#include <math.h>

/* rows of the parameter table: must be lanes.PARAMETER_NAMES */
#define PARAMETERS(X) \
    X(piston_area_m2) X(piston_count) X(efficiency) \
    X(friction_coefficient) X(effective_radius_m) X(piston_side_share) \
    X(ring_mass_kg) \
    X(face_area_m2) X(cheek_thickness_m) X(iron_density_kg_m3) \
    X(face_air_area_m2) X(vent_area_m2) X(vent_bridge_area_m2) \
    X(face_emissivity) X(vent_emissivity) X(vent_opening_area_m2) \
    X(natural_convection_w_m2k) X(parked_vent_fraction) \
    X(forced_face_w_m2k) X(forced_vent_w_m2k) X(forced_exponent) \
    X(pad_area_m2) X(pad_thickness_m) X(pad_density_kg_m3) \
    X(pad_heat_capacity_j_kgk) X(pad_conductivity_w_mk) \
    X(pad_emissivity) X(backplate_area_m2) X(backplate_thickness_m) \
    X(shim_resistance_m2k_w) X(hammerhead_forced_w_k) \
    X(piston_capacity_j_k) X(fluid_capacity_j_k) X(body_capacity_j_k) \
    X(finger_capacity_j_k) X(bracket_capacity_j_k) X(hat_capacity_j_k) \
    X(hub_capacity_j_k) X(air_capacity_j_k) X(caliper_natural_w_k) \
    X(caliper_forced_w_k) \
    X(iron_slope_j_kgk2) X(pad_capacity_slope_j_kgk2) \
    X(pad_conductivity_slope_1_k) X(wheel_radius_m) \
    X(friction_fade) X(friction_speed) X(friction_pressure) \
    X(friction_history) X(pushout_pressure) X(hydraulic_lag) \
    X(residual_drag) X(contact_conductance) X(gap_conduction) \
    X(disc_capacity_hot) X(disc_radiation_driving) X(convection_exponent) \
    X(local_air) X(hub_conduction) X(wet_disc) X(disc_wear) X(disc_hat) \
    X(pad_conductivity) X(pad_capacity) X(pad_pyrolysis) X(pad_wear) \
    X(backplate_loss) X(bracket_conduction) X(caliper_bypass) \
    X(shim_contact) X(disc_caliper_radiation) X(caliper_fluid_split) \
    X(caliper_radiation) X(fluid_exchange) X(fluid_latent_heat) \
    X(thermocouple_offset) X(thermocouple_lag) X(accelerometer_bias) \
    X(mass_error) X(brake_share) X(powertrain_torque_error) \
    X(ambient_heat_soak) \
    X(dust_shield) X(brake_duct) X(damper_heat)

/* parameters.DrawnPath */
typedef struct {
    double start, end, conductance, speed_exponent, heat_exponent, onset_k,
        width_k, band_ms, band_width_ms, contact;
} DrawnPath;
#define DRAWN 3

#define MEMBER(name) double name;
typedef struct { PARAMETERS(MEMBER) DrawnPath drawn[DRAWN]; } Parameters;

static const double ZERO_K = 293.15;

/* -- materials ---------------------------------------------------------- */

static const double A = 354.96, B = 535.518, C = -592.287, D = 511.852,
                    E = -1.20346;
static const double CURIE_K = 1030.0, CURIE_WIDTH_K = 42.0,
                    CURIE_PEAK = 480.0;
static const double RISE = 420.0, SCALE_K = 250.0;

static double iron_cp(const Parameters *p, double k)
{
    double t = k * 1e-3, bump = p->disc_capacity_hot;
    double cp = A + t * (B + t * (C + t * D)) + E / (t * t);
    if (bump != 0.0) {
        double x = tanh((k - CURIE_K) / CURIE_WIDTH_K);
        cp += bump * CURIE_PEAK * (1.0 - x * x);
    }
    return cp + p->iron_slope_j_kgk2 * (k - ZERO_K);
}

static double shomate(double k)
{
    double t = k * 1e-3;
    return 1e3 * (t * (A + t * (B / 2 + t * (C / 3 + t * (D / 4)))) - E / t);
}

static double iron_h(const Parameters *p, double k)
{
    double h = shomate(k) - shomate(ZERO_K), bump = p->disc_capacity_hot;
    if (bump != 0.0)
        h += bump * (CURIE_PEAK * CURIE_WIDTH_K)
             * (tanh((k - CURIE_K) / CURIE_WIDTH_K)
                - tanh((ZERO_K - CURIE_K) / CURIE_WIDTH_K));
    return h + 0.5 * p->iron_slope_j_kgk2 * (k - ZERO_K) * (k - ZERO_K);
}

static double iron_t(const Parameters *p, double h, double t)
{
    for (int i = 0; i < 2; i++)
        t += (h - iron_h(p, t)) / iron_cp(p, t);
    return t;
}

static double iron_k(double k)
{
    double c = fmin(fmax(k - 273.15, 0.0), 700.0);
    return 53.2454 + c * (-1.16611e-2 + c * (-6.89066e-5 + c * 6.74969e-8));
}

static double lining_k(const Parameters *p, double k)
{
    double tilt = p->pad_conductivity_slope_1_k * (k - ZERO_K), risen = 0.0;
    if (p->pad_conductivity != 0.0)
        risen = 0.25 * p->pad_conductivity * tanh((k - 500.0) / 150.0);
    return p->pad_conductivity_w_mk * (1.0 + risen + tilt);
}

static double lining_cp(const Parameters *p, double k)
{
    double dt = k - ZERO_K, risen = 0.0;
    if (p->pad_capacity != 0.0)
        risen = p->pad_capacity * RISE * -expm1(-dt / SCALE_K);
    return p->pad_heat_capacity_j_kgk + risen
           + p->pad_capacity_slope_j_kgk2 * dt;
}

static double lining_t(const Parameters *p, double h, double t)
{
    if (p->pad_capacity == 0.0 && p->pad_capacity_slope_j_kgk2 == 0.0)
        return ZERO_K + h / p->pad_heat_capacity_j_kgk;
    for (int i = 0; i < 2; i++) {
        double dt = t - ZERO_K;
        double now = p->pad_heat_capacity_j_kgk * dt
                     + p->pad_capacity * RISE
                           * (dt + SCALE_K * expm1(-dt / SCALE_K))
                     + 0.5 * p->pad_capacity_slope_j_kgk2 * dt * dt;
        t += (h - now) / lining_cp(p, t);
    }
    return t;
}

static double air_k(double k)
{
    return 2.64638e-3 * pow(k, 1.5) / (k + 245.4 * pow(10.0, -12.0 / k));
}

#endif
