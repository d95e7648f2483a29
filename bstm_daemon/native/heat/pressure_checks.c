#include "pressure_checks.h"

#include "check_rules.h"

void pressure_checks_hold_pressures(CheckMemoryFloats *m, const Readings *now,
                                    int pressures, int unsure)
{
    for (int i = 0; i < pressures; i++) {
        const double pressure = now->pressures[i];
        if (isnan(pressure) || pressure != m->pressure_held[i]) {
            m->pressure_held[i] = isnan(pressure) ? 0.0 : pressure;
            m->pressure_held_s[i] = 0.0;
            m->pressure_mark[i] = now->speed;
        } else m->pressure_held_s[i] += now->dt_s;
        if (unsure) m->pressure_mark[i] = now->speed;
        int outcome = OPEN;
        if (!isnan(pressure) && now->speed_known) {
            if (pressure <= FROZEN_PRESSURE_PA || m->pressure_held_s[i] < MOVES_S)
                outcome = PASSED;
            else if (m->pressure_held_s[i] >= FROZEN_PRESSURE_S
                     && fabs(now->speed - m->pressure_mark[i]) > FROZEN_PRESSURE_MS)
                outcome = FAILED;
        }
        m->pressure_stuck_s[i] = check_rules_advance(STUCK, m->pressure_stuck_s[i], outcome, now->dt_s);
    }
}

void pressure_checks_compare_switch(CheckMemoryFloats *m, const Readings *now)
{
    /* only the pedal's own pressure: assistance fills the other circuits */
    int outcome = OPEN;
    const double primary = now->pressures[0];
    if (!isnan(primary) && now->speed > SWITCH_MS
        && !isnan(now->brake_switch) && now->esc_active == 0.0)
        outcome = primary > SWITCH_PRESSURE_PA && now->brake_switch == 0.0
            ? FAILED : PASSED;
    m->switch_fault_s = check_rules_advance(SWITCH, m->switch_fault_s, outcome, now->dt_s);
}

void pressure_checks_compare_zero(CheckMemoryFloats *m, const Readings *now,
                                  int pressures)
{
    for (int i = 0; i < pressures; i++) {
        const double pressure = now->pressures[i];
        int outcome = OPEN;
        if (!isnan(pressure)) outcome = pressure < ZERO_PA ? FAILED : PASSED;
        m->zero_fault_s[i] =
            check_rules_advance(ZERO, m->zero_fault_s[i], outcome, now->dt_s);
    }
}

void pressure_checks_compare_twins(CheckMemoryFloats *m, const Readings *now)
{
    const double share = 1.0 - exp(-now->dt_s / TWIN_S);
    for (int i = 0; i < TWINS; i++) {
        const double low = now->twin_low[i], high = now->twin_high[i];
        const double mean = 0.5 * (low + high);
        int outcome = OPEN;
        if (mean > TWIN_PA && !now->intervenes)
            m->twin_pressed_s[i] += now->dt_s;
        else m->twin_pressed_s[i] = 0.0;
        if (m->twin_pressed_s[i] > TWIN_SETTLED_S) {
            double apart = high - low - TWIN_ZERO_PA;
            if (apart < 0.0) apart = 0.0;
            apart = apart / mean;
            if (apart > TWIN_MOST) apart = TWIN_MOST;
            const double weight = mean > TWIN_MOST_PA ? TWIN_MOST_PA : mean;
            apart *= weight;
            m->twin_difference[i] +=
                share * (apart - m->twin_difference[i]);
            m->twin_pressure[i] += share * (weight - m->twin_pressure[i]);
            outcome = m->twin_difference[i]
                > TWIN_LIMIT * m->twin_pressure[i] ? FAILED : PASSED;
        }
        m->twin_fault_s[i] = check_rules_advance(
            TWIN, m->twin_fault_s[i], outcome, now->dt_s);
    }
}
