"""Material curves of the reality: grey iron, friction lining, air.

Forms and coefficients belong to this room alone. Specific enthalpies are
counted from 20 degC, in closed form, so that a node's energy and its
temperature determine each other exactly.

Sources: heat capacity is a Shomate form (NIST-JANAF notation) through
handbook points of GJL-250 between 20 and 600 degC (460 to 710 J/(kg K),
misfit below 0.6 J/(kg K)); conductivity is a cubic through 53 W/(m K) at
20 degC and 36 W/(m K) at 600 degC, inside the diffusivity band that Hecht et
al. (1999) measured on commercial rotors.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Law = tuple[Array, Array, Array]
"""Of a lining's cp or k: cold, strength of its rise (0: none), and slope."""

REFERENCE_K: Final = 293.15
"""Temperature at which specific enthalpies are 0."""

NEWTON_STEPS: Final = 2
"""Enough from one step's distance: the error squares each time."""

# Shomate coefficients, t = T / 1000 K: J/(kg K)
_A, _B, _C, _D, _E = 354.96, 535.518, -592.287, 511.852, -1.20346

_CURIE_K: Final = 1030.0
_CURIE_WIDTH_K: Final = 42.0
_CURIE_PEAK_J_KGK: Final = 480.0

_IRON_K: Final = (53.2454, -1.16611e-2, -6.89066e-5, 6.74969e-8)

LINING_CP_RISE_J_KGK: Final = 420.0
LINING_CP_SCALE_K: Final = 250.0


def iron_heat_capacity(
    temperature_k: Array, bump: Array | float, slope: Array | float = 0.0
) -> Array:
    """Return cp of grey iron [J/(kg K)], any shape.

    *bump* scales the peak of the magnetic and eutectoid transitions near
    757 degC; 0 leaves the smooth curve. *slope* [J/(kg K^2)] tilts it about
    20 degC, as that of linings below.
    """
    t = temperature_k * 1e-3
    smooth = _A + t * (_B + t * (_C + t * _D)) + _E / (t * t)
    x = (temperature_k - _CURIE_K) / _CURIE_WIDTH_K
    # sech^2, written so that a cold disc does not overflow cosh
    peak: Array = 1.0 - np.tanh(x) ** 2
    tilt = slope * (temperature_k - REFERENCE_K)
    return smooth + bump * _CURIE_PEAK_J_KGK * peak + tilt


def iron_enthalpy(
    temperature_k: Array, bump: Array | float, slope: Array | float = 0.0
) -> Array:
    """Return the specific enthalpy of grey iron [J/kg], 0 at 20 degC."""
    smooth = _shomate_integral(temperature_k) - _IRON_H0
    height: Array | float = bump * (_CURIE_PEAK_J_KGK * _CURIE_WIDTH_K)
    x = (temperature_k - _CURIE_K) / _CURIE_WIDTH_K
    x0 = (REFERENCE_K - _CURIE_K) / _CURIE_WIDTH_K
    peak: Array = height * (np.tanh(x) - np.tanh(x0))
    return smooth + peak + 0.5 * slope * (temperature_k - REFERENCE_K) ** 2


def _shomate_integral(temperature_k: Array) -> Array:
    t = temperature_k * 1e-3
    powers = t * (_A + t * (_B / 2 + t * (_C / 3 + t * (_D / 4))))
    return 1e3 * (powers - _E / t)


_IRON_H0: Final = float(_shomate_integral(np.array(REFERENCE_K)))


def iron_conductivity(temperature_k: Array) -> Array:
    """Return k of grey iron [W/(m K)], any shape."""
    c = np.clip(temperature_k - 273.15, 0.0, 700.0)
    k0, k1, k2, k3 = _IRON_K
    return k0 + c * (k1 + c * (k2 + c * k3))


def lining_conductivity(temperature_k: Array, law: Law) -> Array:
    """Return k of the lining [W/(m K)] by its *law*.

    The resin's glass transition and char raise it by a quarter around
    230 degC, as an S.
    """
    cold_w_mk, strength, slope = law
    s_shape = np.tanh((temperature_k - 500.0) / 150.0)
    tilt = slope * (temperature_k - REFERENCE_K)
    return cold_w_mk * (1.0 + 0.25 * strength * s_shape + tilt)


def lining_heat_capacity(temperature_k: Array, law: Law) -> Array:
    """Return cp of the lining [J/(kg K)] by its *law*."""
    cold_j_kgk, strength, slope = law
    dt = temperature_k - REFERENCE_K
    risen = -np.expm1(-dt / LINING_CP_SCALE_K)
    return cold_j_kgk + strength * LINING_CP_RISE_J_KGK * risen + slope * dt


def lining_enthalpy(temperature_k: Array, law: Law) -> Array:
    """Return the specific enthalpy of the lining [J/kg], 0 at 20 degC."""
    cold_j_kgk, strength, slope = law
    dt = temperature_k - REFERENCE_K
    relaxed = dt + LINING_CP_SCALE_K * np.expm1(-dt / LINING_CP_SCALE_K)
    risen: Array = strength * LINING_CP_RISE_J_KGK * relaxed
    return cold_j_kgk * dt + risen + 0.5 * slope * dt * dt


def iron_temperature(
    enthalpy_j_kg: Array,
    near_k: Array,
    bump: Array | float,
    slope: Array | float = 0.0,
) -> Array:
    """Return the temperature [K] of iron with this specific enthalpy.

    Newton steps from *near_k*, which is within a time step of the answer.
    """
    t = near_k
    for _ in range(NEWTON_STEPS):
        missing = enthalpy_j_kg - iron_enthalpy(t, bump, slope)
        t = t + missing / iron_heat_capacity(t, bump, slope)
    return t


def lining_temperature(enthalpy_j_kg: Array, near_k: Array, law: Law) -> Array:
    """Return the temperature [K] of a lining with this specific enthalpy."""
    t = near_k
    for _ in range(NEWTON_STEPS):
        missing = enthalpy_j_kg - lining_enthalpy(t, law)
        t = t + missing / lining_heat_capacity(t, law)
    return t


def air_conductivity(temperature_k: Array) -> Array:
    """Return k of dry air [W/(m K)], Sutherland form, 1 % to 1000 K."""
    return (
        2.64638e-3
        * temperature_k**1.5
        / (temperature_k + 245.4 * 10 ** (-12.0 / temperature_k))
    )
