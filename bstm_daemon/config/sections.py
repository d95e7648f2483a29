"""The configuration file as pydantic models, one vehicle a file.

Every quantity is SI with its unit in the key; temperatures are degC where a
key ends in ``_c``. :mod:`bstm_daemon.config.reading` reads a file into these
models and words the problems. ``docs/reference.md`` lists every key.
"""

from __future__ import annotations

import codecs
from datetime import date  # noqa: TC003  (pydantic resolves it at run time)
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from bstm_daemon.config.estimates import (
    AccuracyConfig,
    AdviceConfig,
    FluidConfig,
    ForecastConfig,
    WearConfig,
)
from bstm_daemon.config.heat import HeatConfig, automatic_mode
from bstm_daemon.config.section import (
    Fraction,
    NotNegative,
    Positive,
    Section,
    Text,
    check_curve,
    require,
)
from bstm_daemon.config.service import (
    DaemonConfig,
    E2eConfig,
    MetricsConfig,
    PublishConfig,
    RecordConfig,
    StateConfig,
)

Emissivity = Annotated[float, Field(gt=0, le=1)]
# upper bounds beyond any road vehicle: they find mm, cm2 and mm2 in an SI key
Radius = Annotated[float, Field(gt=0, le=0.5)]
PistonArea = Annotated[float, Field(gt=0, le=0.02)]
DiscArea = Annotated[float, Field(gt=0, le=1)]
DiscMass = Annotated[float, Field(gt=0, le=100)]
PadArea = Annotated[float, Field(gt=0, le=0.05)]
PadThickness = Annotated[float, Field(gt=0, le=0.05)]
CornerName = Literal["FL", "FR", "RL", "RR"]


def _place(corner_name: str) -> tuple[str, str]:
    axle = "front" if corner_name[0] == "F" else "rear"
    return axle, "left" if corner_name[1] == "L" else "right"


class Curve(Section):
    """A material property over temperature, linear between the points."""

    temperature_c: list[float]
    value: list[Positive]

    @model_validator(mode="after")
    def _points_fit(self) -> Self:
        check_curve(self.temperature_c, self.value, "temperature_c", "value")
        return self


def _form_of_property(value: object) -> str:
    return "curve" if isinstance(value, dict | Curve) else "number"


LINING_HEAT_CAPACITY_J_KGK: Final = (500.0, 2500.0)
LINING_CONDUCTIVITY_W_MK: Final = (0.3, 8.0)
"""Ranges of linings, from cold to glowing: 800 to 1300 J/kgK and 0.5 to 3
W/mK are typical, 5 W/mK of metallic ones. A matched value beyond stands in
for something else that the model lacks."""

LiningHeatCapacity = Annotated[
    Annotated[float, Field(ge=500.0, le=2500.0), Tag("number")]
    | Annotated[Curve, Tag("curve")],
    Discriminator(_form_of_property),
]
LiningConductivity = Annotated[
    Annotated[float, Field(ge=0.3, le=8.0), Tag("number")]
    | Annotated[Curve, Tag("curve")],
    Discriminator(_form_of_property),
]
"""Properties of a lining: one number, or a curve over temperature."""


class VehicleConfig(Section):
    """``[vehicle]``: what Feed-Back needs of the car (Eq 4.2, 4.11)."""

    id: Text
    mass_kg: Annotated[float, Field(ge=100, le=60_000)]
    wheel_radius_m: Annotated[float, Field(ge=0.1, le=1)]
    wheel_inertia_kg_m2: NotNegative = 3.0
    drag_area_m2: NotNegative = 0.7
    friction_ns_m: NotNegative = 4.0
    rolling_resistance: NotNegative = 0.014
    front_share: Fraction = 0.7
    ambient_c: Annotated[float, Field(ge=-60, le=70)] = 20.0


class BusConfig(Section):
    """``[[bus]]``: one CAN bus and the DBC that describes it."""

    name: Text
    dbc: Text
    interface: Text = "socketcan"
    channel: Text = "can0"
    bitrate: Annotated[int, Field(gt=0)] | None = None
    fd: bool = False
    strict: bool = True
    encoding: str = "cp1252"

    @model_validator(mode="after")
    def _encoding_exists(self) -> Self:
        try:
            codecs.lookup(self.encoding)
        except LookupError as error:
            msg = f"no text encoding is called 'encoding' = {self.encoding!r}"
            raise ValueError(msg) from error
        return self


