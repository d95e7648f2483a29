"""Values of the car that may have changed since it was matched.

Beside the effects that the model may lack, its own values are candidates, as
``_data/changes.toml`` has them: one by one, and together where one cause moves
several. A strength is the logarithm of the factor over :data:`STEP`.
"""

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.tunables import EFFECT
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.model.effects.catalogue import effect_class, effects_of
from bstm_daemon.model.effects.composed import PREFIX as COMPOSED
from bstm_daemon.model.effects.composed import is_composed
from bstm_daemon.model.effects.effect import STRENGTH

PREFIX: Final = "change."
"""Of the names of these candidates."""

HEAT_SCALE: Final = "heat scale"
"""Key of the tunable that scales all brake power: friction as a whole."""

STEP: Final = 0.7
"""Logarithm of a value's factor that counts as strength 1, either way."""

HEAT_STEP: Final = 0.2
"""Of the heat: friction differs by less than conductances do."""

MANIFOLD: Final = 4.0
"""Factor of a value from which no percentage is said."""

LARGEST: Final = 4.0
"""Strength of a candidate beyond which it is none, but something else, unless
physics has another end."""

LARGEST_OF_PATH: Final = 6.0
"""Of a path that the model has: there may be little of it, and what the
effect can be at most ends its change."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What can change, and the likely causes of less and of more of it.

    ``vanishes`` is whether it can fall to nothing.
    """

    what: str
    less: str
    more: str
    keys: tuple[str, ...]
    vanishes: bool


KINDS: Final[dict[str, Kind]] = {
    name: Kind(
        *(one["what"], one["less"], one["more"]),
        tuple(one.get("keys", (name,))),
        one.get("vanishes", name.startswith(EFFECT)),
    )
    for name, one in tomllib.loads(
        (Path(__file__).parent / "_data" / "changes.toml").read_text("utf-8")
    ).items()
}
"""By name, without :data:`PREFIX`."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A candidate: ``direction`` (p,) in the logarithms for strength 1.

    Or the ``effects`` on the heat that the model has, by corner, and whose
    strengths are others.
    """

    name: str
    direction: Column
    effects: tuple[EffectConfig, ...] = ()

    def effects_at(self, strength: float) -> list[EffectConfig]:
        """Return the effects with a change of *strength*, if it is one.

        At their bound where that is beyond what physics allows.
        """
        found = []
        for one in self.effects:
            bounds = effect_class(one.name).parameters()[0]
            value = strength_of(one) * np.exp(STEP * strength)
            value = np.clip(value, bounds.lower, bounds.upper)
            parameters = {**one.parameters, "strength": float(value)}
            found.append(one.model_copy(update={"parameters": parameters}))
        return found


def change_names() -> list[str]:
    """Return the names of all changes."""
    return [PREFIX + kind for kind in KINDS]


def is_change(name: str) -> bool:
    """Whether the candidate *name* is a change, not an effect."""
    return name.startswith(PREFIX)


def is_listed(name: str) -> bool:
    """Whether the candidate *name* is an effect of the catalogue."""
    return not is_change(name) and not is_composed(name)


def of_sensor(name: str) -> bool:
    """Whether the candidate *name* is of what a sensor reads."""
    return is_listed(name) and effect_class(name).kind == "measurement"


def either_sign(name: str) -> bool:
    """Whether the candidate *name* can have either sign.

    That of a composed term is in its size.
    """
    return is_change(name) or (
        is_listed(name) and effect_class(name).either_sign
    )


def can_vanish(name: str) -> bool:
    """Whether what the candidate *name* is a change of can be nothing."""
    return is_change(name) and KINDS[name.removeprefix(PREFIX)].vanishes


def are_twins(a: str, b: str) -> bool:
    """Whether one of two candidates declares the other as its twin.

    A change of an effect's strength has the twins of the effect.
    """
    a, b = _effect_of(a) or a, _effect_of(b) or b
    return any(
        is_listed(one) and other in effect_class(one).twins
        for one, other in ((a, b), (b, a))
    )


