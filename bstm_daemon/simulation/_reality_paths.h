/* Materials and heat paths of a brake corner: the maths of materials.py,
 * lanes.py and network.py. Part of _reality.c. */
#ifndef BSTM_REALITY_PATHS_H
#define BSTM_REALITY_PATHS_H
#include <math.h>
#include <stdint.h>
#include <string.h>

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

#define MAX_NODES 128
#define SIDES 2
#define PORTS 3

enum { CENTRE, HAT, HUB, PISTON, FLUID, BODY, FINGER, BRACKET, AIR, LUMPS };
/* inputs of a step, the order of the rows */
enum { SPEED, POWER, PRESSURE, CONTACT, AMBIENT, WETNESS, PUMPING, INPUTS };

static const double SIGMA = 5.670374419e-8;

/* compiled.py has the same layout of both */
typedef struct {
    Parameters p;
    double cheek_kg[MAX_NODES], gap_m[MAX_NODES];
    double centre_kg, backplate_j_k, lump_j_k[LUMPS];
    int32_t pads, cheeks, nodes, surface;
} Corner;

typedef struct {
    double t[SIDES][MAX_NODES], lump_t[LUMPS];
    double e[SIDES][MAX_NODES], lump_e[LUMPS];
    double pad_m[SIDES], charred[SIDES][MAX_NODES], friction_j;
} State;

typedef struct {
    double link[SIDES][MAX_NODES], source[SIDES][MAX_NODES];
    double capacity[SIDES][MAX_NODES], lump_capacity[LUMPS];
    double coupling[SIDES * PORTS][LUMPS];
    double between[LUMPS][LUMPS];
    double surface_out[SIDES], lump_out[LUMPS];
    double heat_in, body_gain;
} Paths;

/* -- a corner ----------------------------------------------------------- */

static const double BOILING_K = 410.15, BOILING_WIDTH_K = 7.0,
                    BOILING_J = 8.0e3;

static double pad_weight(const Corner *c, int i)
{
    double w = 1.0 / (c->pads - 1);
    return i == 0 || i == c->pads - 1 ? w / 2 : w;
}

static double pad_kg(const Corner *c, const State *s, int side, int i)
{
    return pad_weight(c, i)
           * (c->p.pad_density_kg_m3 * c->p.pad_area_m2 * s->pad_m[side]);
}

static void capacities(const Corner *c, const State *s, Paths *h)
{
    const Parameters *p = &c->p;
    for (int side = 0; side < SIDES; side++) {
        h->capacity[side][0] = c->backplate_j_k;
        for (int i = 0; i < c->pads; i++)
            h->capacity[side][1 + i] = pad_kg(c, s, side, i)
                                       * lining_cp(p, s->t[side][1 + i]);
        for (int i = 0; i < c->cheeks; i++)
            h->capacity[side][c->surface + i] =
                c->cheek_kg[i]
                * iron_cp(p, s->t[side][c->surface + i]);
    }
    memcpy(h->lump_capacity, c->lump_j_k, sizeof h->lump_capacity);
    h->lump_capacity[CENTRE] =
        c->centre_kg * iron_cp(p, s->lump_t[CENTRE]);
    if (p->fluid_latent_heat != 0.0) {
        double x = tanh((s->lump_t[FLUID] - BOILING_K) / BOILING_WIDTH_K);
        h->lump_capacity[FLUID] += p->fluid_latent_heat
                                   * (BOILING_J / (2 * BOILING_WIDTH_K))
                                   * (1.0 - x * x);
    }
}

