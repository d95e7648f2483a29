"""Effects of the car and of its sensors: what is wrong is an input."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import (
    CornerModel,
    Correction,
    InputModel,
    Parameter,
)
from bstm_daemon.model.effects.tables import NEGLIGIBLE, ROOM_K
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Node,
    Source,
    difference,
    value,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.roles import MEASURED_NODES

if TYPE_CHECKING:
    from bstm_daemon.config.sections import CornerConfig


class ThermocoupleOffset(Effect):
    """The reading is the node's temperature, an offset and a gain.

    The gain acts on the excess over 20 degC. The thesis saw up to 20 K
    between two thermocouples of one disc.
    """

    number = 31
    kind = "measurement"
    description = "A thermocouple sits where it is hotter than the node."
    signature = "One sensor, at any time, constant and with its temperature."
    twins = ("thermocouple_lag",)
    either_sign = True
    own_parameters = (
        Parameter("offset_k", "K", 0.0, 60.0, 9.0, "reads too high"),
        Parameter("gain", "1", 0.0, 0.15, 0.02, "of the excess over 20 degC"),
    )

    def edit_corner_inputs(
        self, inputs: InputModel, corner: CornerConfig
    ) -> InputModel:
        """Undo offset and gain of the thermocouples of *corner*."""
        gain = 1.0 + self.scaled("gain")
        zero = ROOM_K + self.scaled("offset_k")
        return inputs.with_correction(
            *(
                Correction(
                    f"temp_{corner.name.lower()}_{node}",
                    1.0 / gain,
                    ROOM_K - zero / gain,
                )
                for node in MEASURED_NODES
            )
        )


BEAD_J_K = 1e-3
"""A welded bead of 0.7 mm; what it takes from its node can not be seen."""


class ThermocoupleLag(Effect):
    """A bead on each measured node that follows with a time constant.

    Sheathed elements in contact take 5 to 20 s. A lag can not be taken off a
    noisy reading, so the model shows what a lagging sensor would.
    """

    number = 32
    kind = "measurement"
    description = "Thermocouples show what the part had seconds ago."
    signature = "One sensor, with its rate of change."
    twins = ("thermocouple_offset", "disc_hat")
    own_parameters = (
        Parameter("time_s", "s", 0.1, 120.0, 15.0, "time constant"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Add a bead for every node that may be measured."""
        if self.strength < NEGLIGIBLE:
            return model
        conductance = BEAD_J_K / self.scaled("time_s")
        net, shown = model.network, dict(model.shown_by)
        for node in MEASURED_NODES:
            if not model.has_node(node):
                continue
            bead = f"{node}_sensor"
            net = net.with_node(Node(bead, BEAD_J_K)).with_link(
                Link(f"{node}-sensor", node, bead, conductance)
            )
            shown[node] = bead
        return model.showing(net, shown)


