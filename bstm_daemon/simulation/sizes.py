"""Numbers of the reality that its forms in Python and in C share.

``header`` writes them down for C. Parameters of a corner and strengths of
effects are in ``parameters``; the sources of the curves in ``materials``.
"""

from typing import Final

from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

SIGMA: Final = STEFAN_BOLTZMANN_W_M2K4

REFERENCE_K: Final = 293.15
"""Temperature at which specific enthalpies are 0."""

# materials
SHOMATE: Final = (354.96, 535.518, -592.287, 511.852, -1.20346)
"""Shomate coefficients of grey iron, t = T / 1000 K: J/(kg K)."""
CURIE_K: Final = 1030.0
CURIE_WIDTH_K: Final = 42.0
CURIE_PEAK_J_KGK: Final = 480.0
IRON_W_MK: Final = (53.2454, -1.16611e-2, -6.89066e-5, 6.74969e-8)
"""Cubic of the conductivity over degC."""
LINING_CP_RISE_J_KGK: Final = 420.0
LINING_CP_SCALE_K: Final = 250.0
LINING_K_RISE: Final = 0.25
LINING_K_CENTRE_K: Final = 500.0
LINING_K_WIDTH_K: Final = 150.0
SUTHERLAND: Final = (2.64638e-3, 245.4, -12.0)
"""Of the conductivity of air."""
STEEL_CONDUCTIVITY_W_MK: Final = 48.0

# boiling as a smeared latent heat: a few ml of vapour in a 30 ml gallery; the
# film on the piston is some 15 K hotter than the bulk and boils at 150 degC
BOILING_K: Final = 410.15
BOILING_WIDTH_K: Final = 7.0
BOILING_J: Final = 8.0e3

# friction
FADE_DEPTH: Final = 0.30
FADE_CENTRE_K: Final = 703.15
FADE_WIDTH_K: Final = 45.0
SPEED_FALL: Final = 0.18
PRESSURE_FALL: Final = 0.15
REFERENCE_SPEED_MS: Final = 10.0
REFERENCE_PRESSURE_PA: Final = 1.0e6
BEDDING_FALL: Final = 0.25
BEDDING_J: Final = 4.0e6
LEAST_FACTOR: Final = 0.05

# pyrolysis and wear of linings
PYROLYSIS_J_KG: Final = 2.0e5
PYROLYSIS_RATE_S: Final = 2.0e5
PYROLYSIS_ACTIVATION_K: Final = 1.15e4
LAST_M: Final = 1.0e-3
"""What the rivets and the warning plate leave."""
WEAR_M_PER_J: Final = 1e-3 / 6.0e7
WEAR_RISE_K: Final = 120.0
WEAR_RISE_FROM_K: Final = 593.15
WEAR_RISE_MOST_K: Final = 400.0

# paths of every corner
VENT_HALF_GAP_M: Final = 0.004
TIGHT_W_K: Final = 80.0
OPEN_AIR_W_K: Final = 1e5
WALKING_MS: Final = 2.2
BUOYANCY_K: Final = 200.0
BODY_SHARE: Final = 0.6
FINGER_SHARE: Final = 0.4
HUB_STILL_W_K: Final = 1.2
HUB_BLOWN_W_K: Final = 0.1
BRACKET_STILL_W_K: Final = 1.0
BRACKET_BLOWN_W_K: Final = 0.12
AIR_STILL_W_K: Final = 12.0
AIR_BLOWN_W_K: Final = 25.0

# typical strength of the paths that effects switch on
CONTACT_W_M2K: Final = 360.0
CONTACT_PA: Final = 2.0e6
GAP_M: Final = 3.0e-4
HAT_W_K: Final = 5.0
HUB_W_K: Final = 1.0
HAT_AIR_M2: Final = 0.05
EXPONENT_RISE: Final = 0.45
BACKPLATE_LOSS_W_K: Final = 0.12
BACKPLATE_LOSS_K: Final = 100.0
BRACKET_W_K: Final = 0.18
BRACKET_BRAKING_W_K: Final = 0.14
BYPASS_W_K: Final = 0.25
BYPASS_K: Final = 400.0
SHIM_LOOSE: Final = 0.35
SHIM_PA: Final = 2.0e5
VIEW_OF_DISC_M2: Final = 0.0015
SPLIT_PISTON_W_K: Final = 6.0
SPLIT_BODY_W_K: Final = 20.0
SPLIT_FINGER_W_K: Final = 2.5
CALIPER_EMISSIVITY: Final = 0.9
BODY_AREA_M2: Final = 0.030
FINGER_AREA_M2: Final = 0.020
LINE_W_K: Final = 0.05
PUMPING_W_K: Final = 1.5
PUMPING_PA_S: Final = 3.0e6
SPRAY_KG_S_PER_MS: Final = 1.2e-5
SPRAY_STILL_KG_S: Final = 5.0e-5
SPRAY_K: Final = 70.0
EVAPORATION_J_KG: Final = 2.4e6
DRAG_COLD_NM: Final = 1.5
DRAG_HOT_NM: Final = 3.5
DRAG_K: Final = 80.0

# heat paths that are in no catalogue of effects
FACING_M2: Final = 0.03
"""Of the dust shield to the disc's face."""
GREY: Final = 0.27
"""Iron of 0.7 before zinc of 0.3, 10 mm of air."""
FILM_W_M2K: Final = 4.0
STIRRED_W_M2K: Final = 2.0
LUG_W_K: Final = 0.32
"""A lug of 0.8 mm sheet, 0.25 m wide, 0.03 m long."""
SHEET_M2: Final = 0.06
"""Both sides of the sheet in the wheel house."""
SHEET_W_M2K: Final = 5.0
SHEET_BLOWN_W_M2K: Final = 3.0
DAMPER_WS_M: Final = 1.5
"""A tenth of 15 W s/m a corner: average road, 3.7; one ISO 8608 class rougher,
four times that."""
