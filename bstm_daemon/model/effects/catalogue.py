"""The catalogue of effects: found by name, checked, applied."""

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Final

from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import hint
from bstm_daemon.model.effects import entries
from bstm_daemon.model.effects.composed import NAME as COMPOSED
from bstm_daemon.model.effects.composed import Composed
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, InputModel

STRUCTURES: Final[dict[str, tuple[str, ...]]] = {
    "thesis": (),
    "extended": (
        *("friction_fade", "friction_speed", "friction_pressure"),
        *("gap_conduction", "disc_radiation_driving", "local_air"),
        *("disc_hat", "bracket_conduction", "disc_caliper_radiation"),
        *("caliper_fluid_split", "contact_conductance"),
    ),
}
"""The effects of each ``[thermal] structure``, at strength 1 all round."""


@cache
def effect_names() -> tuple[str, ...]:
    """Names of all effects, in alphabetical order."""
    return tuple(
        sorted(module.name for module in iter_modules(entries.__path__))
    )


@cache
def effect_class(name: str) -> type[Effect]:
    """Return the class of the effect *name*; its file bears its name.

    Beside the catalogue's there is ``composed``.

    Raises:
        KeyError: no such effect.
    """
    if name == COMPOSED:
        return Composed
    if name not in effect_names():
        raise KeyError(name)
    module = import_module(f"{entries.__name__}.{name}")
    for candidate in vars(module).values():
        if (
            isinstance(candidate, type)
            and issubclass(candidate, Effect)
            and candidate.__module__ == module.__name__
        ):
            return candidate
    raise KeyError(name)


def problems_of(effects: Sequence[EffectConfig]) -> list[str]:
    """What is wrong with the ``[[effect]]`` entries, a line each."""
    found = []
    seen: set[tuple[str, str]] = set()
    for effect in effects:
        where = f"[[effect]] {effect.name}"
        try:
            cls = effect_class(effect.name)
        except KeyError:
            known = hint(
                effect.name, effect_names(), "docs/effects.md lists them"
            )
            found.append(f"[[effect]] name = {effect.name!r}: {known}")
            continue
        found += [
            f"{where} {text}" for text in cls.problems(effect.parameters)
        ]
        for name, corner in sorted(seen):
            if name == effect.name and (
                "all" in (corner, effect.corner) or corner == effect.corner
            ):
                found.append(f"{where}: given twice for corner {corner}")
                break
        seen.add((effect.name, effect.corner))
        if cls.whole_car and effect.corner != "all":
            found.append(
                f'{where} corner = "{effect.corner}": acts on the whole car, '
                "leave 'corner' out"
            )
    return found


def effects_of(config: Config) -> list[EffectConfig]:
    """Effects of the configured structure, then those of ``[[effect]]``.

    An entry of the file takes the place of the structure's for its corners,
    so a strength of 0 switches it off there.
    """
    given = {(one.name, one.corner) for one in config.effect}
    found = [
        EffectConfig(name=name, corner=corner.name)
        for corner in config.corner
        for name in STRUCTURES[config.thermal_of(corner).structure]
        if given.isdisjoint({(name, "all"), (name, corner.name)})
    ]
    return found + list(config.effect)


def apply_effects(
    model: CornerModel, effects: Sequence[EffectConfig]
) -> CornerModel:
    """Apply those of *effects* that concern the model's corner.

    In order of their stages, and within a stage as given.
    """
    for effect in _staged(effects):
        if effect.corner in {"all", model.spec.name}:
            cls = effect_class(effect.name)
            model = cls(effect.parameters).apply(model)
    return model


def edited_inputs(config: Config) -> InputModel:
    """Return the inputs of the brake power, with the effects of *config*."""
    inputs = InputModel(config)
    for effect in _staged(effects_of(config)):
        cls = effect_class(effect.name)
        whole = cls.whole_car
        for corner in (None,) if whole else tuple(config.corner):
            if corner is None or effect.corner in {"all", corner.name}:
                inputs = cls(effect.parameters).apply_to_inputs(inputs, corner)
    return inputs


def _staged(effects: Sequence[EffectConfig]) -> list[EffectConfig]:
    return sorted(effects, key=lambda one: effect_class(one.name).stage)