/* temperatures of s from its energies; its temperatures start the search */
static void settle(const Corner *c, State *s)
{
    const Parameters *p = &c->p;
    for (int side = 0; side < SIDES; side++) {
        double *t = s->t[side], *e = s->e[side];
        t[0] = ZERO_K + e[0] / c->backplate_j_k;
        for (int i = 0; i < c->pads; i++)
            t[1 + i] = lining_t(p, e[1 + i] / pad_kg(c, s, side, i),
                                t[1 + i]);
        for (int i = 0; i < c->cheeks; i++)
            t[c->surface + i] =
                iron_t(p, e[c->surface + i] / c->cheek_kg[i],
                       t[c->surface + i]);
    }
    double fluid = s->lump_t[FLUID];
    for (int i = HAT; i < LUMPS; i++)
        s->lump_t[i] = ZERO_K + s->lump_e[i] / c->lump_j_k[i];
    s->lump_t[CENTRE] = iron_t(p, s->lump_e[CENTRE] / c->centre_kg,
                               s->lump_t[CENTRE]);
    if (p->fluid_latent_heat != 0.0) {
        double latent = p->fluid_latent_heat * (BOILING_J / 2);
        double sensible = c->lump_j_k[FLUID];
        for (int i = 0; i < 4; i++) {
            double x = tanh((fluid - BOILING_K) / BOILING_WIDTH_K);
            double stored = sensible * (fluid - ZERO_K) + latent * (1 + x);
            double slope = sensible + latent / BOILING_WIDTH_K * (1 - x * x);
            fluid += (s->lump_e[FLUID] - stored) / slope;
        }
        s->lump_t[FLUID] = fluid;
    }
}

/* -- heat paths --------------------------------------------------------- */

static double radiation(double a, double b, double exchange_m2)
{
    return SIGMA * exchange_m2 * (a * a + b * b) * (a + b);
}

static double mixed(double natural, double forced)
{
    return cbrt(natural * natural * natural + forced * forced * forced);
}

static void join(double m[LUMPS][LUMPS], int a, int b, double conductance)
{
    m[a][b] -= conductance;
    m[b][a] -= conductance;
    m[a][a] += conductance;
    m[b][b] += conductance;
}

static void chain_links(const Corner *c, const State *s, const double *in,
                        Paths *h)
{
    const Parameters *p = &c->p;
    double grey = 1.0 / (1.0 / p->face_emissivity + 1.0 / p->pad_emissivity
                         - 1.0);
    double contact = 0.0;
    if (p->contact_conductance != 0.0)
        contact = p->contact_conductance * in[CONTACT] * p->pad_area_m2
                  * 360.0 * in[PRESSURE] / (in[PRESSURE] + 2.0e6);
    for (int side = 0; side < SIDES; side++) {
        const double *t = s->t[side];
        double *link = h->link[side];
        double column = p->pad_area_m2 / (s->pad_m[side] / (c->pads - 1));
        link[0] = p->backplate_area_m2
                  / (p->backplate_thickness_m / (2 * 48.0));
        for (int i = 1; i < c->pads; i++)
            link[i] = lining_k(p, (t[i] + t[i + 1]) / 2) * column;
        for (int i = 0; i + 1 < c->cheeks; i++) {
            int j = c->surface + i;
            link[j] = iron_k((t[j] + t[j + 1]) / 2)
                      * (p->face_area_m2 / c->gap_m[i]);
        }
        double front = t[c->surface - 1], surface = t[c->surface];
        double across = radiation(front, surface, grey * p->pad_area_m2);
        if (p->gap_conduction != 0.0)
            across += p->gap_conduction * (1.0 - in[CONTACT])
                      * p->pad_area_m2 * air_k((front + surface) / 2)
                      / 3.0e-4;
        link[c->surface - 1] = across + contact;
    }
}

/* torque of a pad that drags, of a cold caliper and of a hot one */
static const double DRAG_COLD_NM = 1.5, DRAG_HOT_NM = 3.5, DRAG_K = 80.0;

