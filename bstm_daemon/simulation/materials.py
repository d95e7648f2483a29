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

from bstm_daemon.simulation import sizes

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Law = tuple[Array, Array, Array]
"""Of a lining's cp or k: cold, strength of its rise (0: none), and slope."""

NEWTON_STEPS: Final = 2
"""Enough from one step's distance: the error squares each time."""

_A, _B, _C, _D, _E = sizes.SHOMATE


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
    x = (temperature_k - sizes.CURIE_K) / sizes.CURIE_WIDTH_K
    # sech^2, written so that a cold disc does not overflow cosh
    peak: Array = 1.0 - np.tanh(x) ** 2
    tilt = slope * (temperature_k - sizes.REFERENCE_K)
    return smooth + bump * sizes.CURIE_PEAK_J_KGK * peak + tilt


def iron_enthalpy(
    temperature_k: Array, bump: Array | float, slope: Array | float = 0.0
) -> Array:
    """Return the specific enthalpy of grey iron [J/kg], 0 at 20 degC."""
    smooth = _shomate_integral(temperature_k) - _IRON_H0
    height: Array | float = bump * (
        sizes.CURIE_PEAK_J_KGK * sizes.CURIE_WIDTH_K
    )
    x = (temperature_k - sizes.CURIE_K) / sizes.CURIE_WIDTH_K
    x0 = (sizes.REFERENCE_K - sizes.CURIE_K) / sizes.CURIE_WIDTH_K
    peak: Array = height * (np.tanh(x) - np.tanh(x0))
    return (
        smooth + peak + 0.5 * slope * (temperature_k - sizes.REFERENCE_K) ** 2
    )


def _shomate_integral(temperature_k: Array) -> Array:
    t = temperature_k * 1e-3
    powers = t * (_A + t * (_B / 2 + t * (_C / 3 + t * (_D / 4))))
    return 1e3 * (powers - _E / t)


_IRON_H0: Final = float(_shomate_integral(np.array(sizes.REFERENCE_K)))


def iron_conductivity(temperature_k: Array) -> Array:
    """Return k of grey iron [W/(m K)], any shape."""
    c = np.clip(temperature_k - 273.15, 0.0, 700.0)
    k0, k1, k2, k3 = sizes.IRON_W_MK
    return k0 + c * (k1 + c * (k2 + c * k3))


def lining_conductivity(temperature_k: Array, law: Law) -> Array:
    """Return k of the lining [W/(m K)] by its *law*.

    The resin's glass transition and char raise it by a quarter around
    230 degC, as an S.
    """
    cold_w_mk, strength, slope = law
    s_shape = np.tanh(
        (temperature_k - sizes.LINING_K_CENTRE_K) / sizes.LINING_K_WIDTH_K
    )
    tilt = slope * (temperature_k - sizes.REFERENCE_K)
    return cold_w_mk * (1.0 + sizes.LINING_K_RISE * strength * s_shape + tilt)


def lining_heat_capacity(temperature_k: Array, law: Law) -> Array:
    """Return cp of the lining [J/(kg K)] by its *law*."""
    cold_j_kgk, strength, slope = law
    dt = temperature_k - sizes.REFERENCE_K
    risen = -np.expm1(-dt / sizes.LINING_CP_SCALE_K)
    return (
        cold_j_kgk + strength * sizes.LINING_CP_RISE_J_KGK * risen + slope * dt
    )


def lining_enthalpy(temperature_k: Array, law: Law) -> Array:
    """Return the specific enthalpy of the lining [J/kg], 0 at 20 degC."""
    cold_j_kgk, strength, slope = law
    dt = temperature_k - sizes.REFERENCE_K
    relaxed = dt + sizes.LINING_CP_SCALE_K * np.expm1(
        -dt / sizes.LINING_CP_SCALE_K
    )
    risen: Array = strength * sizes.LINING_CP_RISE_J_KGK * relaxed
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
    a, b, c = sizes.SUTHERLAND
    return (
        a
        * temperature_k**1.5
        / (temperature_k + b * 10 ** (c / temperature_k))
    )
