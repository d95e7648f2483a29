"""The catalogue of effects: found by name, checked, applied."""

from __future__ import annotations

from difflib import get_close_matches
from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from bstm_daemon.effects import entries
from bstm_daemon.effects.effect import CornerModel, Effect

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import EffectConfig


def effect_names() -> tuple[str, ...]:
    """Names of all effects, in alphabetical order."""
    return tuple(
        sorted(module.name for module in iter_modules(entries.__path__))
    )


def effect_class(name: str) -> type[Effect]:
    """Return the class of the effect *name*; its file bears its name.

    Raises:
        KeyError: no such effect.
    """
    if name not in effect_names():
        raise KeyError(name)
    module = import_module(f"{entries.__name__}.{name}")
    for candidate in vars(module).values():
        if (
            isinstance(candidate, type)
            and issubclass(candidate, Effect)
            and not isabstract(candidate)
            and candidate.name == name
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
            near = get_close_matches(effect.name, effect_names(), 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            found.append(
                f"[[effect]] name = {effect.name!r}: {hint}"
                f"known effects: {', '.join(effect_names())}"
            )
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
    return found


def apply_effects(
    model: CornerModel, effects: Sequence[EffectConfig]
) -> CornerModel:
    """Apply those of *effects* that concern the model's corner, in order."""
    for effect in effects:
        if effect.corner in ("all", model.spec.name):
            cls = effect_class(effect.name)
            model = cls(effect.parameters).apply(model)
    return model
