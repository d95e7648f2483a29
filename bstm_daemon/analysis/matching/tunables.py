"""What matching may change: keys of the configuration, bounds and priors.

Bounds are physical, not statistical: outside them a lumped model may still
fit, with values that no brake has. A prior is log-normal around the
configured value; it says how far a brake of the same design may lie from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.analysis.matching.effect_values import (
    effect_value,
    split_key,
    with_effect_values,
)
from bstm_daemon.model.effects.catalogue import (
    effect_class,
    effect_names,
)
from bstm_daemon.model.thermal.brake_corner import cooling_beyond, corner_spec

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.config.sections import Config, CornerConfig

SLOW: Final = "cooling.s_per_s at 36 km/h"
MIDDLE: Final = "cooling.s_per_s at 70 km/h"
FAST: Final = "cooling.s_per_s at 150 km/h"
S_SPEEDS_MS: Final = {SLOW: 10.0, MIDDLE: 19.44, FAST: 41.67}
"""The S-table is matched by factors at three speeds, linear between them,
constant outside; at standstill the fraction stands for it."""

BEYOND_MS: Final = {
    "cooling.s_per_s at 230 km/h": 63.89,
    "cooling.s_per_s at 320 km/h": 88.89,
}
"""Further ones, for cars that are driven there."""

NODES_MS: Final = S_SPEEDS_MS | BEYOND_MS

LEVEL: Final = "cooling.s_per_s"
"""A factor on the whole table, where it is only a guess."""

DRAG: Final = "vehicle.drag_area_m2"
MASS: Final = "thermal.disc_mass_correction_factor"
PARTITION: Final = "thermal.heat_partition_correction_factor"
WIND: Final = "thermal.fluid_dynamic_convection_exponent"
VIEW: Final = "thermal.disc_view_factor"
STILL: Final = "cooling.standstill_convection_fraction"

SIDES: Final = {
    f"{MASS}, right over left": (MASS,),
    f"{LEVEL}, right over left": tuple(NODES_MS),
}
"""Factors on values of right corners, where discs alone are measured: brakes
that are alike on paper differ by a tenth in friction and in the air they
get."""

EFFECT: Final = "effect"
"""Section of the keys ``effect.<name>.<parameter>``."""

STRENGTHS: Final = {
    # what seals roll back: 0.1 to 0.5 mm
    "gap_conduction": (0.05, 5.0, 0.4),
    # the free faces and the rim's openings are known, vents radiate besides
    "disc_radiation_driving": (0.05, 1.5, 0.15),
    "local_air": (0.05, 5.0, 0.4),
    "disc_hat": (0.05, 5.0, 0.3),
    # contact of steel clips, or ears pressed on with grease
    "bracket_conduction": (0.05, 10.0, 0.4),
    # the bridge alone, or all of the inside of a large caliper
    "disc_caliper_radiation": (0.05, 10.0, 0.3),
    "caliper_fluid_split": (0.05, 5.0, 0.3),
}
"""Bounds and prior of the strengths of the structure ``extended``: what its
typical parameters, from a drawing and handbooks, leave open of a path."""

FREEDOM: Final = {"disc_caliper_radiation": 10.0}
"""Degrees of freedom of priors that are Student's t: calipers of one design
are alike, and those of another see ten times as much of the disc."""

ANY: Final = (0.05, 5.0, 0.5)
"""Of any other effect's strength."""

CONTACT: Final = "contact_conductance"
CONDUCTANCE: Final = f"{EFFECT}.{CONTACT}.conductance_w_m2k"
"""The effect whose conductance is matched instead of its strength: what cars
have differs tenfold."""

BRACKET_LOSS: Final = f"{EFFECT}.bracket_conduction.loss_w_k"
AIR_AT_REST: Final = f"{EFFECT}.local_air.parked_w_k"
IN_BORE: Final = f"{EFFECT}.caliper_fluid_split.fluid_capacity_j_k"
TO_CALIPER: Final = f"{EFFECT}.caliper_fluid_split.coupling_w_k"

LINING: Final = ("pad.conductivity_w_mk", "pad.heat_capacity_j_kgk")
"""Refined beside a contact that conducts: together they say how deep the heat
goes."""

MADE_IN_PADS: Final = (0.5, 0.8)
"""Largest share of the friction heat that the pads' side of the contact makes,
and the prior of the factor that sets it, where the contact conducts: Eq 2.3
holds for faces of equal temperature. Faces apart divide the heat by where it
is made, up to evenly, and the contact conducts the rest back (Barber, The
conduction of heat from sliding solids, 1970)."""


FADE_STRENGTH: Final = "friction_fade.strength"
FADE: Final = f"{EFFECT}.{FADE_STRENGTH}"
"""The only tunable effect that acts on the heat: an axle whose linings fade
leaves a larger share of it to the other one."""