class AccelerometerBias(Effect):
    """The reading is the true specific force plus a constant.

    0.1 m/s2 is 1 % of grade: 16 % of the braking force on a descent of 8 %.
    """

    number = 33
    kind = "heat"
    description = "The accelerometer has an offset, like a wrong grade."
    signature = (
        "All heat, braking, with speed, the same on the flat and downhill."
    )
    twins = ("mass_error", "powertrain_torque_error", "brake_share")
    either_sign = True
    own_parameters = (
        Parameter("bias_ms2", "m/s2", 0.0, 0.5, 0.08, "reads too high"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Take the offset off every sample."""
        bias = self.scaled("bias_ms2")
        return inputs.with_correction(
            Correction("acceleration_longitudinal", offset=-bias)
        )


LIGHTEST_SHARE = 0.3


class MassError(Effect):
    """The mass of ``[vehicle]`` times one plus a share.

    Two passengers are 6 to 7 % of a 2.2 t car, a trailer is 50 %.
    """

    number = 34
    kind = "heat"
    description = "The car is heavier than configured."
    signature = "All heat, braking, most in stops from speed."
    twins = ("accelerometer_bias", "powertrain_torque_error", "brake_share")
    either_sign = True
    own_parameters = (
        Parameter("share", "1", 0.0, 0.6, 0.06, "of the configured mass"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Scale the mass of ``[vehicle]``."""
        factor = max(1.0 + self.scaled("share"), LIGHTEST_SHARE)
        mass = factor * inputs.config.vehicle.mass_kg
        return inputs.with_vehicle(mass_kg=mass)


LEAST, MOST = 0.02, 0.98


class BrakeShare(Effect):
    """The front axle's share times one plus a part, the rear has the rest.

    Valves and friction of the axles vary by about a tenth. Feed-Back divides
    by ``front_share``; the torques of Feed-Forward are scaled alike, so that
    the car brakes as before.
    """

    number = 35
    kind = "heat"
    description = "The front brakes do more of the work than assumed."
    signature = (
        "All heat, front and rear in opposite ways, braking; the force of "
        "the whole car agrees."
    )
    twins = ("mass_error", "accelerometer_bias", "powertrain_torque_error")
    either_sign = True
    own_parameters = (
        Parameter("share", "1", 0.0, 0.5, 0.1, "added to the front's share"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Move force from the rear axle to the front."""
        old = inputs.config.vehicle.front_share
        if not LEAST < old < MOST:
            return inputs
        wanted = old * (1.0 + self.scaled("share"))
        new = min(max(wanted, LEAST), MOST)
        front, rear = new / old, (1.0 - new) / (1.0 - old)

        def edited(one: CornerConfig) -> CornerConfig:
            factor = front if one.name.startswith("F") else rear
            mu = factor * one.friction_coefficient
            brake = factor * one.drum_brake_factor
            return one.model_copy(
                update={"friction_coefficient": mu, "drum_brake_factor": brake}
            )

        return inputs.with_vehicle(front_share=new).with_corners(edited)


class PowertrainTorqueError(Effect):
    """The reading is a share of the torque at the wheels, plus an offset.

    Engine maps are good to 5 to 10 %; drag of gearbox and differential adds
    some newton metres.
    """

    number = 36
    kind = "heat"
    description = "Engine drag is less or more than the torque signal."
    signature = (
        "All heat, braking with the clutch closed, with the engine's drag "
        "and speed."
    )
    twins = ("accelerometer_bias", "mass_error", "brake_share")
    either_sign = True
    own_parameters = (
        Parameter("share", "1", 0.0, 0.18, 0.08, "of the torque, missing"),
        Parameter("offset_nm", "Nm", -200.0, 200.0, 12.0, "reads too high"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Undo gain and offset of every sample."""
        read = 1.0 - self.scaled("share")
        offset = self.scaled("offset_nm")
        return inputs.with_correction(
            Correction("powertrain_torque", 1.0 / read, -offset / read)
        )


SOAK = Table(-1.0, 1.0, (0.0, 1.0, -1.0))
"""Rate over speed minus memory: 1 - m at rest, which it approaches as an
exponential; -1 above walking pace, where the wind clears it in as long."""


class AmbientHeatSoak(Effect):
    """The reading rises above the air while parked and falls when driving.

    Each loss to the air is larger by its conductance times what the sensor
    reads too much; that goes off as heat of its own.
    """

    number = 37
    kind = "measurement"
    description = "The bumper's sensor reads the warm front of a parked car."
    signature = "All nodes at once, parked, with a memory of minutes."
    twins = ("local_air",)
    either_sign = True
    stage = LAST
    own_parameters = (
        Parameter("excess_k", "K", 0.5, 30.0, 8.0, "reads too high, finally"),
        Parameter("time_s", "s", 60.0, 3600.0, 400.0, "to 63 % of it"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add a memory and, beside each loss, what is lost besides."""
        memory = Memory(
            "ambient_soak",
            "integral",
            1.0 / self["time_s"],
            (difference("speed_ms", "ambient_soak", SOAK),),
        )
        excess = self.scaled("excess_k")

        def beside(link: Link) -> Source:
            return Source(
                f"{link.name}_soak",
                link.a,
                -excess * link.conductance_w_k,
                (*link.factors, value("ambient_soak")),
            )

        net = model.network
        losses = [link for link in net.links if link.b == "ambient"]
        return replace(
            net.with_memory(memory),
            sources=(*net.sources, *map(beside, losses)),
        )


class ClockOffset(Effect):
    """Thermocouples show what the parts had some seconds before, or after.

    Loggers of their own are set by hand or by a GPS that is late: 1 to 20 s.
    Their clocks lose up to a few seconds an hour. It acts where measured and
    modelled temperatures are compared; the estimate does not change.
    """

    number = 44
    kind = "measurement"
    description = "The clock of the thermocouples' logger is off."
    signature = "All sensors at once, with their rate of change."
    twins = ("thermocouple_lag",)
    either_sign = True
    own_parameters = (
        Parameter("offset_s", "s", 0.0, 120.0, 6.0, "late"),
        Parameter("drift_s_h", "s/h", 0.0, 60.0, 0.0, "later each hour"),
    )
    forms = ({"offset_s": 0.0, "drift_s_h": 10.0},)

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Say how late the thermocouples' clock is."""
        late_s, late_share = inputs.clock_late
        return replace(
            inputs,
            clock_late=(
                late_s + self.scaled("offset_s"),
                late_share + self.scaled("drift_s_h") / 3600.0,
            ),
        )
