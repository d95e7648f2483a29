"""Effect 32: thermocouples follow late."""

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, InputModel, Parameter
from bstm_daemon.model.effects.tables import (
    EACH_SENSOR,
    SENSOR,
    excess_correction,
    sensors_of,
)


class ThermocoupleLag(Effect):
    """Each thermocouple, or one, follows with a time constant.

    Sheathed elements in contact take 5 to 20 s. A lag can not be taken off a
    noisy reading, so what the model has is shown as late; no heat is moved.
    One that has come loose is late and reads too little besides: its junction
    is between the part and the air.
    """

    number = 32
    kind = "measurement"
    description = (
        "Thermocouples show what the part had seconds ago, loose ones less."
    )
    signature = "One sensor, with its rate of change."
    twins = ("disc_hat",)
    own_parameters = (
        Parameter("time_s", "s", 0.1, 120.0, 15.0, "time constant"),
        Parameter("loss", "1", 0.0, 0.18, 0.0, "of the excess over 20 degC"),
        SENSOR,
    )
    forms = EACH_SENSOR + tuple(
        {**sensor, "loss": loss}
        for loss in (0.05, 0.15)
        for sensor in EACH_SENSOR
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Let those nodes that may be measured be shown late."""
        time_s = self.scaled("time_s")
        return model.with_lag(
            dict.fromkeys(sensors_of(self["sensor"]), time_s)
        )

    def edit_corner_inputs(
        self, inputs: InputModel, corner: CornerConfig
    ) -> InputModel:
        """Undo what loose thermocouples of *corner* lose."""
        return excess_correction(
            inputs, corner, self["sensor"], gain=1.0 - self.scaled("loss")
        )
