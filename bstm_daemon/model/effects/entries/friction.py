"""Effects on friction and on the pressure that makes it."""

from __future__ import annotations

from dataclasses import replace
from math import exp
from typing import TYPE_CHECKING

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, InputModel, Parameter
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.thermal.network import Memory, difference, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.config.sections import CornerConfig

LEAST = 0.1


class FrictionFade(Effect):
    """mu falls linearly between two temperatures of the interface.

    0.38 cold to 0.25 to 0.30 above 500 to 600 degC is usual; the interface
    is the mean of the disc and the face of the pads.
    """

    number = 1
    kind = "heat"
    description = "Hot brakes fade: friction falls above about 350 degC."
    signature = (
        "All heat, braking only, beyond a temperature of the interface."
    )
    twins = ("disc_radiation_driving",)
    own_parameters = (
        Parameter("drop", "1", 0.0, 0.8, 0.28, "fall of mu when hot"),
        Parameter("onset_c", "degC", 100.0, 600.0, 350.0, "mu begins to fall"),
        Parameter("span_k", "K", 20.0, 500.0, 180.0, "until it has fallen"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a ramp over the temperature of the interface."""
        fall = self.scaled("drop")
        onset_k = self["onset_c"] + KELVIN_OFFSET

        def fade(t: float) -> float:
            done = min(max((t - onset_k) / self["span_k"], 0.0), 1.0)
            return max(1.0 - fall * done, LEAST)

        return model.with_friction_law(FrictionLaw.of(temperature_k=fade))


REFERENCE_MS = 10.0
SLOWEST_MS = 1.0


class FrictionSpeed(Effect):
    """mu ~ v^b, Rhee's power law, 1 at 36 km/h.

    Rhee (SAE 740415) gives b from -0.25 to +0.25 by compound.
    """

    number = 2
    kind = "heat"
    description = "Friction falls with sliding speed."
    signature = "All heat, braking only, with speed."
    twins = ("friction_pressure",)
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.3, 0.1, "-b, fall with speed"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the speed."""
        power = -self.scaled("exponent")

        def law(v: float) -> float:
            ratio: float = (max(v, SLOWEST_MS) / REFERENCE_MS) ** power
            return ratio

        return model.with_friction_law(FrictionLaw.of(speed_ms=law))


REFERENCE_PA = 1.0e6
LOWEST_PA = 2.5e5


class FrictionPressure(Effect):
    """mu ~ p^(a - 1), Rhee's power law, 1 at 1 MPa.

    Rhee (SAE 740415) gives F = K P^a with a from 0.80 to 1.25 by compound.
    """

    number = 3
    kind = "heat"
    description = "Friction falls with pressure."
    signature = "All heat, braking only, with pressure."
    twins = ("friction_speed", "pushout_pressure")
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.3, 0.05, "1 - a, with pressure"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the pressure."""
        power = -self.scaled("exponent")

        def law(p: float) -> float:
            ratio: float = (max(p, LOWEST_PA) / REFERENCE_PA) ** power
            return ratio

        return model.with_friction_law(FrictionLaw.of(pressure_pa=law))


WORN_IN = 6.0
"""Multiples of the bedding energy after which nothing changes any more."""


class FrictionHistory(Effect):
    """mu = mu0 (1 - drop (1 - exp(-E / E0))), E the heat since new.

    The thesis saw p/F rise from 400 to 600 Pa/N on new pads (Fig 4.9), so mu
    fell by a third, less on the second run and not on the third.
    """

    number = 4
    kind = "heat"
    description = (
        "Friction of new pads falls with the heat they absorb at first."
    )
    signature = (
        "All heat, braking only; early drives differ from late ones; gone "
        "on a repeated run."
    )
    own_parameters = (
        Parameter("drop", "1", 0.0, 0.6, 0.33, "fall of mu when worn in"),
        Parameter(
            "bedding_energy_j", "J", 1e5, 1e8, 5e6, "heat for 63 % of the fall"
        ),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Scale the friction heat by a memory of its own integral."""
        if not model.heat_from_pressure:
            return model
        drop = min(self.scaled("drop"), 0.95)
        worn = Table.from_function(
            lambda e: 1.0 - drop * (1.0 - exp(-e)), 0.0, WORN_IN
        )
        bedding = Memory(
            "bedding",
            "integral",
            1.0 / self["bedding_energy_j"],
            (value("brake_power_w"),),
            upper=WORN_IN,
        )
        net = model.network.with_memory(bedding)
        return model.with_network(net).with_heat_factors(
            value("bedding", worn)
        )


RELEASE_S = 2.0
"""Time constant with which the contact forgets a stop."""


class FrictionInStop(Effect):
    """mu = mu0 (1 + rise (1 - exp(-t / time))), t since the brake is held.

    Within a stop of SAE J2522 organic linings gain 5 to 30 % while their
    contact plateaus grow; some lose as much. How fast is the form.
    """

    number = 43
    kind = "heat"
    description = "Friction rises or falls within each braking."
    signature = "All heat, with the seconds since braking began."
    twins = ("hydraulic_lag", "pushout_pressure")
    either_sign = True
    own_parameters = (
        Parameter("rise", "1", 0.0, 0.5, 0.15, "of mu in a long stop"),
        Parameter("time_s", "s", 0.2, 30.0, 3.0, "to 63 % of it"),
    )
    forms = ({"time_s": 0.8}, {"time_s": 10.0})

    def edit(self, model: CornerModel) -> CornerModel:
        """Scale the friction heat by a memory of the braking's length."""
        if not model.heat_from_pressure:
            return model
        release = -self["time_s"] / RELEASE_S
        rate = difference(
            "brake_on", "stop_length", Table(-1.0, 1.0, (release, 0.0, 1.0))
        )
        memory = Memory(
            "stop_length", "integral", 1.0 / self["time_s"], (rate,)
        )
        factor = Table(0.0, 1.0, (1.0, max(1.0 + self.scaled("rise"), 0.1)))
        net = model.network.with_memory(memory)
        return model.with_network(net).with_heat_factors(
            value("stop_length", factor)
        )


class PushoutPressure(Effect):
    """T = 2 (p - p0) A n eta mu r: p0 more than configured.

    Seals and guides take 0.05 to 0.15 MPa (Limpert); Eq 4.1 has none.
    """

    number = 5
    kind = "heat"
    description = "Part of the pressure only overcomes seals and guides."
    signature = (
        "All heat, braking at low pressure, a constant loss of pressure."
    )
    twins = ("friction_pressure", "friction_history")
    own_parameters = (Parameter("pressure_pa", "Pa", 0.0, 5e5, 1e5, "lost"),)

    def edit_corner_inputs(
        self, inputs: InputModel, corner: CornerConfig
    ) -> InputModel:
        """Raise the push-out pressure of *corner*."""
        more = self.scaled("pressure_pa")

        def edited(one: CornerConfig) -> CornerConfig:
            if one.name != corner.name:
                return one
            pressure = one.pushout_pressure_pa + more
            return one.model_copy(update={"pushout_pressure_pa": pressure})

        return inputs.with_corners(edited)


class HydraulicLag(Effect):
    """A first-order lag of each circuit, more than configured.

    0.1 to 0.3 s from master cylinder to wheel in boosted systems; the second
    circuit follows the first.
    """

    number = 6
    kind = "heat"
    description = "The wheel brakes follow the pedal with a delay."
    signature = (
        "All heat, at the edges of brakings, with the rate of the pressure."
    )
    twins = ("powertrain_torque_error",)
    own_parameters = (
        Parameter("primary_s", "s", 0.0, 2.0, 0.15, "of the first circuit"),
        Parameter("secondary_s", "s", 0.0, 2.0, 0.3, "of the second circuit"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Raise the lags of ``[heat]``."""
        heat = inputs.config.heat
        return inputs.with_heat(
            primary_lag_s=heat.primary_lag_s + self.scaled("primary_s"),
            secondary_lag_s=heat.secondary_lag_s + self.scaled("secondary_s"),
        )


class BrakeWithoutPressure(Effect):
    """Braking that the motion shows counts although no pressure does.

    Assist functions, anti-slip control and the park brake press the pads
    from behind the primary circuit. What decelerates the car by more than
    ``[heat] brake_on_force_n`` beyond torque, resistance and slope is then
    brake heat, divided as Feed-Back's. ``fused`` finds such braking by
    itself. The strength is the share that counts.
    """

    number = 39
    kind = "heat"
    description = "Something other than the pedal applies the brakes."
    signature = (
        "All heat, braked by more than its resistance without pressure; by "
        "the motion only."
    )
    twins = ("residual_drag", "powertrain_torque_error", "mass_error")

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Let the pass over samples count what the motion shows."""
        return replace(inputs, unpressed_share=self.strength)
