"""Effects that were found into a copy of the configuration, comments kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.identify.config_copy import changed_copy

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.config import EffectConfig

_DIGITS: Final = 5


def adopt(source: Path, target: Path, effects: Sequence[EffectConfig]) -> None:
    """Write *source* with *effects* as *target*, whole or not at all.

    An entry takes the place of its namesake for the same corner; everything
    else stays as it is. Paths are made relative to the new file's folder.

    Raises:
        MissingExtraError: tomlkit is not installed.
        FileAccessError: *source* is unreadable or *target* unwritable.
    """
    with changed_copy(source, target) as document:
        import tomlkit  # noqa: PLC0415  (of the extra identify)

        if "effect" not in document:
            document["effect"] = tomlkit.aot()
        for effect in effects:
            _put(document["effect"], effect)


def _put(entries: Any, effect: EffectConfig) -> None:
    """Add *effect* to *entries*, in the place of its namesake."""
    import tomlkit  # noqa: PLC0415  (as above)

    table = tomlkit.table()
    table["name"] = effect.name
    if effect.corner != "all":
        table["corner"] = effect.corner
    table["parameters"] = tomlkit.inline_table()
    for name, value in effect.parameters.items():
        table["parameters"][name] = float(f"{value:.{_DIGITS}g}")
    table["provenance"] = tomlkit.inline_table()
    for name, said in effect.provenance.items():
        table["provenance"][name] = said
    for place, one in enumerate(entries):
        corner = one.get("corner", "all")
        if one["name"] == effect.name and corner == effect.corner:
            entries[place] = table
            return
    entries.append(table)
