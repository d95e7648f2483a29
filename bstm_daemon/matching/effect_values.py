"""Parameters of effects as values of one corner: read, and changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bstm_daemon.config import EffectConfig
from bstm_daemon.effects.catalogue import effect_class, effects_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from bstm_daemon.config import Config


def split_key(name: str) -> tuple[str, str]:
    """Return effect and parameter of ``<effect>.<parameter>``."""
    effect, parameter = name.split(".", maxsplit=1)
    return effect, parameter


def effect_value(config: Config, corner: str, name: str) -> float:
    """Return ``<effect>.<parameter>`` of *corner*; 0 without the effect."""
    effect, parameter = split_key(name)
    for one in effects_of(config):
        if one.name == effect and one.corner in {"all", corner}:
            typical = {
                p.name: p.typical for p in effect_class(effect).parameters()
            }
            if one.parameters.get("strength", 1.0) == 0.0:
                return 0.0
            return float(one.parameters.get(parameter, typical[parameter]))
    return 0.0


def with_effect_values(
    config: Config, corners: Collection[str], values: Mapping[str, float]
) -> Config:
    """Return *config* with *values* by ``<effect>.<parameter>``.

    The effects of *corners* get entries of their own; what others have, by
    an entry for all of them too, stays.
    """
    names = {split_key(name)[0] for name in values}
    entries = [one for one in config.effect if one.name not in names]
    there = [one for one in effects_of(config) if one.name in names]
    for one in there:
        for corner in config.corner:
            if one.corner not in {"all", corner.name}:
                continue
            changed = dict(one.parameters)
            if corner.name in corners:
                changed |= {
                    parameter: value
                    for name, value in values.items()
                    for effect, parameter in (split_key(name),)
                    if effect == one.name
                }
            elif one.corner != "all" and one not in config.effect:
                # the structure's own, unchanged
                continue
            entries.append(
                EffectConfig(
                    name=one.name,
                    corner=corner.name,
                    parameters=changed,
                    provenance=one.provenance,
                )
            )
    return config.model_copy(update={"effect": entries})


def effects_by_corner(config: Config, corner: str) -> dict[str, object]:
    """Return the parameters of each effect of *corner*, by its name."""
    return {
        one.name: dict(one.parameters)
        for one in effects_of(config)
        if one.corner in {"all", corner}
    }
