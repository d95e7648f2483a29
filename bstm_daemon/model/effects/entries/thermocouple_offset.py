"""Effect 31: thermocouples read too much for where they sit."""

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter
from bstm_daemon.model.effects.tables import (
    EACH_SENSOR,
    SENSOR,
    excess_correction,
)


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
        SENSOR,
    )
    forms = EACH_SENSOR

    def edit_corner_inputs(
        self, inputs: InputModel, corner: CornerConfig
    ) -> InputModel:
        """Undo offset and gain of the thermocouples of *corner*."""
        return excess_correction(
            inputs,
            corner,
            self["sensor"],
            gain=1.0 + self.scaled("gain"),
            offset_k=self.scaled("offset_k"),
        )
