"""``bstm check``: every problem of a configuration at once, or its summary.

With ``--log`` the signals of a recording are judged as well.
"""

import argparse
from pathlib import Path
from typing import Any, Final

from bstm_daemon.analysis.quality.collisions import count_own_frames
from bstm_daemon.analysis.quality.finding import Quality
from bstm_daemon.analysis.quality.judge import judge
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.bus.signals.dbc import read_dbc
from bstm_daemon.bus.signals.signal_map import compile_signal_map
from bstm_daemon.cli.arguments import add_config, check_targets, option, shared
from bstm_daemon.cli.log_command import names_of, write_pages
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config, naming_file, read_draft
from bstm_daemon.config.rules import Draft, usable_e2e, usable_signals
from bstm_daemon.config.sections import Config, CornerConfig, SignalConfig
from bstm_daemon.config.wording import toml_text
from bstm_daemon.errors import ConfigError, UsageError, hint
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.verified import verification_table
from bstm_daemon.model.effects.catalogue import STRUCTURES
from bstm_daemon.model.effects.catalogue import (
    problems_of as problems_of_effects,
)
from bstm_daemon.report.check import quality_json, quality_page, quality_text
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.text import table
from bstm_daemon.roles import ROLE_INDEX, ROLES

VERIFIED_HEAD: Final = ("input", "corners", "verified by")

_ANY_RADIUS_M = 0.3
"""Wheel radius for finding DBC problems if ``[vehicle]`` has none; not in any
result."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``CONFIG``, the logs and where results go."""
    what = "configuration to check (TOML)"
    option(parser, "configuration CONFIG", what, Path, nargs="?")
    add_config(parser, "the same as CONFIG")
    what = (
        "check the signals of this log as well; may be repeated for the parts "
        "of one recording"
    )
    option(parser, "--log LOG", what, Path, action="append", default=[])
    shared(parser, "map", "json", "report", "figures")


def run(args: argparse.Namespace) -> int:
    """Print the summary; raise ConfigError with all problems, if any.

    With logs the result is 1 where one is not usable.
    """
    if (args.configuration is None) == (args.config is None):
        msg = "check needs one configuration: bstm check CONFIG"
        raise UsageError(msg)
    if (args.report or args.figures or args.map) and not args.log:
        msg = "--report, --figures and --map need --log LOG"
        raise UsageError(msg)
    path: Path = args.configuration or args.config
    check_targets((args.json, args.report), (path, *(args.log or ())))
    problems = problems_of(path)
    result: dict[str, Any] = {"file": str(path), "problems": problems}
    config = None if problems else load_config(path)
    usable = True
    lines: list[str] = []
    if config is not None:
        warnings = dbc_warnings(config, path.parent)
        result["warnings"] = warnings
        result["configuration"] = config.model_dump(mode="json")
        if args.log:
            quality, lines = _judged(args, path)
            usable = quality.usable
            files = [str(log) for log in args.log]
            result["log"] = {"files": files, **quality_json(quality)}
        else:
            lines = [summary(config, path)]
            result["verified_by"] = [
                dict(zip(VERIFIED_HEAD, row, strict=True))
                for row in verification_table(config, config.signals)
            ]
        if warnings:
            lines += ["", *(f"warning: {warning}" for warning in warnings)]
    if args.json:
        write_json(args.json, result)
    if config is None:
        raise ConfigError(problems)
    print("\n".join(lines))
    return 0 if usable else 1


def _judged(args: argparse.Namespace, path: Path) -> tuple[Quality, list[str]]:
    """Judge ``args.log`` for the configuration *path*, in lines as well.

    Writes ``args.report`` where it is given.

    Raises:
        LogError: a log cannot be used, or holds none of the wanted ids.
        FileAccessError: a log cannot be read, the report not be written.
        MissingExtraError: a report without plotly or jinja2.
    """
    config, signal_map = load_vehicle(path, quiet=True)
    overrides = dict(args.map)
    with Progress("check") as progress:
        recording = read_recording(
            args.log, signal_map, overrides, progress.show
        )
    own_frames = count_own_frames(
        args.log, recording, config, signal_map, overrides
    )
    quality = judge(recording, config, signal_map, own_frames)
    names = names_of(args.log)
    lines = [f"{names}  ({config.vehicle.id}, {path})", quality_text(quality)]
    lines += [
        f"{log}: cut short, its end is missing" for log in recording.truncated
    ]
    title = f"Signal quality: {names}"
    subtitle = f"{config.vehicle.id} · {path.name}"
    lines += write_pages(
        args, lambda: quality_page(quality, title=title, subtitle=subtitle)
    )
    return quality, lines


def problems_of(path: Path) -> list[str]:
    """List every problem of the configuration *path*, one line each.

    The file itself, its DBC files and its effects are all looked at, whatever
    is wrong with the others; if nothing is, the model is built as well.

    Raises:
        FileAccessError: The file is missing or unreadable.

    """
    try:
        with naming_file(path):
            draft, problems = read_draft(path)
    except ConfigError as error:
        return error.problems
    problems += _dbc_problems(draft, path.parent)
    problems += problems_of_effects(draft.effect)
    lines = [f"{path}: {problem}" for problem in problems]
    return lines or _model_problems(path)