static void sources(const Corner *c, const State *s, const double *in,
                    Paths *h)
{
    const Parameters *p = &c->p;
    int surface = c->surface, front = surface - 1;
    memset(h->source, 0, sizeof h->source);
    double warm = fmax((s->t[0][0] + s->t[1][0]) / 2 - ZERO_K, 0.0);
    double drag_nm = DRAG_COLD_NM - DRAG_HOT_NM * expm1(-warm / DRAG_K);
    h->heat_in = in[POWER]
                 + (1.0 - in[CONTACT]) * p->residual_drag * drag_nm
                       * in[SPEED] / p->wheel_radius_m;
    for (int side = 0; side < SIDES; side++) {
        double tf = s->t[side][front], ts = s->t[side][surface];
        double pad = p->pad_area_m2
                     * sqrt(lining_k(p, tf) * p->pad_density_kg_m3
                            * lining_cp(p, tf));
        double ring = p->face_area_m2
                      * sqrt(iron_k(ts) * p->iron_density_kg_m3
                             * iron_cp(p, ts));
        double to_pad = pad / (pad + ring);
        double heat = h->heat_in * (side ? 1.0 - p->piston_side_share
                                         : p->piston_side_share);
        h->source[side][front] = to_pad * heat;
        h->source[side][surface] = (1.0 - to_pad) * heat;
        if (p->wet_disc != 0.0 && in[WETNESS] != 0.0) {
            double spray = 5.0e-5 + 1.2e-5 * in[SPEED];
            double above = fmax(ts - in[AMBIENT], 0.0);
            h->source[side][surface] -= p->wet_disc * in[WETNESS] * spray
                                        * 2.4e6 * -expm1(-above / 70.0) / 2;
        }
    }
}

/* what is in no catalogue of effects */
static void unheard_paths(const Corner *c, const State *s, double v,
                          double v08, Paths *h)
{
    const Parameters *p = &c->p;
    if (p->dust_shield != 0.0) {
        double face = s->t[0][c->surface], body = s->lump_t[BODY];
        double near = radiation(face, body, 0.27 * 0.03)
                      + 0.03 * (4.0 + 2.0 * v08);
        double away = 0.06 * (5.0 + 3.0 * v08), lug = 0.32;
        double share = p->dust_shield / (near + lug + away);
        h->coupling[1][BODY] += share * near * lug;
        h->coupling[1][AIR] += share * near * away;
        join(h->between, BODY, AIR, share * lug * away);
    }
    h->body_gain = p->damper_heat * 1.5 * v;
}

static void drawn_path(const Corner *c, const State *s, const double *in,
                       const DrawnPath *d, Paths *h)
{
    const int ports[PORTS] = {0, c->surface, c->nodes - 1};
    int start = (int)d->start, end = (int)d->end;
    int sides = start < PORTS ? SIDES : 1;
    double base = d->conductance * pow(in[SPEED] / 20.0, d->speed_exponent);
    if (d->band_ms != 0.0) {
        double x = (in[SPEED] - d->band_ms) / d->band_width_ms;
        base *= exp(-x * x);
    }
    if (d->contact != 0.0)
        base *= d->contact > 0.0 ? in[CONTACT] : 1.0 - in[CONTACT];
    for (int side = 0; side < sides; side++) {
        double t = start < PORTS ? s->t[side][ports[start]]
                                 : s->lump_t[start - PORTS];
        double across = base * pow(t / 500.0, d->heat_exponent) / sides;
        if (d->onset_k != 0.0)
            across *= 0.5 * (1.0 + tanh((t - d->onset_k)
                                        / (2.0 * d->width_k)));
        if (start < PORTS)
            h->coupling[PORTS * side + start][end] += across;
        else if (end < LUMPS)
            join(h->between, start - PORTS, end, across);
        else
            h->lump_out[start - PORTS] += across;
    }
}

