"""Material curves: enthalpy is the integral of cp and can be inverted."""

import numpy as np
import pytest

from bstm_daemon.simulation import materials

T_K = np.linspace(260.0, 1150.0, 179)


@pytest.mark.parametrize(
    ("bump", "tilt"), [(0.0, 0.0), (1.0, 0.3), (2.0, -0.1)]
)
def test_iron_enthalpy_is_the_integral_of_heat_capacity(
    bump: float, tilt: float
) -> None:
    slope = (
        materials.iron_enthalpy(T_K + 0.05, bump, tilt)
        - materials.iron_enthalpy(T_K - 0.05, bump, tilt)
    ) / 0.1

    np.testing.assert_allclose(
        slope, materials.iron_heat_capacity(T_K, bump, tilt), rtol=1e-6
    )
    assert abs(float(materials.iron_enthalpy(np.array(293.15), bump))) < 1e-9


@pytest.mark.parametrize(("strength", "tilt"), [(0.0, 0.0), (1.0, 0.8)])
def test_lining_enthalpy_is_the_integral_of_heat_capacity(
    strength: float, tilt: float
) -> None:
    law = (np.array(1050.0), np.array(strength), np.array(tilt))
    slope = (
        materials.lining_enthalpy(T_K + 0.05, law)
        - materials.lining_enthalpy(T_K - 0.05, law)
    ) / 0.1

    np.testing.assert_allclose(
        slope, materials.lining_heat_capacity(T_K, law), rtol=1e-6
    )


def test_temperature_is_found_from_one_step_away() -> None:
    near = T_K + 3.0
    law = (np.array(1050.0), np.array(1.0), np.array(0.0))

    iron = materials.iron_temperature(
        materials.iron_enthalpy(T_K, 1.0), near, 1.0
    )
    lining = materials.lining_temperature(
        materials.lining_enthalpy(T_K, law), near, law
    )

    np.testing.assert_allclose(iron, T_K, atol=1e-3)
    np.testing.assert_allclose(lining, T_K, atol=1e-8)


def test_iron_follows_the_handbook() -> None:
    t = np.array([20.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0]) + 273.15
    cp = np.array([460.0, 490.0, 525.0, 560.0, 600.0, 650.0, 710.0])

    np.testing.assert_allclose(
        materials.iron_heat_capacity(t, 0.0), cp, atol=1.0
    )
    # the transition peaks at 900 to 1400 J/(kg K) between 740 and 770 degC
    peak = materials.iron_heat_capacity(T_K, 1.0)
    assert 900.0 < peak.max() < 1400.0
    assert 1013.0 < T_K[peak.argmax()] < 1043.0


def test_iron_conductivity_stays_in_the_published_band() -> None:
    cold, hot = materials.iron_conductivity(np.array([293.15, 773.15]))

    assert 50.0 < cold < 55.0
    assert 36.0 < hot < 40.0


def test_air_conductivity_follows_the_tables() -> None:
    # Incropera table A.4: 26.3, 40.7 and 62.0 mW/(m K)
    k = materials.air_conductivity(np.array([300.0, 500.0, 900.0]))

    np.testing.assert_allclose(k, [0.0263, 0.0407, 0.0620], rtol=0.02)