def _dbc_problems(draft: Draft, folder: Path) -> list[str]:
    if not draft.bus:
        return []
    radius_m = draft.vehicle.wheel_radius_m if draft.vehicle else _ANY_RADIUS_M
    signals, e2e = usable_signals(draft), usable_e2e(draft)
    try:
        compile_signal_map(draft.bus, signals, folder, radius_m, e2e=e2e)
    except ConfigError as error:
        return error.problems
    return []


def dbc_warnings(config: Config, folder: Path) -> list[str]:
    """List what is overlooked in the buses of *config*, a line each.

    DBC paths are relative to *folder*. The driver of an interface may be on
    another computer than the one that checks.
    """
    from can import VALID_INTERFACES as KNOWN  # noqa: PLC0415  (slow)

    return [
        f"[[bus]] {bus.name} interface = {toml_text(bus.interface)}: not "
        f"known here, {hint(bus.interface, KNOWN, 'see python-can')}"
        for bus in config.bus
        if bus.interface not in KNOWN
    ] + [
        f"[[bus]] {bus.name} {bus.dbc}: {defect}"
        for bus in config.bus
        for defect in read_dbc(
            folder / bus.dbc, strict=bus.strict, encoding=bus.encoding
        ).warnings
    ]


def _model_problems(path: Path) -> list[str]:
    try:
        config, _ = load_vehicle(path, quiet=True)
    except ConfigError as error:
        return error.problems
    problems = []
    for corner in config.disc_corners():
        try:
            with naming_file(path):
                compile_corner(config, corner)
        except ConfigError as error:
            problems += error.problems
    return problems


def summary(config: Config, path: Path) -> str:
    """Word what the valid *config* of the file *path* makes the model do."""
    vehicle = config.vehicle
    facts = [
        ("vehicle", f"{vehicle.id}, {vehicle.mass_kg:g} kg"),
        ("heat", _heat(config)),
        ("effects", _effects(config)),
        ("fluid", _fluid(config)),
        ("publish", _publish(config)),
    ]
    buses = [
        (
            bus.name,
            bus.interface,
            bus.channel,
            f"{bus.bitrate or '-'}",
            bus.dbc,
        )
        for bus in config.bus
    ]
    signals = [_signal(*item, config) for item in config.signals.items()]
    corners = [_corner(corner) for corner in config.corner]
    blocks = [
        table(facts[0], facts[1:]),
        table(("bus", "interface", "channel", "bitrate", "DBC"), buses),
        table(("role", "source", "unit", "timeout"), signals),
        table(
            ("corner", "type", "circuit", "piston", "disc", "pads"), corners
        ),
        table(VERIFIED_HEAD, verification_table(config, config.signals)),
    ]
    head = f"{path}: no problems"
    return "\n\n".join([head, *("\n".join(block) for block in blocks)])


def _heat(config: Config) -> str:
    heat = config.heat
    if heat.mode == "ff":
        return "ff, from brake pressure and friction"
    if heat.mode == "measured":
        return "measured, the disc temperature is an input"
    way = (
        "fused, pressure and motion, the vehicle learned"
        if heat.mode == "fused"
        else "fb, from the vehicle's motion"
    )
    torque = heat.assume_powertrain_torque_nm
    if "powertrain_torque" in config.signals or torque is None:
        assumed = ""
    else:
        assumed = f"; ASSUMED: powertrain torque {torque:g} Nm at the wheels"
    is_flat = (
        heat.slope == "flat"
        or "acceleration_longitudinal" not in config.signals
    )
    road = "; the road is assumed flat" if is_flat else ""
    return f"{way}{assumed}{road}"


def _effects(config: Config) -> str:
    structure = config.thermal.structure
    shipped = len(STRUCTURES[structure])
    count = f" ({shipped} effects)" if shipped else ""
    own = [
        f"{one.name} ({one.corner}, "
        f"strength {one.parameters.get('strength', 1.0):g})"
        for one in config.effect
    ]
    return ", ".join([f"structure {structure}{count}", *own])


def _fluid(config: Config) -> str:
    fluid = config.fluid
    percent = fluid.water_percent
    water = "" if percent is None else f", {percent:g} % water"
    changed = "" if fluid.changed is None else f", changed {fluid.changed}"
    return f"{fluid.grade}{changed}{water}"


def _publish(config: Config) -> str:
    publish = config.publish
    if not publish.enabled:
        return "listen only, nothing is sent"
    bus = config.bus[config.publishing_bus]
    return f"on {bus.name} from id 0x{publish.id_base:X}"


def _signal(
    role: str, signal: SignalConfig, config: Config
) -> tuple[str, ...]:
    if signal.column is not None:
        source = f"column {signal.column}"
    else:
        value = signal.signal or f"({signal.expression})"
        source = f"{signal.message}.{value}"
    if len(config.bus) > 1 and signal.column is None:
        source = f"{signal.bus or config.bus[0].name}: {source}"
    timeout_s = signal.timeout_s or ROLES[ROLE_INDEX[role]].timeout_s
    return role, source, signal.unit, f"{timeout_s:g} s"


def _corner(corner: CornerConfig) -> tuple[str, ...]:
    disc, pad = corner.disc, corner.pad
    return (
        corner.name,
        corner.type,
        corner.circuit,
        f"{corner.piston_count} x {corner.piston_area_m2 * 1e4:.1f} cm2",
        f"{disc.mass_kg:g} kg {disc.material}" if disc else "-",
        f"{pad.thickness_m * 1e3:g} mm, {pad.slabs} slabs" if pad else "-",
    )
