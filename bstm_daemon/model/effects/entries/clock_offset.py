"""Effect 44: the clock of the thermocouples' logger is off."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter


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