class SignalConfig(Section):
    """``[signals.<role>]``: where a role comes from.

    A signal or an expression of a message, or a column of a table.
    ``si = (value * scale + offset) * sign`` in ``unit``, then to SI. ``min``
    and ``max`` are limits in ``unit``; a value outside is not a sample.
    """

    message: str | None = None
    signal: str | None = None
    expression: str | None = None
    column: Text | None = None
    bus: str | None = None
    unit: str
    sign: Literal[1, -1] = 1
    scale: float = 1.0
    offset: float = 0.0
    timeout_s: Positive | None = None
    depth_m: Annotated[float, Field(ge=0, le=0.05)] | None = None
    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.column is not None:
            of_a_frame = (self.message, self.signal, self.expression, self.bus)
            require(
                of_a_frame == (None,) * 4,
                "with 'column', a column of a table, there is no 'message', "
                "'signal', 'expression' or 'bus'",
            )
        else:
            require(
                (self.signal is None) != (self.expression is None),
                "needs exactly one of 'signal' and 'expression'"
                + ("" if self.signal else ", or the 'column' of a table"),
            )
            require(
                self.message is not None,
                "needs 'message', the DBC message that carries it",
            )
        require(self.scale != 0, "'scale' must not be 0")
        if self.min is not None and self.max is not None:
            require(self.min < self.max, "'min' must be below 'max'")
        return self


class TableConfig(Section):
    """``[table]``: where a signal table (CSV, Parquet, HDF5) has its time.

    A table in the long format has one value a row: ``name`` is the column
    with the name of the signal, ``value`` the one with its value.
    """

    time: Text | None = None
    time_unit: Literal["s", "ms", "us", "iso8601"] | None = None
    rate_hz: Positive | None = None
    delimiter: Text | None = None
    name: Text | None = None
    value: Text | None = None

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        require(
            (self.time is None) != (self.rate_hz is None),
            "needs either 'time', the column with the time, or 'rate_hz', "
            "the rows a second of a table without one",
        )
        require(
            self.time_unit is None or self.time is not None,
            "'time_unit' needs 'time'",
        )
        require(
            (self.name is None) == (self.value is None),
            "'name' and 'value' are used together: one value a row",
        )
        require(
            self.name is None or self.rate_hz is None,
            "'name' and 'value' need a column 'time', not 'rate_hz'",
        )
        require(
            self.delimiter is None or len(self.delimiter) == 1,
            f"'delimiter' = {self.delimiter!r} must be one character",
        )
        return self


class DiscConfig(Section):
    """``corner.disc``: geometry and material of the disc.

    ``mass_kg`` is the mass that takes part in heating (the ring),
    ``swept_area_m2`` both friction faces, ``total_area_m2`` what radiates.
    ``heat_capacity_exponent`` says how much of its material's rise of the
    heat capacity over that at 20 degC it has: 1 all, 0 none.
    """

    model: str = "lumped"
    mass_kg: DiscMass
    swept_area_m2: DiscArea
    total_area_m2: DiscArea
    material: Literal["grey-iron", "grey-iron-smooth", "pure-iron", "own"] = (
        "grey-iron"
    )
    heat_capacity_j_kgk: Curve | None = None
    heat_capacity_exponent: Annotated[float, Field(ge=0, le=2)] = 1.0
    conductivity_w_mk: Positive = 50.0
    density_kg_m3: Positive = 7200.0
    worn_m: Annotated[float, Field(ge=0, le=0.01)] = 0.0
    effusivity_heat_capacity_j_kgk: Positive = 460.0

    @model_validator(mode="after")
    def _own_needs_curve(self) -> Self:
        own = self.material == "own"
        require(
            own == (self.heat_capacity_j_kgk is not None),
            "'heat_capacity_j_kgk' goes with material \"own\" and only there",
        )
        return self

    @model_validator(mode="after")
    def _swept_is_a_part(self) -> Self:
        require(
            self.swept_area_m2 <= self.total_area_m2,
            f"'swept_area_m2' = {self.swept_area_m2:g} must be at most "
            f"'total_area_m2' = {self.total_area_m2:g}, which it is a part of",
        )
        return self


