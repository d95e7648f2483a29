"""The configuration file as pydantic models, one vehicle a file.

Every quantity is SI with its unit in the key; temperatures are degC where a
key ends in ``_c``. :mod:`bstm_daemon.config.reading` reads a file into these
models and words the problems. ``docs/reference.md`` lists every key.
"""

import codecs
from datetime import date
from typing import Annotated, Any, Final, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from bstm_daemon.config import estimates, service
from bstm_daemon.config.heat import HeatConfig, automatic_mode
from bstm_daemon.config.section import (
    Curve,
    Fraction,
    NotNegative,
    Positive,
    Section,
    Text,
    require,
    with_piston_area,
)
from bstm_daemon.config.thermal import CoolingConfig, ThermalConfig
from bstm_daemon.units import KELVIN_OFFSET

# upper bounds beyond any road vehicle: they find mm, cm2 and mm2 in an SI key
Radius = Annotated[float, Field(gt=0, le=0.5)]
PistonArea = Annotated[float, Field(gt=0, le=0.02)]
PistonDiameter = Annotated[float, Field(gt=0, le=159)]
DiscArea = Annotated[float, Field(gt=0, le=1)]
DiscMass = Annotated[float, Field(gt=0, le=100)]
PadArea = Annotated[float, Field(gt=0, le=0.05)]
PadThickness = Annotated[float, Field(gt=0, le=0.05)]
CornerName = Literal["FL", "FR", "RL", "RR"]


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
    """name of the vehicle in results and state"""
    mass_kg: Annotated[float, Field(ge=100, le=60_000)]
    """mass as driven, load included"""
    wheel_radius_m: Annotated[float, Field(ge=0.1, le=1)]
    """rolling radius"""
    wheel_inertia_kg_m2: NotNegative = 3.0
    """inertia of all wheels and brake discs together (Eq 4.6)"""
    drag_area_m2: NotNegative = 0.7
    """drag coefficient times frontal area, Cd A (Eq 4.2)"""
    friction_ns_m: NotNegative = 4.0
    """speed-proportional friction C_fric (Eq 4.2)"""
    rolling_resistance: NotNegative = 0.014
    """rolling resistance coefficient f_r (Eq 4.2)"""
    front_share: Fraction = 0.7
    """share of the brake force at the front axle; Feed-Back splits by it"""
    ambient_c: Annotated[float, Field(ge=-60, le=70)] = 20.0
    """air temperature until the role `ambient_temperature` has a value; a
    silent bus keeps its last"""

    @property
    def ambient_k(self) -> float:
        """``ambient_c`` [K]."""
        return self.ambient_c + KELVIN_OFFSET


class BusConfig(Section):
    """``[[bus]]``: one CAN bus and the DBC that describes it."""

    name: Text
    """name that signals refer to"""
    dbc: Text
    """DBC file, relative to the configuration's folder"""
    interface: Text = "socketcan"
    """python-can interface"""
    channel: Text = "can0"
    """channel of the interface; also the interface name in logs"""
    ignored_interfaces: list[Text] = []
    """interfaces of logs without a DBC; a `[[bus]]` with `name` and `ignore =
    true` adds its name"""
    bitrate: Annotated[int, Field(gt=0)] | None = None
    """bit/s; SocketCAN links are set up outside"""
    fd: bool = False
    """open the channel for CAN FD"""
    strict: bool = True
    """refuse a DBC with defects, see below"""
    encoding: str = "cp1252"
    """text encoding of the DBC, unless a byte order mark tells"""

    def _check(self) -> None:
        try:
            codecs.lookup(self.encoding)
        except LookupError as error:
            msg = f"no text encoding is called 'encoding' = {self.encoding!r}"
            raise ValueError(msg) from error


