"""The thesis's equations in the network of a corner, against closed forms.

One short step is marched and the heat that each link and source carried is
read from the ledger, so the numbers are those of the model as it runs.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Final

import pytest

from bstm_daemon.model.thermal.brake_corner import PADS, build_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import compile_network
from bstm_daemon.model.thermal.properties import disc_heat_capacity
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.model.thermal.brake_corner import CornerSpec

    MakeSpec = Callable[..., CornerSpec]

INPUTS: Final = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
AMBIENT_K: Final = 283.15
MOMENT_S: Final = 1e-4

NO_COOLING: Final = {"speed_ms": [0.0, 50.0], "s_per_s": [0.0, 0.0]}
NO_RADIATION: Final = {"disc_emissivity": 1e-9, "pad_emissivity": 1e-9}

DISC: Final = {"mass_kg": 7.5, "swept_area_m2": 0.085, "total_area_m2": 0.2}
PAD: Final = {"area_m2": 6.5e-3, "thickness_m": 0.011}
PADS_AREA_M2: Final = PADS * 6.5e-3

TABLE_4_1: Final = {
    "disc_mass_correction_factor": 1.1,
    "heat_partition_correction_factor": 2.0,
    "disc_emissivity": 0.7,
    "pad_emissivity": 0.5,
    "pad_backplate_thermal_resistance_m2k_w": 3e-3,
    "pad_dynamic_convection_ws_m3k": 3.0,
    "fluid_static_convection_w_k": 2.0,
    "fluid_caliper_thermal_capacity_j_k": 2000.0,
    "fluid_dynamic_convection_ws_mk": 0.2,
}


def batch_of(spec: CornerSpec, **temperatures_k: float) -> Batch:
    """Return the corner of *spec* at ambient but for *temperatures_k*."""
    batch = Batch([compile_network(build_corner(spec, INPUTS))], AMBIENT_K)
    names = batch.programs[0].state_names
    for name, temperature_k in temperatures_k.items():
        batch.state[names.index(name)] = temperature_k
    return batch


def march(
    batch: Batch,
    steps: int,
    dt_s: float,
    speed_ms: float = 0.0,
    power_w: float = 0.0,
    brake_on: float = 0.0,
) -> dict[str, float]:
    """March *batch* with constant inputs and return its state by name."""
    row = [speed_ms, brake_on, AMBIENT_K, power_w]
    batch.march(array("d", row * steps), steps, dt_s)
    return dict(zip(batch.programs[0].state_names, batch.state, strict=True))


def flows_w(
    spec: CornerSpec,
    speed_ms: float = 0.0,
    power_w: float = 0.0,
    brake_on: float = 0.0,
    **temperatures_k: float,
) -> dict[str, float]:
    """Return what each link and source carries [W] at these temperatures."""
    batch = batch_of(spec, **temperatures_k)
    march(batch, 1, MOMENT_S, speed_ms, power_w, brake_on)
    names = batch.programs[0].ledger_names
    return {
        name: energy / MOMENT_S
        for name, energy in zip(names, batch.ledger, strict=True)
    }


def test_heat_is_split_and_none_is_lost(make_spec: MakeSpec) -> None:
    """Eq 2.6: disc (1 - air)(1 - gamma (1 - sigma)), pads the rest."""
    spec = make_spec(
        thermal={
            "heat_partition_correction_factor": 2.0,
            "direct_air_fraction": 0.01,
        }
    )
    pads = 0.99 * 2.0 * (1.0 - spec.disc_share)

    flow = flows_w(spec, 10.0, 1e4)

    assert flow["disc_heat"] == pytest.approx(1e4 * (0.99 - pads))
    assert flow["pad_heat"] == pytest.approx(1e4 * pads)
    assert flow["air_heat"] == pytest.approx(100.0)


def test_disc_share_of_example_is_that_of_eq_2_3(make_spec: MakeSpec) -> None:
    """The ring, not the shadow of the pads: 98 %, not 89 %."""
    assert make_spec().disc_share == pytest.approx(0.981, abs=0.001)


def test_disc_stores_the_integral_of_cp(make_spec: MakeSpec) -> None:
    """Eq 2.5 with pure iron: E = m (c0 dT + c' (T^2 - T0^2) / 2)."""
    spec = make_spec(
        {"disc": {**DISC, "material": "pure-iron"}},
        thermal={**NO_RADIATION, "heat_partition_correction_factor": 0.0},
        cooling=NO_COOLING,
    )
    # start inside the curve: it keeps its end value below 20 degC
    batch = batch_of(spec, disc=293.15)

    disc_k = march(batch, 2000, 0.05, 10.0, 2e4, 1.0)["disc"]

    rise = disc_k - 293.15
    slope = (685.0 - 449.0) / 480.0
    stored = 7.5 * (449.0 * rise + 0.5 * slope * rise**2)
    assert stored == pytest.approx(2e4 * 100.0, rel=1e-6)


@pytest.mark.parametrize(
    ("speed_ms", "convection", "radiation"),
    [(0.0, 0.4, 1.0), (2.5, 0.7, 0.5), (5.0, 1.0, 0.0), (20.0, 1.0, 0.0)],
)
def test_standstill_blend(
    make_spec: MakeSpec, speed_ms: float, convection: float, radiation: float
) -> None:
    """Section 4.4: 40 % of S and all radiation at rest, S alone at 18 km/h.

    Radiation (Eq 2.9) is net, and leaves out what the pads cover.
    """
    spec = make_spec(cooling={"speed_ms": [0.0, 50.0], "s_per_s": [2e-3] * 2})
    cp = disc_heat_capacity(spec.disc)

    flow = flows_w(spec, speed_ms, disc=673.15)

    assert flow["disc_convection"] == pytest.approx(
        convection * 2e-3 * 7.5 * cp(673.15) * (673.15 - AMBIENT_K), rel=1e-4
    )
    area = 0.2 - PADS_AREA_M2
    fourth = 673.15**4 - AMBIENT_K**4
    assert flow["disc_radiation"] == pytest.approx(
        radiation * 0.55 * STEFAN_BOLTZMANN_W_M2K4 * area * fourth, rel=1e-4
    )


def test_cold_disc_radiates_nothing(make_spec: MakeSpec) -> None:
    """Eq 2.9 as printed would cool a disc below its surroundings."""
    flow = flows_w(make_spec())

    assert flow["disc_radiation"] == 0.0
    assert flow["disc_pad_radiation"] == 0.0


def test_gap_conducts_only_with_the_brake_off(make_spec: MakeSpec) -> None:
    """Section 5.1.2 has radiation alone; a gap conductance may be added."""
    spec = make_spec(thermal={"gap_conductance_w_m2k": 100.0})
    hot = {"disc": 473.15}

    off = flows_w(spec, **hot)["disc_pad_gap"]
    on = flows_w(spec, brake_on=1.0, **hot)["disc_pad_gap"]

    difference = 473.15 - AMBIENT_K
    assert off == pytest.approx(100.0 * PADS_AREA_M2 * difference, rel=1e-4)
    assert on == 0.0


@pytest.mark.parametrize("sink", ["ambient", "fluid"])
@pytest.mark.parametrize("exponent", [1.0, 0.8, 0.5])
def test_hammerhead_loss(
    make_spec: MakeSpec, sink: str, exponent: float
) -> None:
    """Eq 4.19 with the power of Eq 2.12, and the part that stays at rest."""
    spec = make_spec(
        thermal={
            "hammerhead_sink": sink,
            "pad_dynamic_convection_exponent": exponent,
            "pad_static_loss_w_k": 0.2,
        }
    )
    hot = {"pad_back": 423.15, "backplate": 423.15, "fluid": 363.15}
    difference = 423.15 - (363.15 if sink == "fluid" else AMBIENT_K)

    moving, still = flows_w(spec, 10.0, **hot), flows_w(spec, 0.0, **hot)

    assert moving["hammerhead"] == pytest.approx(
        2.0 * 10.0**exponent * PADS_AREA_M2 * difference, rel=1e-3
    )
    assert still["hammerhead"] == 0.0
    assert still["hammerhead_static"] == pytest.approx(
        0.2 * difference, rel=1e-3
    )


def test_fluid_loses_heat_at_rest_and_with_speed(make_spec: MakeSpec) -> None:
    """Eq 5.1: H (T_fluid - T_amb), and its dynamic part times speed."""
    flow = flows_w(make_spec(), 10.0, fluid=383.15)

    assert flow["fluid_static"] == pytest.approx(1.5 * 100.0, rel=1e-4)
    assert flow["fluid_dynamic"] == pytest.approx(0.15 * 10.0 * 100.0)


def test_peak_of_the_fluid_gives_its_static_convection(
    make_spec: MakeSpec,
) -> None:
    """Eq 5.1 at dT/dt = 0: H = (A / R) (T_pb - T_f) / (T_f - T_amb)."""
    h_w_k = PADS_AREA_M2 / 4e-3 * 50.0 / 100.0
    spec = make_spec(thermal={"fluid_static_convection_w_k": h_w_k})
    batch = batch_of(spec, pad_back=433.15, backplate=433.15, fluid=383.15)

    fluid_k = march(batch, 1, MOMENT_S)["fluid"]

    rate_k_s = (fluid_k - 383.15) / MOMENT_S
    assert abs(rate_k_s) < 1e-3 * h_w_k * 100.0 / 2600.0


@pytest.mark.parametrize("key", TABLE_4_1)
def test_every_tunable_acts(make_spec: MakeSpec, key: str) -> None:
    """Table 4.1: a change of each parameter changes the network's numbers."""
    base = compile_network(build_corner(make_spec(), INPUTS))
    tuned = make_spec(thermal={key: TABLE_4_1[key]})
    other = compile_network(build_corner(tuned, INPUTS))

    assert other.ints == base.ints
    assert other.floats != base.floats