class PadConfig(Section):
    """``corner.pad``: one of the two equal pads of a corner."""

    model: str = "slabs"
    area_m2: PadArea
    thickness_m: PadThickness
    new_thickness_m: PadThickness | None = None
    measured: date | None = None
    slabs: Annotated[int, Field(ge=1, le=60)] = 10
    surface_cells: Literal["half", "full"] = "half"
    density_kg_m3: Positive = 2300.0
    heat_capacity_j_kgk: LiningHeatCapacity = 1000.0
    conductivity_w_mk: LiningConductivity = 1.2

    @model_validator(mode="after")
    def _is_a_lining(self) -> Self:
        for name, unit, (low, high) in (
            ("heat_capacity_j_kgk", "J/(kg K)", LINING_HEAT_CAPACITY_J_KGK),
            ("conductivity_w_mk", "W/(m K)", LINING_CONDUCTIVITY_W_MK),
        ):
            given = getattr(self, name)
            if isinstance(given, Curve):
                require(
                    low <= min(given.value) and max(given.value) <= high,
                    f"{name!r} must stay between {low:g} and {high:g} {unit}, "
                    "no lining is beyond",
                )
        return self

    @model_validator(mode="after")
    def _new_is_thickest(self) -> Self:
        new_m = self.new_thickness_m
        require(
            new_m is None or self.thickness_m <= new_m,
            f"'thickness_m' = {self.thickness_m:g}, the remaining lining, "
            f"must be at most 'new_thickness_m' = {new_m or 0.0:g}",
        )
        return self


class ThermalConfig(Section):
    """``[thermal]``: Table 4.1 and the switches between forms of an equation.

    Conductances and capacities are those of one corner (both pads).
    """

    structure: Literal["thesis", "extended"] = "thesis"
    disc_mass_correction_factor: Positive = 1.0
    heat_partition_correction_factor: NotNegative = 1.0
    disc_emissivity: Emissivity = 0.55
    pad_emissivity: Emissivity = 0.85
    pad_backplate_thermal_resistance_m2k_w: Positive = 4e-3
    pad_dynamic_convection_ws_m3k: NotNegative = 2.0
    pad_dynamic_convection_exponent: Annotated[float, Field(ge=0, le=2)] = 1.0
    pad_static_loss_w_k: NotNegative = 0.0
    hammerhead_sink: Literal["ambient", "fluid"] = "ambient"
    backplate_thermal_capacity_j_k: NotNegative = 0.0
    fluid_model: str = "lump"
    fluid_static_convection_w_k: NotNegative = 1.5
    fluid_caliper_thermal_capacity_j_k: Positive = 2600.0
    fluid_dynamic_convection_ws_mk: NotNegative = 0.15
    hot_pad_threshold_c: Positive = 400.0
    hot_pad_factor: Fraction = 0.6
    hot_pad_width_k: Positive = 20.0
    direct_air_fraction: Fraction = 0.0
    gap_conductance_w_m2k: NotNegative = 0.0
    disc_pad_radiation: Literal["grey-plates", "product"] = "grey-plates"


class CoolingConfig(Section):
    """``[cooling]``: the S-function of Eq 4.12 and the standstill blend."""

    speed_ms: list[NotNegative] = [0.0, 5.0, 10.0, 13.89, 19.44, 25.0, 41.67]
    s_per_s: list[NotNegative] = [
        *(4.0e-4, 1.0e-3, 1.6e-3, 2.0e-3, 2.7e-3, 3.4e-3, 5.4e-3)
    ]
    standstill_convection_fraction: Fraction = 0.4
    blend_end_ms: Positive = 5.0
    form: Literal["rate", "conductance"] = "rate"

    @model_validator(mode="after")
    def _points_fit(self) -> Self:
        check_curve(self.speed_ms, self.s_per_s, "speed_ms", "s_per_s")
        return self