def strength_key(effect: str) -> str:
    """Return the key of the strength of *effect*."""
    return f"{EFFECT}.{effect}.strength"


INSIDE: Final = 1e-12
"""What an exponential of a logarithm may be off by."""


@dataclass(frozen=True, slots=True)
class Tunable:
    """A value of one corner's configuration.

    ``key`` is ``section.name``, where the section is ``effect`` the name is
    ``<effect>.<parameter>``; ``prior`` is the standard deviation of its
    logarithm, the scale where a finite ``freedom`` makes it Student's t;
    ``table_4_1`` is whether the thesis tunes it.
    """

    key: str
    lower: float
    upper: float
    prior: float
    unit: str
    table_4_1: bool = False
    freedom: float = inf

    def bounds(self) -> tuple[float, float]:
        """Return the bounds of the logarithm; its exponential is inside."""
        return log(self.lower * (1.0 + INSIDE)), log(
            self.upper * (1.0 - INSIDE)
        )


TUNABLES: Final[dict[str, Tunable]] = {
    one.key: one
    for one in (
        Tunable(MASS, 0.7, 1.5, 0.08, "-", True),
        Tunable(PARTITION, 0.3, 3, 0.15, "-", True),
        Tunable("thermal.disc_emissivity", 0.15, 1.0, 0.2, "-", True),
        # a shield hides one face, a wheel the other; fins add to the area
        Tunable(VIEW, 0.1, 1.5, 0.2, "-"),
        Tunable("thermal.pad_emissivity", 0.5, 1.0, 0.15, "-", True),
        Tunable(
            "thermal.pad_backplate_thermal_resistance_m2k_w",
            *(5e-4, 2e-2, 0.25, "m2K/W", True),
        ),
        Tunable(
            "thermal.pad_dynamic_convection_ws_m3k",
            *(0.05, 30.0, 0.5, "Ws/(m3 K)", True),
        ),
        Tunable(
            "thermal.fluid_static_convection_w_k", 0.1, 8, 0.3, "W/K", True
        ),
        Tunable(
            "thermal.fluid_caliper_thermal_capacity_j_k",
            *(400.0, 8000.0, 0.15, "J/K", True),
        ),
        Tunable(
            "thermal.fluid_dynamic_convection_ws_mk",
            *(0.003, 2.0, 0.5, "Ws/(m K)", True),
        ),
        # 0.6 to 0.8 about bodies in a wind (Hilpert 1933)
        Tunable(WIND, 0.4, 1.6, 0.2, "-"),
        *(Tunable(key, 0.3, 3.0, 0.2, "factor") for key in S_SPEEDS_MS),
        *(Tunable(key, 0.3, 3.0, 0.2, "factor") for key in BEYOND_MS),
        Tunable(LEVEL, 0.03, 30.0, 1.5, "factor"),
        *(Tunable(key, 0.5, 2.0, 0.1, "factor") for key in SIDES),
        Tunable(DRAG, 0.1, 30.0, 1.0, "m2"),
        Tunable(STILL, 0.05, 1.0, 0.3, "-"),
        Tunable("thermal.hot_pad_factor", 0.3, 1.0, 0.2, "-"),
        Tunable(
            "thermal.backplate_thermal_capacity_j_k", 50, 1500, 0.2, "J/K"
        ),
        Tunable("thermal.pad_static_loss_w_k", 0.01, 3.0, 0.5, "W/K"),
        Tunable("thermal.gap_conductance_w_m2k", 5.0, 400.0, 0.4, "W/(m2 K)"),
        Tunable("pad.conductivity_w_mk", 0.5, 5.0, 0.15, "W/(m K)"),
        # linings have 800 to 1300; a lump that stands for one may store less
        Tunable("pad.heat_capacity_j_kgk", 600.0, 1300.0, 0.08, "J/(kg K)"),
        *(
            Tunable(
                strength_key(name),
                least,
                min(most, effect_class(name).most_strength),
                deviation,
                "x typical",
                freedom=FREEDOM.get(name, inf),
            )
            for name in effect_names()
            for least, most, deviation in [STRENGTHS.get(name, ANY)]
            if effect_class(name).kind == "thermal" and name != CONTACT
        ),
        # rough faces: 1e3 to 1e4 W/m2K are known, and a tenth of it
        Tunable(CONDUCTANCE, 10.0, 2e4, 1.2, "W/(m2 K)"),
        # linings of one market lose from none to half of mu when they are hot
        Tunable(FADE, 0.05, 2.5, 0.7, "x typical"),
        # what rises through the rim's openings
        Tunable(AIR_AT_REST, 1.0, 100.0, 0.5, "W/K"),
        # to the wind, and to the knuckle, which is warm
        Tunable(BRACKET_LOSS, 0.05, 10.0, 0.7, "W/K"),
        # from fluid alone to steel pistons with the walls of their bores
        Tunable(IN_BORE, 20.0, 2000.0, 0.7, "J/K"),
        # a bore that its piston all but fills, or a film on a bare one
        Tunable(TO_CALIPER, 2.0, 500.0, 0.7, "W/K"),
    )
}
"""Every tunable by its key."""