class SignalConfig(Section):
    """``[signals.<role>]``: where a role comes from.

    A signal or an expression of a message, or a column of a table.
    ``si = (value * scale + offset) * sign`` in ``unit``, then to SI. ``min``
    and ``max`` are limits in ``unit``; a value outside is not a sample.
    """

    message: str | None = None
    """DBC message that carries the value"""
    signal: str | None = None
    """DBC signal; or `expression`"""
    expression: str | None = None
    """`+ - * / ( )`, numbers, `abs min max` and signals of `message`"""
    column: Text | None = None
    """column of a signal table, or the name in its column `name`"""
    bus: str | None = None
    """a `[[bus]]`; without it the first"""
    unit: str
    """unit of the scaled value (see Units), whatever the DBC says"""
    sign: Literal[1, -1] = 1
    """-1 turns the direction"""
    scale: float = 1.0
    """factor on the DBC's physical value; not 0"""
    offset: float = 0.0
    """added after `scale`, in `unit`"""
    timeout_s: Positive | None = None
    """how long a value counts as present; without it the role's own"""
    depth_m: Annotated[float, Field(ge=0, le=0.05)] | None = None
    """of a thermocouple in a disc or a pad's front: depth below the friction
    face, for `bstm match` and `bstm gap`"""
    min: float | None = None
    """below it, in `unit`, a value is no sample"""
    max: float | None = None
    """above it, in `unit`, a value is no sample"""

    def _check(self) -> None:
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


class TableConfig(Section):
    """``[table]``: where a signal table (CSV, Parquet, ...) has its time.

    A table in the long format has one value a row: ``name`` is the column
    with the name of the signal, ``value`` the one with its value.
    """

    time: Text | None = None
    """column with the time"""
    time_unit: Literal["s", "ms", "us", "iso8601", "hhmmss"] | None = None
    """`hhmmss`: a time of day; without it found from the column, and logged"""
    rate_hz: Positive | None = None
    """rows a second, for a table without a time column"""
    delimiter: Text | None = None
    """one character between the cells of a CSV table; without it found from
    the header"""
    name: Text | None = None
    """long format: column with the name of the signal"""
    value: Text | None = None
    """long format: column with the value"""

    def _check(self) -> None:
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


class DiscConfig(Section):
    """``corner.disc``: geometry and material of the disc.

    ``mass_kg`` is the mass that takes part in heating (the ring),
    ``swept_area_m2`` both friction faces, ``total_area_m2`` what radiates.
    ``heat_capacity_exponent`` says how much of its material's rise of the
    heat capacity over that at 20 degC it has: 1 all, 0 none.
    """

    model: str = "lumped"
    """`lumped`, or `module:function` of your own"""
    mass_kg: DiscMass
    """mass that takes part in heating: the ring"""
    swept_area_m2: DiscArea
    """swept ring, both faces together; at least the two pads' area"""
    total_area_m2: DiscArea
    """area that radiates, also under the pads; at least the swept ring"""
    material: Literal["grey-iron", "grey-iron-smooth", "pure-iron", "own"] = (
        "grey-iron"
    )
    """heat capacity over temperature: built-in curves, with the peak near 750
    °C or smooth, or `own`"""
    heat_capacity_j_kgk: Curve | None = None
    """for `material = "own"`: `{temperature_c = [...], value = [...]}` or
    `{csv = "FILE"}`"""
    heat_capacity_exponent: Annotated[float, Field(ge=0, le=2)] = 1.0
    """share of that curve's rise above 20 °C; 0: constant capacity"""
    conductivity_w_mk: Positive = 50.0
    """for the heat partition (Eq 2.3)"""
    density_kg_m3: Positive = 7200.0
    """for the heat partition (Eq 2.3) and the mass of what is worn"""
    worn_m: Annotated[float, Field(ge=0, le=0.01)] = 0.0
    """thickness lost, both faces, when `mass_kg` was weighed; a changed number
    is a new measurement ([wear.md](wear.md))"""
    effusivity_heat_capacity_j_kgk: Positive = 460.0
    """for the heat partition (Eq 2.3)"""

    def _check(self) -> None:
        own = self.material == "own"
        require(
            own == (self.heat_capacity_j_kgk is not None),
            "'heat_capacity_j_kgk' goes with material \"own\" and only there",
        )
        require(
            self.swept_area_m2 <= self.total_area_m2,
            f"'swept_area_m2' = {self.swept_area_m2:g} must be at most "
            f"'total_area_m2' = {self.total_area_m2:g}, which it is a part of",
        )


