"""Effect 20: the binder of a new lining decomposes once."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Memory, Network, Source, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

ONSET_WIDTH_K = 60.0


class PadPyrolysis(Effect):
    """d(alpha)/dt = k(T) (1 - alpha) at the pad's face, heat sink with it.

    Resin binders decompose from about 350 degC on and take up heat; what is
    gone stays gone, so a second identical run shows nothing.
    """

    number = 20
    description = "The lining's binder decomposes once and absorbs heat."
    signature = (
        "Pad front, first heating above about 350 degC only, irreversible."
    )
    own_parameters = (
        Parameter("heat_j", "J", 100.0, 2e5, 3.5e4, "absorbed in total"),
        Parameter("onset_c", "degC", 250.0, 500.0, 370.0, "half rate"),
        Parameter("rate_per_s", "1/s", 1e-4, 0.1, 5e-3, "rate when hot"),
    )
    forms = ({"onset_c": 300.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add a memory of the decomposed share and a sink in pad_front."""
        start_k = self["onset_c"] + KELVIN_OFFSET - 0.5 * ONSET_WIDTH_K
        onset = value("pad_front", Table(start_k, ONSET_WIDTH_K, (0.0, 1.0)))
        left = value("pyrolysis", Table(0.0, 1.0, (1.0, 0.0)))
        rate = self["rate_per_s"]
        return model.network.with_memory(
            Memory("pyrolysis", "integral", rate, (onset, left))
        ).with_source(
            Source(
                "pyrolysis_heat",
                "pad_front",
                -self.scaled("heat_j") * rate,
                (onset, left),
            )
        )
