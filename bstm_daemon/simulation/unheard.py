"""Heat paths that no catalogue of effects has heard of.

They serve tests of what is said when nothing known fits; the estimator has no
form for them.

``dust_shield``: a sheet of steel behind the disc, bolted to the caliper's
lug. Face and shield exchange heat by radiation and through the air between
them, the shield gives it on to the caliper and to the air. Its own 0.2 kJ/K
are left out, which makes the three conductances a star about it.

``brake_duct``: a flap that opens where the disc is hot and lets ram air to
the vanes, as active cooling ducts do.

``damper_heat``: part of what the damper turns into heat flows through the
strut's clamp into the caliper. Damper power is proportional to roughness and
speed; Zuo and Zhang (2013) give up to 400 W a car at 97 km/h on an average
road.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from bstm_daemon.simulation.lanes import Lanes
    from bstm_daemon.simulation.materials import Array

SIGMA_W_M2K4: Final = 5.670374419e-8

# 0.03 m2 of the face, iron of 0.7 before zinc of 0.3, 10 mm of air
_FACING_M2: Final = 0.03
_GREY: Final = 0.27
_FILM_W_M2K: Final = 4.0
_STIRRED_W_M2K: Final = 2.0
# lug of 0.8 mm sheet, 0.25 m wide, 0.03 m long
_LUG_W_K: Final = 0.32
# both sides of the sheet in the wheel house
_SHEET_M2: Final = 0.06
_SHEET_W_M2K: Final = 5.0
_SHEET_BLOWN_W_M2K: Final = 3.0

# 10 cm2 of ram air, a seventh of its heat capacity used
_DUCT_WS_MK: Final = 0.18
_OPENS_K: Final = 623.15
_WIDTH_K: Final = 10.0

# a tenth of 15 W s/m a corner: average road, 3.7; one ISO 8608 class rougher,
# four times that
_DAMPER_WS_M: Final = 1.5


def shield_links(
    lanes: Lanes, face_k: Array, body_k: Array, speed_ms: Array
) -> tuple[Array, Array, Array]:
    """Return face to caliper, face to air and caliper to air [W/K].

    *face_k* and *body_k* (lanes,) are the inner face and the caliper.
    """
    blown = speed_ms**0.8
    squares = face_k * face_k + body_k * body_k
    near = _FACING_M2 * (
        _GREY * SIGMA_W_M2K4 * squares * (face_k + body_k)
        + _FILM_W_M2K
        + _STIRRED_W_M2K * blown
    )
    away = _SHEET_M2 * (_SHEET_W_M2K + _SHEET_BLOWN_W_M2K * blown)
    share = lanes.p.dust_shield / (near + _LUG_W_K + away)
    return (
        share * near * _LUG_W_K,
        share * near * away,
        share * _LUG_W_K * away,
    )


def duct_loss(lanes: Lanes, centre_k: Array, speed_ms: Array) -> Array:
    """Return the conductance of the vanes to the outer air [W/K]."""
    opened = 0.5 * (1.0 + np.tanh((centre_k - _OPENS_K) / (2.0 * _WIDTH_K)))
    loss: Array = lanes.p.brake_duct * _DUCT_WS_MK * speed_ms * opened
    return loss


def damper_power(lanes: Lanes, speed_ms: Array) -> Array:
    """Return the heat that the caliper gets of the damper [W]."""
    power: Array = lanes.p.damper_heat * _DAMPER_WS_M * speed_ms
    return power