class PadConfig(Section):
    """``corner.pad``: one of the two equal pads of a corner."""

    model: str = "slabs"
    """`slabs`, or `module:function` of your own"""
    area_m2: PadArea
    """one pad's friction face"""
    thickness_m: PadThickness
    """remaining lining; a changed number is a new measurement
    ([wear.md](wear.md))"""
    new_thickness_m: PadThickness | None = None
    """lining of new pads; without it `thickness_m`"""
    measured: date | None = None
    """day on which `thickness_m` was measured; a changed day is a new
    measurement"""
    slabs: Annotated[int, Field(ge=1, le=60)] = 10
    """layers through the lining (Eq 4.15 to 4.17)"""
    surface_cells: Literal["half", "full"] = "half"
    """cells at the surfaces; the thesis has full ones"""
    density_kg_m3: Positive = 2300.0
    """lining"""
    heat_capacity_j_kgk: LiningHeatCapacity = 1000.0
    """lining; a curve over temperature stays within the same bounds"""
    conductivity_w_mk: LiningConductivity = 1.2
    """lining; a curve over temperature stays within the same bounds"""

    def _check(self) -> None:
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
        new_m = self.new_thickness_m
        require(
            new_m is None or self.thickness_m <= new_m,
            f"'thickness_m' = {self.thickness_m:g}, the remaining lining, "
            f"must be at most 'new_thickness_m' = {new_m or 0.0:g}",
        )


class CornerConfig(Section):
    """``[[corner]]``: one wheel brake.

    ``piston_area_m2`` is one piston; ``piston_count`` counts the pistons on
    one side of the disc, so equal clamp gives equal torque for a floating and
    a fixed caliper (Eq 4.1). ``thermal`` and ``cooling`` override single keys
    of the sections of that name for this corner.
    """

    name: CornerName
    """front or rear, left or right"""
    type: Literal["disc", "drum"] = "disc"
    """a drum gets brake power but no temperatures"""
    axle: Literal["front", "rear"] | None = None
    """may repeat what `name` says"""
    side: Literal["left", "right"] | None = None
    """may repeat what `name` says"""
    circuit: Literal["primary", "secondary"] = "primary"
    """hydraulic circuit; `secondary` uses `secondary_pressure` where mapped"""
    caliper: Literal["floating", "fixed"] = "floating"
    """information only; `piston_count` decides"""
    piston_area_m2: PistonArea
    """one piston (mean if they differ); or its diameter"""
    piston_diameter_mm: PistonDiameter | None = None
    """one piston, as cast on the caliper, instead of its area"""
    piston_count: Annotated[int, Field(ge=1, le=6)] = 1
    """pistons on one side of the disc"""
    effective_radius_m: Radius | None = None
    """radius at which friction acts, unless the swept radii are given"""
    swept_inner_radius_m: Radius | None = None
    """inner radius of the swept ring"""
    swept_outer_radius_m: Radius | None = None
    """outer radius of the swept ring; greater than the inner"""
    pressure_distribution: Literal["uniform-wear", "uniform-pressure"] = (
        "uniform-wear"
    )
    """gives the effective radius from the swept radii"""
    friction_coefficient: Positive = 0.38
    """pad on disc (Eq 4.1)"""
    drum_brake_factor: Positive = 2.0
    """C*, shoe friction over spreading force; drum only"""
    efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    """hydraulic to clamp force"""
    pushout_pressure_pa: NotNegative = 0.0
    """pressure at which the pads begin to press"""
    disc: DiscConfig | None = None
    """see below; disc corners only"""
    pad: PadConfig | None = None
    """see below; disc corners only"""
    thermal: dict[str, Any] = {}
    """keys of `[thermal]` for this corner, `thermal.disc_emissivity = 0.6`"""
    cooling: dict[str, Any] = {}
    """keys of `[cooling]` for this corner"""

    _area = model_validator(mode="before")(with_piston_area)

    def _check(self) -> None:
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
        axle = "front" if self.name[0] == "F" else "rear"
        side = "left" if self.name[1] == "L" else "right"
        require(
            self.axle in (None, axle) and self.side in (None, side),
            f"corner {self.name} is {axle} {side}: 'axle' or 'side' differ",
        )
        if self.disc is not None and self.pad is not None:
            pad_m2, swept_m2 = self.pad.area_m2, self.disc.swept_area_m2
            require(
                2.0 * pad_m2 <= swept_m2,
                f"2 pads x 'pad.area_m2' = {2.0 * pad_m2:g}, must be at most "
                f"'disc.swept_area_m2' = {swept_m2:g}, both faces together",
            )


