"""Writes identified values into a commented copy of the configuration."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bstm_daemon.analysis.identify.brakes import Brakes
from bstm_daemon.analysis.identify.coastdown import CoastDown
from bstm_daemon.analysis.identify.cooling import AxleCooling
from bstm_daemon.analysis.identify.cooling_while_braking import BrakedAxle
from bstm_daemon.analysis.identify.value import Value
from bstm_daemon.config.csv_tables import csv_names, put_csv_tables
from bstm_daemon.config.estimates import (
    ChangeConfig,
    MatchedConfig,
    PriorsConfig,
)
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import FileAccessError, require_packages
from bstm_daemon.files import replacing
from bstm_daemon.model.effects.catalogue import effect_class, effects_of
from bstm_daemon.model.effects.entries.friction_pressure import REFERENCE_PA
from bstm_daemon.model.effects.entries.friction_speed import REFERENCE_MS

KNOWN: Final = 0.2
"""Largest relative standard error of a factor that is handed on."""

_DIGITS: Final = 5
_PATHS: Final = (("state", "file"), ("record", "folder"), ("metrics", "file"))


@dataclass(frozen=True, slots=True)
class Change:
    """A key of ``[section]``, or of the ``[[corner]]`` of that name.

    ``key`` may be dotted; several numbers are a list. ``note`` says where
    the value comes from if not from the logs. With ``effect`` it is a
    parameter of that ``[[effect]]``, for ``corner`` or all.
    """

    section: str
    key: str
    value: float | tuple[float, ...]
    corner: str = ""
    note: str = ""
    effect: str = ""

    def __str__(self) -> str:
        """Return it as in the file."""
        where = f"[{self.section}]"
        if self.effect:
            where = f"[[effect]] {self.effect} {self.corner}"
        elif self.corner:
            where = f"[[corner]] {self.corner}"
        several = isinstance(self.value, tuple)
        numbers = self.value if isinstance(self.value, tuple) else [self.value]
        text = ", ".join(f"{one:.{_DIGITS}g}" for one in numbers)
        return f"{where} {self.key} = {f'[{text}]' if several else text}"

    def rounded(self) -> float | list[float]:
        """Return the value in the digits that are written."""
        if isinstance(self.value, tuple):
            return [float(f"{one:.{_DIGITS}g}") for one in self.value]
        return float(f"{self.value:.{_DIGITS}g}")


@dataclass(frozen=True, slots=True)
class Entries:
    """Entries of ``[[effect]]``, ``[[change]]`` and ``[[matched]]``.

    Each takes the place of what is there for the same. ``priors`` make a
    file of a type: what one car was matched to, and its changes, go.
    """

    effects: Sequence[EffectConfig] = ()
    changes: Sequence[ChangeConfig] = ()
    matched: Sequence[MatchedConfig] = ()
    priors: Sequence[PriorsConfig] = ()


DEVIATION: Final = ", sd "
"""Before the standard deviation in a note."""

NO_ENTRIES: Final = Entries()


def coast_down_changes(result: CoastDown) -> list[Change]:
    """Return the values that the runs settle."""
    return [
        Change("vehicle", name, one.value)
        for name, one in result.values.items()
        if one.identified
    ]


def brake_changes(result: Brakes, config: Config) -> list[Change]:
    """Return what the stops settle, for every corner it is true of.

    A push-out below 0 is the sensor's zero and can not be configured. The
    friction is that at the means of the samples: what is written is divided
    by what the friction law makes of it there, the identified or the
    configured one.
    """
    changes = []
    means = result.samples.speed_mean_ms, result.samples.pressure_mean_pa
    leans = result.lean_speed, result.lean_pressure
    law = {
        name: _strength(name, one)
        for name, one in zip(REFERENCES, leans, strict=True)
        if one is not None and result.scale.identified
    }
    effects = [one for one in effects_of(config) if one.name not in law]
    effects += [
        EffectConfig(name=name, parameters={"strength": strength})
        for name, strength in law.items()
    ]
    pushout = max(round(result.pushout_pa.value), 0)
    for corner in config.corner:
        rear = corner.name[0] == "R"
        axle = result.rear_scale if rear else result.front_scale
        scale = axle if axle.identified else result.scale
        key = "friction_coefficient"
        if corner.type == "drum":
            key = "drum_brake_factor"
        if scale.identified:
            value = getattr(corner, key) * scale.value
            if corner.type != "drum":
                value /= _at_means(effects, corner.name, means)
            changes.append(Change("corner", key, value, corner.name))
        if result.pushout_pa.identified:
            key = "pushout_pressure_pa"
            changes.append(Change("corner", key, pushout, corner.name))
    if result.front_share.identified:
        share = result.front_share.value
        changes.append(Change("vehicle", "front_share", share))
    if result.lag_s.identified and result.lag_s.value > 0.0:
        changes += [
            Change("heat", f"{circuit}_lag_s", result.lag_s.value)
            for circuit in ("primary", "secondary")
        ]
    return changes + [
        Change("effect", "strength", strength, "all", "", name)
        for name, strength in law.items()
    ]


REFERENCES: Final = {
    "friction_speed": REFERENCE_MS,
    "friction_pressure": REFERENCE_PA,
}
"""Effects of the friction law, and where each is 1."""


def _strength(name: str, lean: Value) -> float:
    """Return the strength at which the effect *name* has that exponent."""
    bounds = effect_class(name).parameters()[0]
    wanted = -lean.value / effect_class(name)({}).scaled("exponent")
    return min(max(wanted, bounds.lower), bounds.upper)


def _at_means(
    effects: Sequence[EffectConfig], corner: str, means: tuple[float, float]
) -> float:
    """Return friction over its nominal value at mean speed and pressure."""
    found = 1.0
    for (name, reference), mean in zip(REFERENCES.items(), means, strict=True):
        for one in effects:
            if one.name == name and one.corner in {"all", corner}:
                effect = effect_class(name)(one.parameters)
                found *= (mean / reference) ** -effect.scaled("exponent")
    return found


def cooling_changes(
    axles: Sequence[AxleCooling | BrakedAxle], config: Config
) -> list[Change]:
    """Return the tables that the cool-downs settle.

    The front axle's goes to ``[cooling]``, which the other corners share;
    the rear's, and that of corners with an own table, to the corners.
    """
    changes = []
    for axle in axles:
        if not axle.table:
            continue
        values: dict[str, float | tuple[float, ...]] = {
            "speed_ms": tuple(speed for speed, *_ in axle.table),
            "s_per_s": tuple(s for _, s, _ in axle.table),
        }
        if axle.still is not None:
            values["standstill_convection_fraction"] = axle.still
        corners = [
            c for c in config.corner if c.name[0] == axle.axle[0].upper()
        ]
        if axle.axle == "rear" or any(
            set(values) & set(corner.cooling) for corner in corners
        ):
            changes += [
                Change("corner", f"cooling.{key}", value, corner.name)
                for corner in corners
                for key, value in values.items()
            ]
        else:
            changes += [
                Change("cooling", key, value) for key, value in values.items()
            ]
            changes += _held_tables(axles, config)
    return changes


def braked_changes(
    axles: Sequence[BrakedAxle], config: Config
) -> list[Change]:
    """Return the tables, and the factors that heat and resistances need.

    The factor on the heat goes to the mass of the discs, which it is one
    with; that on the resistances of the first axle to all three of them.
    """
    changes = cooling_changes(axles, config)
    for axle in axles:
        heat, error = axle.heat
        if axle.table and error < KNOWN * heat:
            key = "disc_mass_correction_factor"
            changes += [
                Change(
                    *("corner", f"thermal.{key}"),
                    getattr(config.thermal_of(corner), key) / heat,
                    corner.name,
                )
                for corner in config.corner
                if corner.name[0] == axle.axle[0].upper()
            ]
    resist, error = axles[0].resist
    if axles[0].table and error < KNOWN * resist:
        changes += [
            Change("vehicle", key, getattr(config.vehicle, key) * resist)
            for key in ("drag_area_m2", "friction_ns_m", "rolling_resistance")
        ]
    return changes


def _held_tables(
    axles: Sequence[AxleCooling | BrakedAxle], config: Config
) -> list[Change]:
    """Return what keeps the table of corners that have half of it their own.

    Speeds and S are one table: a corner with its own S goes on at the speeds
    it had.
    """
    measured = {axle.axle[0].upper() for axle in axles if axle.table}
    note = "as before, beside another [cooling]"
    changes = []
    for corner in config.corner:
        missing = {"speed_ms", "s_per_s"} - set(corner.cooling)
        if corner.name[0] not in measured and len(missing) == 1:
            (key,) = missing
            value = tuple(getattr(config.cooling_of(corner), key))
            changes.append(
                Change("corner", f"cooling.{key}", value, corner.name, note)
            )
    return changes


def write_changed(
    source: Path,
    target: Path,
    changes: Sequence[Change],
    origin: str,
    verdict: str = "",
    entries: Entries = NO_ENTRIES,
) -> None:
    """Write *source* with *changes* as *target*, whole or not at all.

    Everything else stays as it is, comments too; each changed line says
    *origin*, and the last one of the file *verdict*. Paths are made relative
    to the new file's folder.

    Raises:
        MissingExtraError: tomlkit is not installed.
        FileAccessError: *source* is unreadable or *target* unwritable.
    """
    with changed_copy(source, target) as document:
        for change in changes:
            table, key = _place(document, change)
            _set(table, key, change, change.note or origin)
        for effect in entries.effects:
            _put(_entries(document), effect)
        for one in entries.changes:
            _put(_entries(document, "change"), one)
        if entries.matched:
            _replace_matched(document, entries.matched)
        if entries.priors:
            for section in ("matched", "change", "priors"):
                document.pop(section, None)
            _add_tables(_entries(document, "priors"), entries.priors)
        if verdict:
            document.add(_tomlkit().comment(f"{origin}: {verdict}"))


def _place(document: Any, change: Change) -> tuple[Any, str]:
    """Return the table of *document* that holds *change*, and the key in it.

    A table that is not there is made.
    """
    if change.effect:
        entry = _entry(document, change.effect, change.corner)
        return entry["parameters"], change.key
    table = document
    *outer, key = change.key.split(".")
    if change.corner:
        table = next(
            corner
            for corner in document["corner"]
            if corner["name"] == change.corner
        )
    else:
        outer = [change.section, *outer]
    for name in outer:
        if name not in table:
            table[name] = {}
        table = table[name]
    return table, key


def _set(table: Any, key: str, change: Change, origin: str) -> None:
    """Set *key* of *table*; its comment says *origin* and what it was."""
    known = table.get(key)
    # an inline table has one comment, behind it
    inline = isinstance(table, _tomlkit().items.InlineTable)
    old = table if inline else known
    said = "" if old is None else old.trivia.comment.lstrip("# ")
    was = "typical" if change.effect else ""
    if known is not None:
        was = " ".join(str(known).split())
    table[key] = change.rounded()
    line = table if inline else table[key]
    of, _, deviation = origin.partition(DEVIATION)
    first, _, rest = said.partition("; was ")
    if inline and rest and first.partition(DEVIATION)[0] == of:
        # another value of the same line
        others, bracket, older = rest.partition(" (")
        sizes = f"{first}, {deviation}" if deviation else first
        line.comment(f"{sizes}; was {others}, {was}{bracket}{older}")
        return
    words = f"{origin}; was {was}" if was else origin
    line.comment(f"{words} ({said})" if said else words)


def _entry(document: Any, effect: str, corner: str) -> Any:
    """Return the entry of *effect* for *corner*, made where there is none."""
    entries = _entries(document)
    own = [one for one in entries if one["name"] == effect]
    for one in own:
        if one.get("corner", "all") == corner:
            break
    else:
        if own and own[0].get("corner", "all") == "all":
            _split(document, entries, own[0])
            return _entry(document, effect, corner)
        entries.append(_new_entry(effect, corner))
        one = entries[-1]
    if "parameters" not in one:
        one["parameters"] = _tomlkit().inline_table()
    return one


def _entries(document: Any, section: str = "effect") -> Any:
    """Return the list of ``[[section]]``, made where there is none."""
    if section not in document:
        document[section] = _tomlkit().aot()
    return document[section]


def _new_entry(effect: str, corner: str) -> Any:
    table = _tomlkit().table()
    table["name"] = effect
    if corner != "all":
        table["corner"] = corner
    return table


def _split(document: Any, entries: Any, whole: Any) -> None:
    """Let *whole*, of all corners, become one entry for each."""
    names = [str(corner["name"]) for corner in document["corner"]]
    for name in names[1:]:
        copy = deepcopy(whole)
        copy["corner"] = name
        entries.append(copy)
    whole["corner"] = names[0]


def _replace_matched(document: Any, matched: Sequence[MatchedConfig]) -> None:
    """Let *matched* be what is known of their corners, a row a line."""
    tomlkit = _tomlkit()
    corners = {name for one in matched for name in one.corners}
    entries = [
        one
        for one in document.pop("matched", [])
        if corners.isdisjoint(one["corners"])
    ]
    written = tomlkit.aot()
    for one in entries:
        written.append(one)
    _add_tables(written, matched)
    document["matched"] = written


def _add_tables(
    written: Any, tables: Sequence[MatchedConfig | PriorsConfig]
) -> None:
    """Add *tables* to the list *written*, long lists with an item a line."""
    tomlkit = _tomlkit()
    for one in tables:
        table = tomlkit.table()
        for key, value in one.model_dump().items():
            many = isinstance(value, list) and key != "corners"
            table[key] = tomlkit.item(value)
            if many:
                table[key].multiline(multiline=True)
        written.append(table)


def _put(entries: Any, one: EffectConfig | ChangeConfig) -> None:
    """Add *one* to *entries*, in the place of its namesake."""
    table = _new_entry(one.name, one.corner)
    if isinstance(one, ChangeConfig):
        table["factor"] = float(f"{one.factor:.{_DIGITS}g}")
    else:
        table["parameters"] = _tomlkit().inline_table()
        for name, value in one.parameters.items():
            table["parameters"][name] = float(f"{value:.{_DIGITS}g}")
    table["provenance"] = _tomlkit().inline_table()
    table["provenance"].update(one.provenance)
    for place, other in enumerate(entries):
        corner = other.get("corner", "all")
        if other["name"] == one.name and corner == one.corner:
            entries[place] = table
            return
    entries.append(table)


@contextmanager
def changed_copy(source: Path, target: Path) -> Iterator[Any]:
    """Give *source* as a tomlkit document to change; it becomes *target*.

    Whole or not at all. Paths are made relative to the new file's folder,
    tables of CSV files are written out.

    Raises:
        MissingExtraError: tomlkit is not installed.
        FileAccessError: *source* is unreadable or *target* unwritable.
    """
    parse, dumps = _tomlkit().parse, _tomlkit().dumps
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error
    document = parse(text)
    # what was matched stays what it was, whatever becomes of the file
    names = csv_names(document)
    put_csv_tables(document, source.parent)
    yield document
    if names:
        document.add(_tomlkit().comment(f"tables of {', '.join(names)}"))
    _move_paths(document, source.resolve().parent, target.resolve().parent)
    with replacing(target) as file:
        file.write_text(dumps(document), encoding="utf-8")


def _tomlkit() -> Any:
    """Return tomlkit, which is of the extra ``identify``."""
    require_packages("tomlkit", extra="identify", purpose="-o NEW.toml")
    import tomlkit  # noqa: PLC0415

    return tomlkit


def _move_paths(document: Any, old: Path, new: Path) -> None:
    """Make relative paths of *document*, of folder *old*, right in *new*."""
    if old == new:
        return
    places = [(bus, "dbc") for bus in document.get("bus", [])]
    places += [(document.get(section, {}), key) for section, key in _PATHS]
    for table, key in places:
        path = table.get(key)
        if path is not None and not Path(str(path)).is_absolute():
            moved = os.path.relpath(old / str(path), new)
            table[key] = Path(moved).as_posix()
