"""Values of effects in a configuration, by ``<effect>.<parameter>``."""

from collections.abc import Collection, Mapping

from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.model.effects.catalogue import effect_class, effects_of


def split_key(name: str) -> tuple[str, str]:
    """Return section and key, or effect and parameter, of a dotted name."""
    first, _, rest = name.partition(".")
    return first, rest


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
    by_key = {split_key(name): value for name, value in values.items()}
    names = {effect for effect, _ in by_key}
    entries = [one for one in config.effect if one.name not in names]
    there = [one for one in effects_of(config) if one.name in names]
    for one in there:
        for corner in config.corner:
            if one.corner not in {"all", corner.name}:
                continue
            changed = dict(one.parameters)
            if corner.name in corners:
                changed |= {
                    parameter: _inside(effect, parameter, value)
                    for (effect, parameter), value in by_key.items()
                    if effect == one.name
                }
            elif one not in config.effect:
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


def _inside(effect: str, parameter: str, value: float) -> float:
    """Return *value* within the bounds of *parameter*.

    The exponential of a bound's logarithm may round to beyond it.
    """
    (own,) = (
        p for p in effect_class(effect).parameters() if p.name == parameter
    )
    return min(max(value, own.lower), own.upper)