static void find_paths(const Corner *c, const State *s, const double *in,
                       Paths *h)
{
    const Parameters *p = &c->p;
    double v = in[SPEED], ambient = in[AMBIENT];
    double v08 = pow(v, 0.8);
    int surface = c->surface, last = c->nodes - 1;
    chain_links(c, s, in, h);
    sources(c, s, in, h);
    capacities(c, s, h);

    double steeper = 0.45 * p->convection_exponent * (v - 10.0) / (v + 20.0);
    double forced = pow(v, p->forced_exponent) * fmax(1.0 + steeper, 0.2);
    double natural[SIDES], faces[SIDES];
    for (int side = 0; side < SIDES; side++) {
        double excess = fabs(s->t[side][surface] - s->lump_t[AIR]);
        natural[side] = p->natural_convection_w_m2k
                        * sqrt(sqrt(fmax(excess, 1.0) / 200.0));
        faces[side] = p->face_air_area_m2
                      * mixed(natural[side], p->forced_face_w_m2k * forced);
    }
    double vent = p->vent_area_m2
                  * mixed(p->parked_vent_fraction
                              * ((natural[0] + natural[1]) / 2),
                          p->forced_vent_w_m2k * forced);

    memset(h->coupling, 0, sizeof h->coupling);
    double loose = 0.35 * p->shim_contact * exp(-in[PRESSURE] / 2.0e5);
    double shim = p->pad_area_m2 / p->shim_resistance_m2k_w
                  * fmax(1.0 - loose, 0.05);
    double to_vanes = c->gap_m[c->cheeks - 1] / p->face_area_m2
                      + 0.004 / p->vent_bridge_area_m2;
    for (int side = 0; side < SIDES; side++) {
        int behind = side ? FINGER : PISTON, bypass = side ? FINGER : BODY;
        double *back = h->coupling[PORTS * side];
        double *face = h->coupling[PORTS * side + 1];
        double t_back = s->t[side][0];
        double above = fmax(fabs(t_back - s->lump_t[AIR]), 1.0);
        back[behind] = shim;
        back[bypass] += 0.25 * p->caliper_bypass * t_back / 400.0;
        back[BRACKET] = p->bracket_conduction * (0.18 + 0.14 * in[CONTACT]);
        back[AIR] = p->hammerhead_forced_w_k * v08
                    + 0.12 * p->backplate_loss * sqrt(sqrt(above / 100.0));
        face[AIR] = faces[side];
        face[bypass] = radiation(
            s->t[side][surface], s->lump_t[bypass],
            p->face_emissivity * 0.0015 * p->disc_caliper_radiation);
        h->coupling[PORTS * side + 2][CENTRE] =
            iron_k(s->t[side][last]) / to_vanes;
    }

    double split = p->caliper_fluid_split;
    double caliper = mixed(p->caliper_natural_w_k,
                           p->caliper_forced_w_k * pow(v, 0.7));
    memset(h->between, 0, sizeof h->between);
    join(h->between, CENTRE, AIR, vent);
    join(h->between, CENTRE, HAT, 5.0 * p->disc_hat);
    join(h->between, CENTRE, HUB, 1.0 * p->hub_conduction);
    join(h->between, HAT, AIR, 0.05 * vent / p->vent_area_m2);
    join(h->between, PISTON, FLUID, 1.0 / (1.0 / 80.0 + split / 6.0));
    join(h->between, FLUID, BODY, 1.0 / (1.0 / 80.0 + split / 20.0));
    join(h->between, BODY, FINGER, 1.0 / (1.0 / 80.0 + split / 2.5));
    join(h->between, BODY, AIR, 0.6 * caliper);
    join(h->between, FINGER, AIR, 0.4 * caliper);

    double slow = v / 2.2;
    double rest = 1.0 / (1.0 + slow * slow * slow * slow);
    double radiates = rest
                      + (1.0 - rest) * fmin(p->disc_radiation_driving, 1.0);
    for (int side = 0; side < SIDES; side++)
        h->surface_out[side] =
            radiation(s->t[side][surface], ambient,
                      p->face_emissivity * p->face_air_area_m2 * radiates);
    double *out = h->lump_out;
    memset(out, 0, sizeof h->lump_out);
    out[CENTRE] = radiation(
        s->lump_t[CENTRE], ambient,
        p->vent_emissivity * p->vent_opening_area_m2 * radiates);
    out[AIR] = 1.0 / (1.0 / 1e5 + p->local_air / (12.0 + 25.0 * v));
    out[HUB] = 1.2 + 0.1 * v08;
    out[BRACKET] = 1.0 + 0.12 * v08;
    out[BODY] = radiation(s->lump_t[BODY], ambient,
                          0.9 * 0.030 * p->caliper_radiation);
    out[FINGER] = radiation(s->lump_t[FINGER], ambient,
                            0.9 * 0.020 * p->caliper_radiation);
    out[FLUID] = p->fluid_exchange
                 * (0.05 + 1.5 * in[PUMPING] / (in[PUMPING] + 3.0e6));
    unheard_paths(c, s, v, v08, h);
    for (int i = 0; i < DRAWN; i++)
        if (p->drawn[i].conductance != 0.0)
            drawn_path(c, s, in, &p->drawn[i], h);
}

#endif