class CornerConfig(Section):
    """``[[corner]]``: one wheel brake.

    ``piston_area_m2`` is one piston; ``piston_count`` counts the pistons on
    one side of the disc, so equal clamp gives equal torque for a floating and
    a fixed caliper (Eq 4.1). ``thermal`` and ``cooling`` override single keys
    of the sections of that name for this corner.
    """

    name: CornerName
    type: Literal["disc", "drum"] = "disc"
    axle: Literal["front", "rear"] | None = None
    side: Literal["left", "right"] | None = None
    circuit: Literal["primary", "secondary"] = "primary"
    caliper: Literal["floating", "fixed"] = "floating"
    piston_area_m2: PistonArea
    piston_count: Annotated[int, Field(ge=1, le=6)] = 1
    effective_radius_m: Radius | None = None
    swept_inner_radius_m: Radius | None = None
    swept_outer_radius_m: Radius | None = None
    pressure_distribution: Literal["uniform-wear", "uniform-pressure"] = (
        "uniform-wear"
    )
    friction_coefficient: Positive = 0.38
    drum_brake_factor: Positive = 2.0
    efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    pushout_pressure_pa: NotNegative = 0.0
    disc: DiscConfig | None = None
    pad: PadConfig | None = None
    thermal: dict[str, Any] = {}
    cooling: dict[str, Any] = {}

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        has = self.disc is not None, self.pad is not None
        require(
            has == ((True, True) if self.type == "disc" else (False, False)),
            "a disc corner needs 'disc' and 'pad', a drum corner has neither",
        )
        radii = (self.swept_inner_radius_m, self.swept_outer_radius_m)
        if self.effective_radius_m is None:
            require(
                None not in radii,
                "needs 'effective_radius_m', or 'swept_inner_radius_m' and "
                "'swept_outer_radius_m'",
            )
        if radii[0] is not None and radii[1] is not None:
            require(
                radii[0] < radii[1],
                "'swept_inner_radius_m' must be below 'swept_outer_radius_m'",
            )
        axle, side = _place(self.name)
        require(
            self.axle in (None, axle) and self.side in (None, side),
            f"corner {self.name} is {axle} {side}: 'axle' or 'side' differ",
        )
        return self

    @model_validator(mode="after")
    def _pads_fit_on_disc(self) -> Self:
        if self.disc is not None and self.pad is not None:
            pad_m2, swept_m2 = self.pad.area_m2, self.disc.swept_area_m2
            require(
                2.0 * pad_m2 <= swept_m2,
                f"both pads, 2 x 'pad.area_m2' = {2.0 * pad_m2:g}, must be "
                f"at most 'disc.swept_area_m2' = {swept_m2:g}, both faces "
                "together",
            )
        return self


class EffectConfig(Section):
    """``[[effect]]``: one effect of the catalogue, for one corner or all."""

    name: Text
    corner: Literal["FL", "FR", "RL", "RR", "all"] = "all"
    parameters: dict[str, float] = {}
    provenance: dict[str, Any] = {}


class Config(Section):
    """A whole configuration file; its heat mode is never "auto"."""

    vehicle: VehicleConfig
    bus: list[BusConfig] = []
    signals: dict[str, SignalConfig]
    table: TableConfig | None = None
    corner: list[CornerConfig]
    thermal: ThermalConfig = ThermalConfig()
    cooling: CoolingConfig = CoolingConfig()
    accuracy: AccuracyConfig = AccuracyConfig()
    heat: HeatConfig = HeatConfig()
    fluid: FluidConfig = FluidConfig()
    wear: WearConfig = WearConfig()
    forecast: ForecastConfig = ForecastConfig()
    effect: list[EffectConfig] = []
    publish: PublishConfig = PublishConfig()
    advice: AdviceConfig = AdviceConfig()
    e2e: list[E2eConfig] = []
    state: StateConfig = StateConfig()
    daemon: DaemonConfig = DaemonConfig()
    record: RecordConfig = RecordConfig()
    metrics: MetricsConfig = MetricsConfig()

    @model_validator(mode="after")
    def _heat_mode_is_chosen(self) -> Self:
        if self.heat.mode == "auto":
            mode = automatic_mode(self.heat, self.corner, self.signals.keys())
            heat = self.heat.model_copy(update={"mode": mode})
            # a section is frozen once it is made, which it is not yet
            object.__setattr__(self, "heat", heat)
        return self

    def thermal_of(self, corner: CornerConfig) -> ThermalConfig:
        """Merge ``[thermal]`` with the overrides of *corner*."""
        return ThermalConfig(**{**self.thermal.model_dump(), **corner.thermal})

    def cooling_of(self, corner: CornerConfig) -> CoolingConfig:
        """Merge ``[cooling]`` with the overrides of *corner*."""
        return CoolingConfig(**{**self.cooling.model_dump(), **corner.cooling})

    def disc_corners(self) -> list[CornerConfig]:
        """List the corners that have a thermal model."""
        return [corner for corner in self.corner if corner.type == "disc"]
