/* Materials and heat paths of a brake corner: the maths of materials.py,
 * lanes.py and network.py. Part of _reality.c. */
#ifndef BSTM_REALITY_PATHS_H
#define BSTM_REALITY_PATHS_H
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "reality.h"

/* -- materials ---------------------------------------------------------- */

static double iron_cp(const Parameters *p, double k)
{
    double t = k * 1e-3, bump = p->disc_capacity_hot;
    const double *const a = SHOMATE;
    double cp = a[0] + t * (a[1] + t * (a[2] + t * a[3])) + a[4] / (t * t);
    if (bump != 0.0) {
        double x = tanh((k - CURIE_K) / CURIE_WIDTH_K);
        cp += bump * CURIE_PEAK_J_KGK * (1.0 - x * x);
    }
    return cp + p->iron_slope_j_kgk2 * (k - REFERENCE_K);
}

static double shomate(double k)
{
    const double *const a = SHOMATE;
    double t = k * 1e-3;
    return 1e3 * (t * (a[0] + t * (a[1] / 2 + t * (a[2] / 3 + t * (a[3] / 4))))
                  - a[4] / t);
}

static double iron_h(const Parameters *p, double k)
{
    double h = shomate(k) - shomate(REFERENCE_K), bump = p->disc_capacity_hot;
    if (bump != 0.0)
        h += bump * (CURIE_PEAK_J_KGK * CURIE_WIDTH_K)
             * (tanh((k - CURIE_K) / CURIE_WIDTH_K)
                - tanh((REFERENCE_K - CURIE_K) / CURIE_WIDTH_K));
    return h + 0.5 * p->iron_slope_j_kgk2 * (k - REFERENCE_K)
               * (k - REFERENCE_K);
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
    const double *const a = IRON_W_MK;
    return a[0] + c * (a[1] + c * (a[2] + c * a[3]));
}

static double lining_k(const Parameters *p, double k)
{
    double tilt = p->pad_conductivity_slope_1_k * (k - REFERENCE_K);
    double risen = 0.0;
    if (p->pad_conductivity != 0.0)
        risen = LINING_K_RISE * p->pad_conductivity
                * tanh((k - LINING_K_CENTRE_K) / LINING_K_WIDTH_K);
    return p->pad_conductivity_w_mk * (1.0 + risen + tilt);
}

static double lining_cp(const Parameters *p, double k)
{
    double dt = k - REFERENCE_K, risen = 0.0;
    if (p->pad_capacity != 0.0)
        risen = p->pad_capacity * LINING_CP_RISE_J_KGK
                * -expm1(-dt / LINING_CP_SCALE_K);
    return p->pad_heat_capacity_j_kgk + risen
           + p->pad_capacity_slope_j_kgk2 * dt;
}

static double lining_t(const Parameters *p, double h, double t)
{
    if (p->pad_capacity == 0.0 && p->pad_capacity_slope_j_kgk2 == 0.0)
        return REFERENCE_K + h / p->pad_heat_capacity_j_kgk;
    for (int i = 0; i < 2; i++) {
        double dt = t - REFERENCE_K;
        double now = p->pad_heat_capacity_j_kgk * dt
                     + p->pad_capacity * LINING_CP_RISE_J_KGK
                           * (dt + LINING_CP_SCALE_K
                                       * expm1(-dt / LINING_CP_SCALE_K))
                     + 0.5 * p->pad_capacity_slope_j_kgk2 * dt * dt;
        t += (h - now) / lining_cp(p, t);
    }
    return t;
}

static double air_k(double k)
{
    const double *const a = SUTHERLAND;
    return a[0] * pow(k, 1.5) / (k + a[1] * pow(10.0, a[2] / k));
}

#define MAX_NODES 128
#define SIDES 2
#define PORTS 3