GUESSED: Final = {
    MASS: (0.02, 20.0, 1.0),
    **dict.fromkeys(NODES_MS, (0.1, 10.0, 0.3)),
    **{
        key: (one.lower, one.upper, 1.2)
        for key, one in TUNABLES.items()
        if key.startswith(f"{EFFECT}.")
    },
}
"""Bounds and prior of what nobody has measured: the disc of a race car weighs
a quarter of the typical one, and what is wrong of mass, share, friction and
capacity comes out as this mass. An effect that a search named begins at the
strength beside values that had hidden it."""

TABLE_4_1: Final = tuple(k for k, one in TUNABLES.items() if one.table_4_1)
"""The thesis's own."""

COOLING: Final = (
    *S_SPEEDS_MS,
    STILL,
    "thermal.fluid_static_convection_w_k",
    "thermal.fluid_dynamic_convection_ws_mk",
)
"""What another rim changes: the air at disc and caliper."""

REFINED: Final = (
    *(key for key in TABLE_4_1 if key != "thermal.pad_emissivity"),
    *S_SPEEDS_MS,
    STILL,
)
"""What the joint refinement changes. Of the two emissivities only their
combination shows between disc and pad, and the disc's shows elsewhere too."""


SAME: Final = 1e-3
"""Relative difference from which a value is another one than was written."""


