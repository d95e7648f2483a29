"""Effect 21: worn linings are thinner."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.linings import edit_lining
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network

THINNEST_M = 1e-3
"""Less lining than this is not left: the plate would touch the disc."""


class PadWear(Effect):
    """Every slab is thinner by the same share: less mass, a shorter way.

    What is lost is lost before the drive; a drive of 60 MJ a corner takes
    about 1 mm more. A thermocouple is as deep below the face as configured,
    in worn linings too: one that is not would be worn away.
    """

    number = 21
    description = "Worn linings conduct heat to the fluid faster."
    signature = (
        "Pad back and fluid, sooner and hotter; pad front less; grows over "
        "many drives with their heat."
    )
    twins = ("shim_contact", "pad_conductivity")
    own_parameters = (
        Parameter("worn_m", "m", 0.0, 0.02, 4.5e-3, "lost of the lining"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Scale capacities, conductances and depths of the lining."""
        whole = model.spec.pad.thickness_m
        least = min(THINNEST_M, whole)
        left = max(whole - self.scaled("worn_m"), least) / whole
        return edit_lining(
            model.network,
            lambda one: replace(
                one,
                capacity_j_k=left * one.capacity_j_k,
                depth_m=None if one.depth_m is None else left * one.depth_m,
            ),
            lambda one: replace(
                one, conductance_w_k=one.conductance_w_k / left
            ),
        )
