"""Identified values into a copy of the configuration, comments kept."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import FileAccessError, MissingExtraError
from bstm_daemon.files import replacing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import Config
    from bstm_daemon.identify.brakes import Brakes
    from bstm_daemon.identify.coastdown import CoastDown

_DIGITS: Final = 5
_PATHS: Final = (("state", "file"), ("record", "folder"), ("metrics", "file"))


@dataclass(frozen=True, slots=True)
class Change:
    """A key of ``[section]``, or of the ``[[corner]]`` of that name."""

    section: str
    key: str
    value: float
    corner: str = ""

    def __str__(self) -> str:
        """Return it as in the file."""
        where = (
            f"[[corner]] {self.corner}"
            if self.corner
            else (f"[{self.section}]")
        )
        return f"{where} {self.key} = {self.value:.{_DIGITS}g}"


def coast_down_changes(result: CoastDown) -> list[Change]:
    """Return the values that the runs settle."""
    return [
        Change("vehicle", one.name, one.value)
        for one in result.values
        if one.identified
    ]


def brake_changes(result: Brakes, config: Config) -> list[Change]:
    """Return what the stops settle, for every corner it is true of.

    A push-out below 0 is the sensor's zero and can not be configured.
    """
    changes = []
    for corner in config.corner:
        axle = result.front_scale
        if corner.name[0] == "R":
            axle = result.rear_scale
        scale = axle if axle.identified else result.scale
        key = "friction_coefficient"
        if corner.type == "drum":
            key = "drum_brake_factor"
        if scale.identified:
            value = getattr(corner, key) * scale.value
            changes.append(Change("corner", key, value, corner.name))
        if result.pushout_pa.identified:
            pushout = max(round(result.pushout_pa.value), 0)
            changes.append(
                Change("corner", "pushout_pressure_pa", pushout, corner.name)
            )
    if result.front_share.identified:
        changes.append(
            Change("vehicle", "front_share", result.front_share.value)
        )
    if result.lag_s.identified and result.lag_s.value > 0.0:
        changes += [
            Change("heat", f"{circuit}_lag_s", result.lag_s.value)
            for circuit in ("primary", "secondary")
        ]
    return changes


def write_changed(
    source: Path, target: Path, changes: Sequence[Change], origin: str
) -> None:
    """Write *source* with *changes* as *target*, whole or not at all.

    Everything else stays as it is, comments too; each changed line says
    *origin*. Paths are made relative to the new file's folder.

    Raises:
        MissingExtraError: tomlkit is not installed.
        FileAccessError: *source* is unreadable or *target* unwritable.
    """
    try:
        import tomlkit  # noqa: PLC0415  (of the extra identify)
    except ImportError as error:
        raise MissingExtraError(
            package="tomlkit", extra="identify", purpose="-o NEW.toml"
        ) from error
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error
    document = tomlkit.parse(text)
    for change in changes:
        _apply(document, change, origin)
    _move_paths(document, source.resolve().parent, target.resolve().parent)
    with replacing(target) as file:
        file.write_text(tomlkit.dumps(document), encoding="utf-8")


def _apply(document: Any, change: Change, origin: str) -> None:
    if change.corner:
        table = next(
            corner
            for corner in document["corner"]
            if corner["name"] == change.corner
        )
    else:
        if change.section not in document:
            document[change.section] = {}
        table = document[change.section]
    known = table.get(change.key)
    said = "" if known is None else known.trivia.comment.lstrip("# ")
    table[change.key] = float(f"{change.value:.{_DIGITS}g}")
    words = f"{origin}; was {known} ({said})" if said else origin
    if known is not None and not said:
        words = f"{origin}; was {known}"
    table[change.key].comment(words)


def _move_paths(document: Any, old: Path, new: Path) -> None:
    if old == new:
        return
    places = [(bus, "dbc") for bus in document.get("bus", [])]
    places += [
        (document[section], key)
        for section, key in _PATHS
        if section in document
    ]
    for table, key in places:
        path = table.get(key)
        if path is not None and not Path(str(path)).is_absolute():
            moved = os.path.relpath(old / str(path), new)
            table[key] = Path(moved).as_posix()