@dataclass(frozen=True, slots=True)
class Target:
    """Corners that are matched together: alike in everything but the side.

    Their configuration is that of ``corner``, the first of them; ``guessed``
    are the tunables whose values in it nobody has measured; ``linings`` are
    the corners with linings like theirs, themselves if it is empty; ``alike``
    are corners like them without a thermocouple.
    """

    config: Config
    corners: tuple[str, ...]
    guessed: frozenset[str] = frozenset()
    linings: tuple[str, ...] = ()
    alike: tuple[str, ...] = ()

    @property
    def corner(self) -> CornerConfig:
        """The configuration of the first corner."""
        return next(
            one for one in self.config.corner if one.name == self.corners[0]
        )

    def value(self, tunable: Tunable) -> float:
        """Return what *tunable* is now; factors on a table are 1."""
        corner = self.corner
        if tunable.key in {*NODES_MS, LEVEL, *SIDES}:
            return 1.0
        section, name = split_key(tunable.key)
        if section == EFFECT:
            return effect_value(self.config, corner.name, name)
        holders: dict[str, Any] = {
            "thermal": self.config.thermal_of(corner),
            "cooling": self.config.cooling_of(corner),
            "pad": corner.pad,
            "vehicle": self.config.vehicle,
        }
        value = getattr(holders[section], name)
        # a curve over temperature is not one number
        return float(value) if isinstance(value, int | float) else 0.0

    def setting(self, key: str) -> float:
        """Return the value of *key*; of a table its S at the speed."""
        if key in NODES_MS or key == LEVEL:
            table = self.config.cooling_of(self.corner)
            speed_ms = NODES_MS.get(key, S_SPEEDS_MS[MIDDLE])
            return float(np.interp(speed_ms, table.speed_ms, table.s_per_s))
        return self.value(TUNABLES[key])

    def tunable(self, key: str) -> Tunable:
        """Return the tunable *key* with the bounds and prior it has here."""
        one = TUNABLES[key]
        if key == PARTITION and self.value(TUNABLES[CONDUCTANCE]) > 0.0:
            most, prior = MADE_IN_PADS
            alike = 1.0 - corner_spec(self.config, self.corner).disc_share
            upper = max(one.upper, most / alike)
            one = replace(one, upper=upper, prior=prior)
        if key in self.guessed and key in GUESSED:
            lower, upper, prior = GUESSED[key]
            return replace(one, lower=lower, upper=upper, prior=prior)
        for known in self.config.priors:
            if self.corners[0] in known.corners and key in known.names:
                i = known.names.index(key)
                if abs(self.setting(key) / known.values[i] - 1.0) < SAME:
                    return replace(one, prior=known.deviations[i])
        return one

    def of(self, corner: str) -> Target:
        """Return *corner* alone."""
        return replace(self, corners=(corner,))

    def with_cooling_form(self, form: str) -> Target:
        """Return the target with another ``cooling.form``."""
        return self._each(
            lambda one: one.model_copy(
                update={"cooling": {**one.cooling, "form": form}}
            )
        )

    def with_disc(self, **values: float) -> Target:
        """Return the target with *values* of its discs."""
        return self._each(
            lambda one: one.model_copy(
                update={
                    "disc": one.disc and one.disc.model_copy(update=values)
                }
            )
        )

    def changed(self, values: dict[str, float]) -> Target:
        """Return the target with *values* by key."""
        prefix = f"{EFFECT}."
        own = {k: v for k, v in values.items() if not k.startswith(prefix)}
        target = self._each(lambda one: self._changed(one, own))
        if DRAG in own:
            vehicle = self.config.vehicle.model_copy(
                update={"drag_area_m2": own.pop(DRAG)}
            )
            config = target.config.model_copy(update={"vehicle": vehicle})
            target = replace(target, config=config)
        of_effects = {
            key.removeprefix(prefix): value
            for key, value in values.items()
            if key.startswith(prefix)
        }
        if not of_effects:
            return target
        config = target.config
        if FADE_STRENGTH in of_effects:
            fade = {FADE_STRENGTH: of_effects.pop(FADE_STRENGTH)}
            linings = self.linings or self.corners
            config = with_effect_values(config, linings, fade)
        config = with_effect_values(config, self.corners, of_effects)
        return replace(target, config=config)

    def _each(self, change: Callable[[CornerConfig], CornerConfig]) -> Target:
        """Return the target with *change* in each of its corners."""
        corners = [
            change(one) if one.name in self.corners else one
            for one in self.config.corner
        ]
        config = self.config.model_copy(update={"corner": corners})
        return replace(self, config=config)

    def _changed(
        self, corner: CornerConfig, values: dict[str, float]
    ) -> CornerConfig:
        parts: dict[str, dict[str, Any]] = {
            "thermal": dict(corner.thermal),
            "cooling": dict(corner.cooling),
            "pad": {},
        }
        values = of_side(values, corner.name)
        for key, value in values.items():
            if key not in {*NODES_MS, LEVEL, DRAG}:
                section, name = split_key(key)
                parts[section][name] = value
        if {*NODES_MS, LEVEL} & values.keys():
            cooling = self.config.cooling_of(corner)
            keys = [k for k in NODES_MS if k in S_SPEEDS_MS or k in values]
            speeds = [NODES_MS[key] for key in keys]
            more = [one for one in speeds if one > cooling.speed_ms[-1]]
            points = cooling.speed_ms + more
            if more:
                parts["cooling"]["speed_ms"] = points
            factors = [values.get(key, 1.0) for key in keys]
            at = np.interp(points, speeds, factors) * values.get(LEVEL, 1.0)
            x, y = cooling.speed_ms, cooling.s_per_s
            beyond = [cooling_beyond(x, y, speed) for speed in more]
            parts["cooling"]["s_per_s"] = (at * (y + beyond)).tolist()
        pad = corner.pad and corner.pad.model_copy(update=parts["pad"])
        return corner.model_copy(update={**parts, "pad": pad})


def of_side(values: Mapping[str, float], corner: str) -> dict[str, float]:
    """Return *values* as those of *corner* alone."""
    found = {key: one for key, one in values.items() if key not in SIDES}
    if corner.endswith("R"):
        for factor, keys in SIDES.items():
            for key in found.keys() & set(keys):
                found[key] *= values.get(factor, 1.0)
    return found


def refined_keys(target: Target) -> tuple[str, ...]:
    """Return what the joint refinement changes of *target*.

    :data:`REFINED`, and the strengths of the thermal effects that its
    structure and its ``[[effect]]`` entries have; of ``extended`` also the
    power of the wind at the caliper, and the disc's view factor, as its
    emissivity shows at the pads too; with a contact :data:`LINING`. Effects
    on heat act before the model, in the pass over samples: of them
    :data:`FADE` is refined where the drives were read for it.
    """
    prefix = f"{EFFECT}."
    strengths = (
        key
        for key, one in TUNABLES.items()
        if key.startswith(prefix) and key != FADE and target.value(one) > 0.0
    )
    thermal = target.config.thermal_of(target.corner)
    free = (WIND, VIEW) if thermal.structure == "extended" else ()
    contact = target.value(TUNABLES[CONDUCTANCE]) > 0.0
    return (*REFINED, *free, *(LINING if contact else ()), *strengths)


def usable(target: Target, keys: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return which of *keys* can be matched, and why the others can not."""
    found = [key for key in keys if target.value(TUNABLES[key]) > 0.0]
    return found, [
        f"{key} is 0 or a curve: it stays as it is"
        for key in keys
        if key not in found
    ]