class EffectConfig(Section):
    """``[[effect]]``: one effect of the catalogue, for one corner or all."""

    name: Text
    """effect in the catalogue"""
    corner: Literal["FL", "FR", "RL", "RR", "all"] = "all"
    """one corner, or all"""
    parameters: dict[str, float] = {}
    """numbers of the effect, `strength` among them (1 = typical)"""
    provenance: dict[str, Any] = {}
    """source of the values; kept, not used"""


class Config(Section):
    """A whole configuration file; its heat mode is never "auto"."""

    vehicle: VehicleConfig
    bus: list[BusConfig] = []
    signals: dict[str, SignalConfig]
    table: TableConfig | None = None
    corner: list[CornerConfig]
    thermal: ThermalConfig = ThermalConfig()
    cooling: CoolingConfig = CoolingConfig()
    accuracy: estimates.AccuracyConfig = estimates.AccuracyConfig()
    matched: list[estimates.MatchedConfig] = []
    priors: list[estimates.PriorsConfig] = []
    heat: HeatConfig = HeatConfig()
    fluid: estimates.FluidConfig = estimates.FluidConfig()
    wear: estimates.WearConfig = estimates.WearConfig()
    forecast: estimates.ForecastConfig = estimates.ForecastConfig()
    effect: list[EffectConfig] = []
    change: list[estimates.ChangeConfig] = []
    publish: service.PublishConfig = service.PublishConfig()
    advice: estimates.AdviceConfig = estimates.AdviceConfig()
    e2e: list[service.E2eConfig] = []
    state: service.StateConfig = service.StateConfig()
    daemon: service.DaemonConfig = service.DaemonConfig()
    record: service.RecordConfig = service.RecordConfig()
    metrics: service.MetricsConfig = service.MetricsConfig()
    feed: service.FeedConfig = service.FeedConfig()

    @property
    def publishing_bus(self) -> int:
        """The number of the bus that frames are sent on, where they are."""
        name = self.publish.bus
        return 0 if name is None else [b.name for b in self.bus].index(name)

    def _check(self) -> None:
        if self.heat.mode == "auto":
            mode = automatic_mode(self.heat, self.corner, self.signals.keys())
            heat = self.heat.model_copy(update={"mode": mode})
            # a section is frozen once it is made, which it is not yet
            object.__setattr__(self, "heat", heat)

    def thermal_of(self, corner: CornerConfig) -> ThermalConfig:
        """Merge ``[thermal]`` with the overrides of *corner*."""
        given = self.thermal.model_dump(exclude_unset=True)
        return ThermalConfig(**{**given, **corner.thermal})

    def cooling_of(self, corner: CornerConfig) -> CoolingConfig:
        """Merge ``[cooling]`` with the overrides of *corner*."""
        return CoolingConfig(**{**self.cooling.model_dump(), **corner.cooling})

    def matched_of(self, corner: str) -> estimates.MatchedConfig | None:
        """Return what the match of *corner* learned, None without one."""
        return next(
            (one for one in self.matched if corner in one.corners), None
        )

    def uncertainty_of(self, corner: str) -> float:
        """Return the factor on what is unknown of the model of *corner*."""
        if (given := self.forecast.uncertainty) is not None:
            return given
        one = self.source_of(corner)
        if one is None or not one.knows_fluid:
            return estimates.UNMATCHED
        return 1.0 if corner in one.corners else estimates.ALIKE

    def source_of(self, corner: str) -> estimates.MatchedConfig | None:
        """Return the match of *corner*, else of one alike, None without."""
        return self.matched_of(corner) or next(
            (one for one in self.matched if corner in one.alike), None
        )

    def disc_corners(self) -> list[CornerConfig]:
        """List the corners that have a thermal model."""
        return [corner for corner in self.corner if corner.type == "disc"]