/* reality.py has the same layout of both */
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
        t[0] = REFERENCE_K + e[0] / c->backplate_j_k;
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
        s->lump_t[i] = REFERENCE_K + s->lump_e[i] / c->lump_j_k[i];
    s->lump_t[CENTRE] = iron_t(p, s->lump_e[CENTRE] / c->centre_kg,
                               s->lump_t[CENTRE]);
    if (p->fluid_latent_heat != 0.0) {
        double latent = p->fluid_latent_heat * (BOILING_J / 2);
        double sensible = c->lump_j_k[FLUID];
        for (int i = 0; i < 4; i++) {
            double x = tanh((fluid - BOILING_K) / BOILING_WIDTH_K);
            double stored = sensible * (fluid - REFERENCE_K)
                            + latent * (1 + x);
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
        contact = p->contact_conductance * in[IN_CONTACT] * p->pad_area_m2
                  * CONTACT_W_M2K * in[IN_PRESSURE_PA]
                  / (in[IN_PRESSURE_PA] + CONTACT_PA);
    for (int side = 0; side < SIDES; side++) {
        const double *t = s->t[side];
        double *link = h->link[side];
        double column = p->pad_area_m2 / (s->pad_m[side] / (c->pads - 1));
        link[0] = p->backplate_area_m2
                  / (p->backplate_thickness_m / (2 * STEEL_CONDUCTIVITY_W_MK));
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
            across += p->gap_conduction * (1.0 - in[IN_CONTACT])
                      * p->pad_area_m2 * air_k((front + surface) / 2)
                      / GAP_M;
        link[c->surface - 1] = across + contact;
    }
}

static void sources(const Corner *c, const State *s, const double *in,
                    Paths *h)
{
    const Parameters *p = &c->p;
    int surface = c->surface, front = surface - 1;
    memset(h->source, 0, sizeof h->source);
    double warm = fmax((s->t[0][0] + s->t[1][0]) / 2 - REFERENCE_K, 0.0);
    double drag_nm = DRAG_COLD_NM - DRAG_HOT_NM * expm1(-warm / DRAG_K);
    h->heat_in = in[IN_POWER_W]
                 + (1.0 - in[IN_CONTACT]) * p->residual_drag * drag_nm
                       * in[IN_SPEED_MS] / p->wheel_radius_m;
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
        if (p->wet_disc != 0.0 && in[IN_WETNESS] != 0.0) {
            double spray = SPRAY_STILL_KG_S
                           + SPRAY_KG_S_PER_MS * in[IN_SPEED_MS];
            double above = fmax(ts - in[IN_AMBIENT_K], 0.0);
            h->source[side][surface] -= p->wet_disc * in[IN_WETNESS] * spray
                                        * EVAPORATION_J_KG
                                        * -expm1(-above / SPRAY_K) / 2;
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
        double near = radiation(face, body, GREY * FACING_M2)
                      + FACING_M2 * (FILM_W_M2K + STIRRED_W_M2K * v08);
        double away = SHEET_M2 * (SHEET_W_M2K + SHEET_BLOWN_W_M2K * v08);
        double lug = LUG_W_K;
        double share = p->dust_shield / (near + lug + away);
        h->coupling[1][BODY] += share * near * lug;
        h->coupling[1][AIR] += share * near * away;
        join(h->between, BODY, AIR, share * lug * away);
    }
    h->body_gain = p->damper_heat * DAMPER_WS_M * v;
}

static void drawn_path(const Corner *c, const State *s, const double *in,
                       const DrawnPath *d, Paths *h)
{
    const int ports[PORTS] = {0, c->surface, c->nodes - 1};
    int start = (int)d->start, end = (int)d->end;
    int sides = start < PORTS ? SIDES : 1;
    double base = d->conductance_w_k
                  * pow(in[IN_SPEED_MS] / 20.0, d->speed_exponent);
    if (d->band_ms != 0.0) {
        double x = (in[IN_SPEED_MS] - d->band_ms) / d->band_width_ms;
        base *= exp(-x * x);
    }
    if (d->contact != 0.0)
        base *= d->contact > 0.0 ? in[IN_CONTACT] : 1.0 - in[IN_CONTACT];
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
    double v = in[IN_SPEED_MS], ambient = in[IN_AMBIENT_K];
    double v08 = pow(v, 0.8);
    int surface = c->surface, last = c->nodes - 1;
    chain_links(c, s, in, h);
    sources(c, s, in, h);
    capacities(c, s, h);

    double steeper = EXPONENT_RISE * p->convection_exponent * (v - 10.0)
                     / (v + 20.0);
    double forced = pow(v, p->forced_exponent) * fmax(1.0 + steeper, 0.2);
    double natural[SIDES], faces[SIDES];
    for (int side = 0; side < SIDES; side++) {
        double excess = fabs(s->t[side][surface] - s->lump_t[AIR]);
        natural[side] = p->natural_convection_w_m2k
                        * sqrt(sqrt(fmax(excess, 1.0) / BUOYANCY_K));
        faces[side] = p->face_air_area_m2
                      * mixed(natural[side], p->forced_face_w_m2k * forced);
    }
    double vent = p->vent_area_m2
                  * mixed(p->parked_vent_fraction
                              * ((natural[0] + natural[1]) / 2),
                          p->forced_vent_w_m2k * forced);

    memset(h->coupling, 0, sizeof h->coupling);
    double loose = SHIM_LOOSE * p->shim_contact
                   * exp(-in[IN_PRESSURE_PA] / SHIM_PA);
    double shim = p->pad_area_m2 / p->shim_resistance_m2k_w
                  * fmax(1.0 - loose, 0.05);
    double to_vanes = c->gap_m[c->cheeks - 1] / p->face_area_m2
                      + VENT_HALF_GAP_M / p->vent_bridge_area_m2;
    for (int side = 0; side < SIDES; side++) {
        int behind = side ? FINGER : PISTON, bypass = side ? FINGER : BODY;
        double *back = h->coupling[PORTS * side];
        double *face = h->coupling[PORTS * side + 1];
        double t_back = s->t[side][0];
        double above = fmax(fabs(t_back - s->lump_t[AIR]), 1.0);
        back[behind] = shim;
        back[bypass] += BYPASS_W_K * p->caliper_bypass * t_back / BYPASS_K;
        back[BRACKET] = p->bracket_conduction
                        * (BRACKET_W_K + BRACKET_BRAKING_W_K * in[IN_CONTACT]);
        back[AIR] = p->hammerhead_forced_w_k * v08
                    + BACKPLATE_LOSS_W_K * p->backplate_loss
                          * sqrt(sqrt(above / BACKPLATE_LOSS_K));
        face[AIR] = faces[side];
        face[bypass] = radiation(
            s->t[side][surface], s->lump_t[bypass],
            p->face_emissivity * VIEW_OF_DISC_M2 * p->disc_caliper_radiation);
        h->coupling[PORTS * side + 2][CENTRE] =
            iron_k(s->t[side][last]) / to_vanes;
    }

    double split = p->caliper_fluid_split;
    double caliper = mixed(p->caliper_natural_w_k,
                           p->caliper_forced_w_k * pow(v, 0.7));
    memset(h->between, 0, sizeof h->between);
    join(h->between, CENTRE, AIR, vent);
    join(h->between, CENTRE, HAT, HAT_W_K * p->disc_hat);
    join(h->between, CENTRE, HUB, HUB_W_K * p->hub_conduction);
    join(h->between, HAT, AIR, HAT_AIR_M2 * vent / p->vent_area_m2);
    join(h->between, PISTON, FLUID,
         1.0 / (1.0 / TIGHT_W_K + split / SPLIT_PISTON_W_K));
    join(h->between, FLUID, BODY,
         1.0 / (1.0 / TIGHT_W_K + split / SPLIT_BODY_W_K));
    join(h->between, BODY, FINGER,
         1.0 / (1.0 / TIGHT_W_K + split / SPLIT_FINGER_W_K));
    join(h->between, BODY, AIR, BODY_SHARE * caliper);
    join(h->between, FINGER, AIR, FINGER_SHARE * caliper);

    double slow = v / WALKING_MS;
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
    out[AIR] = 1.0 / (1.0 / OPEN_AIR_W_K
                      + p->local_air / (AIR_STILL_W_K + AIR_BLOWN_W_K * v));
    out[HUB] = HUB_STILL_W_K + HUB_BLOWN_W_K * v08;
    out[BRACKET] = BRACKET_STILL_W_K + BRACKET_BLOWN_W_K * v08;
    out[BODY] = radiation(s->lump_t[BODY], ambient,
                          CALIPER_EMISSIVITY * BODY_AREA_M2
                              * p->caliper_radiation);
    out[FINGER] = radiation(s->lump_t[FINGER], ambient,
                            CALIPER_EMISSIVITY * FINGER_AREA_M2
                                * p->caliper_radiation);
    out[FLUID] = p->fluid_exchange
                 * (LINE_W_K
                    + PUMPING_W_K * in[IN_PUMPING_PA_S]
                          / (in[IN_PUMPING_PA_S] + PUMPING_PA_S));
    unheard_paths(c, s, v, v08, h);
    for (int i = 0; i < DRAWN; i++)
        if (p->drawn[i].conductance_w_k != 0.0)
            drawn_path(c, s, in, &p->drawn[i], h);
}

#endif