def largest(name: str) -> float:
    """Return the largest strength that the candidate *name* can have."""
    if not is_listed(name):
        own = is_change(name) and path_of(name)
        return LARGEST_OF_PATH if own else LARGEST
    most = effect_class(name).most_strength
    return LARGEST if most == STRENGTH.upper else most


def path_of(name: str) -> str:
    """Return the heat path whose strength the change *name* is of, or ""."""
    effect = _effect_of(name)
    thermal = effect and effect_class(effect).kind == "thermal"
    return effect if thermal else ""


def _effect_of(name: str) -> str:
    """Return the effect whose strength the change *name* is of, or ""."""
    section, _, key = name.removeprefix(PREFIX).partition(".")
    effect, _, parameter = key.partition(".")
    of_strength = section == EFFECT and parameter == STRENGTH.name
    return effect if of_strength else ""


def forms_of(
    name: str, fitted: Collection[str] = ()
) -> tuple[Mapping[str, float], ...]:
    """Return the other forms of the candidate *name*, whose values they are.

    A change of a path that the model has may be in one as well, except for
    what is *fitted*, a tunable.
    """
    effect = path_of(name) if is_change(name) else name
    if not effect:
        return ()
    forms = (
        {
            key: value
            for key, value in form.items()
            if f"{EFFECT}.{effect}.{key}" not in fitted
        }
        for form in effect_class(effect).forms
    )
    return tuple(form for form in forms if form)


def trials(config: Config, keys: Sequence[str]) -> dict[str, Trial]:
    """Return every change of a model with the tunables *keys*, by name."""
    groups = {
        name: tuple(key for key in kind.keys if key in keys)
        for name, kind in KINDS.items()
    }
    if config.heat.mode != "ff":
        # motion heats whatever friction is
        groups.pop("brake_heat")
    found: dict[str, Trial] = {}
    for name, own in groups.items():
        direction = np.array([step_of(key) * (key in own) for key in keys])
        if own and not any(
            np.array_equal(direction, one.direction) for one in found.values()
        ):
            found[PREFIX + name] = Trial(PREFIX + name, direction)
    on_heat: dict[str, list[EffectConfig]] = {}
    for effect in effects_of(config):
        if effect_class(effect.name).kind == "heat" and strength_of(effect):
            on_heat.setdefault(effect.name, []).append(effect)
    for of, effects in on_heat.items():
        name = f"{PREFIX}{EFFECT}.{of}.strength"
        found[name] = Trial(name, np.zeros(len(keys)), tuple(effects))
    return found


def strength_of(effect: EffectConfig) -> float:
    """Return the strength of *effect*, 1 where it is not configured."""
    return effect.parameters.get("strength", 1.0)


def step_of(key: str) -> float:
    """Return the change of the logarithm of *key* at strength 1."""
    return HEAT_STEP if key == HEAT_SCALE else STEP


def factor_of(name: str, strength: float) -> float:
    """Return the factor that a change of *strength* is."""
    kind = KINDS[name.removeprefix(PREFIX)]
    return float(np.exp(step_of(kind.keys[0]) * strength))


def said_percent(name: str, strength: float) -> str:
    """Return the change *name* of *strength* in percent, or so-manyfold."""
    factor = factor_of(name, strength)
    if factor >= MANIFOLD:
        return f"{factor:.0f}-fold"
    return f"{100.0 * (factor - 1.0):+.0f} %"


def name_of(name: str) -> str:
    """Return what the candidate *name* is called, of a change in words."""
    if not is_change(name):
        return name.removeprefix(COMPOSED)
    return KINDS[name.removeprefix(PREFIX)].what


def said(name: str, strength: float, *, cause: bool = True) -> str:
    """Return the change *name* of *strength* in plain words."""
    percent = said_percent(name, strength)
    text = f"{name_of(name)} {percent} since the match"
    if not cause:
        return text
    kind = KINDS[name.removeprefix(PREFIX)]
    return f"{text}: {kind.less if strength < 0.0 else kind.more}?"
