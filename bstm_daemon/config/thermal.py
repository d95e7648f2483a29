"""The sections of the thermal model and of the cooling by air."""

from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from bstm_daemon.config.section import (
    Fraction,
    NotNegative,
    Positive,
    Section,
    Text,
    check_curve,
    require,
)

Emissivity = Annotated[float, Field(gt=0, le=1)]

SURFACE_AT_REST_W_K: Final = 0.6
"""Of a caliper's own surface: half of a box of 0.18 by 0.12 by 0.1 m, 0.05 m2,
at 12 W/m2K of free convection and radiation (Incropera, Fundamentals of Heat
and Mass Transfer). Table 4.1's value is that of all ways out of the lump; the
structure "extended" has the bracket's and the disc's apart."""

SHIELDED_DISC: Final = 0.6
"""Of a disc in its place: a sheet before a face halves what it radiates
(Incropera, radiation shields), as the splash shield and the wheel do; edge and
part of the hat see the surroundings."""


class ThermalConfig(Section):
    """``[thermal]``: Table 4.1 and the switches between forms of an equation.

    Conductances and capacities are those of one corner (both pads).
    """

    structure: Literal["thesis", "extended"] = "thesis"
    """effects of the base model: none, or the eleven of
    [model.md](model.md#structures) and the backplates' mass"""
    disc_mass_correction_factor: Positive = 1.0
    """on the disc's mass (Table 4.1)"""
    heat_partition_correction_factor: NotNegative = 1.0
    """gamma, on the pads' share of the heat (Table 4.1)"""
    disc_view_factor: Positive = 1.0
    """share of the disc's free area that sees cold surroundings; 0.6 with
    `extended`"""
    disc_emissivity: Emissivity = 0.55
    """Table 4.1"""
    pad_emissivity: Emissivity = 0.85
    """Table 4.1"""
    pad_backplate_thermal_resistance_m2k_w: Positive = 4e-3
    """pad back to fluid, plate and shim, per area of the pads (Eq 4.18, Table
    4.1)"""
    pad_dynamic_convection_ws_m3k: NotNegative = 2.0
    """pad back to air, times speed (Eq 4.19, Table 4.1)"""
    pad_dynamic_convection_exponent: Annotated[float, Field(ge=0, le=2)] = 1.0
    """exponent of the speed in Eq 4.19; 1 in the thesis"""
    pad_static_loss_w_k: NotNegative = 0.0
    """the same loss at standstill; 0 in the thesis"""
    hammerhead_sink: Literal["ambient", "fluid"] = "ambient"
    """where the loss of Eq 4.19 goes"""
    backplate_thermal_capacity_j_k: NotNegative = 0.0
    """both backplates; 0 in the thesis"""
    fluid_model: str = "lump"
    """`lump`, or `module:function` of your own"""
    fluid_static_convection_w_k: NotNegative = 1.5
    """fluid and caliper to air at rest (Table 4.1); 0.6 with `extended`"""
    fluid_caliper_thermal_capacity_j_k: Positive = 2600.0
    """fluid and caliper as one lump (Table 4.1)"""
    fluid_dynamic_convection_ws_mk: NotNegative = 0.15
    """the same, times speed (Table 4.1)"""
    fluid_dynamic_convection_exponent: Annotated[float, Field(ge=0, le=2)] = (
        1.0
    )
    """exponent of that speed, about 20 m/s; 1 in the thesis"""
    hot_pad_threshold_c: Positive = 400.0
    """pad's face above which part of the heat into it does not warm it
    ("dissolves")"""
    hot_pad_factor: Fraction = 0.6
    """share of the heat that warms the pad above it"""
    hot_pad_width_k: Positive = 20.0
    """width of the transition at the threshold"""
    direct_air_fraction: Fraction = 0.0
    """share of the brake heat that goes straight to the air"""
    gap_conductance_w_m2k: NotNegative = 0.0
    """disc to pad while the brake is off; 0 in the thesis"""
    disc_pad_radiation: Literal["grey-plates", "product"] = "grey-plates"
    """grey plates, or the product of Eq 2.10"""

    @model_validator(mode="before")
    @classmethod
    def _surroundings(cls, given: Any) -> Any:
        """Take the surfaces' own losses where other paths are apart."""
        if isinstance(given, dict) and given.get("structure") == "extended":
            return {
                "fluid_static_convection_w_k": SURFACE_AT_REST_W_K,
                "disc_view_factor": SHIELDED_DISC,
            } | given
        return given


class CoolingConfig(Section):
    """``[cooling]``: the S-function of Eq 4.12 and the standstill blend."""

    csv: Text | None = None
    """CSV file instead of `speed_ms` and `s_per_s`
    ([exchange.md](exchange.md#tables-from-cfd-and-benches))"""
    speed_ms: list[NotNegative] = [0.0, 5.0, 10.0, 13.89, 19.44, 25.0, 41.67]
    """speeds of the S-function, rising"""
    s_per_s: list[NotNegative] = [
        *(4.0e-4, 1.0e-3, 1.6e-3, 2.0e-3, 2.7e-3, 3.4e-3, 5.4e-3)
    ]
    """cooling coefficient S at each speed (Eq 4.12)"""
    standstill_convection_fraction: Fraction = 0.4
    """share of S that stays at standstill, beside radiation"""
    blend_end_ms: Positive = 5.0
    """speed at which the standstill blend has ended"""
    form: Literal["rate", "conductance"] = "rate"
    """S as a rate, or as a conductance that heat capacity divides"""

    def _check(self) -> None:
        require(self.csv is None, "'csv' is read with a configuration file")
        check_curve(self.speed_ms, self.s_per_s, "speed_ms", "s_per_s")
