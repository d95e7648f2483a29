"""Effect 32: thermocouples follow late."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import EACH_SENSOR, SENSOR, sensors_of


class ThermocoupleLag(Effect):
    """Each thermocouple, or one, follows with a time constant.

    Sheathed elements in contact take 5 to 20 s. A lag can not be taken off a
    noisy reading, so what the model has is shown as late; no heat is moved.
    """

    number = 32
    kind = "measurement"
    description = "Thermocouples show what the part had seconds ago."
    signature = "One sensor, with its rate of change."
    twins = ("disc_hat",)
    own_parameters = (
        Parameter("time_s", "s", 0.1, 120.0, 15.0, "time constant"),
        SENSOR,
    )
    forms = EACH_SENSOR

    def edit(self, model: CornerModel) -> CornerModel:
        """Let those nodes that may be measured be shown late."""
        time_s = self.scaled("time_s")
        return model.with_lag(
            dict.fromkeys(sensors_of(self["sensor"]), time_s)
        )
