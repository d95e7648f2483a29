"""``bstm check``: every problem of a configuration at once, or its summary.

With ``--log`` the signals of a recording are judged as well, see
:mod:`bstm_daemon.cli.check_log`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bstm_daemon.cli.arguments import (
    add_bus_map,
    add_config,
    add_json,
    add_report,
    check_targets,
)
from bstm_daemon.cli.check_log import check_logs
from bstm_daemon.config.reading import load_config, naming_file, read_draft
from bstm_daemon.config.rules import usable_e2e, usable_signals
from bstm_daemon.errors import ConfigError, UsageError
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.text import columns
from bstm_daemon.roles import ROLE_INDEX, ROLES

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from bstm_daemon.config.rules import Draft
    from bstm_daemon.config.sections import Config, CornerConfig, SignalConfig

_ANY_RADIUS_M = 0.3
"""Finds DBC problems when [vehicle] has none to give; enters no result."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``CONFIG``, the logs and where results go."""
    parser.add_argument(
        "configuration",
        nargs="?",
        type=Path,
        metavar="CONFIG",
        help="configuration to check (TOML)",
    )
    add_config(parser, "the same as CONFIG", required=False)
    parser.add_argument(
        "--log",
        type=Path,
        action="append",
        default=[],
        metavar="LOG",
        help="judge the signals of this log as well; may be repeated for the "
        "parts of one recording",
    )
    add_bus_map(parser)
    add_json(parser)
    add_report(parser)


def run(args: argparse.Namespace) -> int:
    """Print the summary; raise ConfigError with all problems, if any.

    With logs the result is 1 where one is not usable.
    """
    if (args.configuration is None) == (args.config is None):
        msg = "check needs one configuration: bstm check CONFIG"
        raise UsageError(msg)
    if (args.report or args.map) and not args.log:
        msg = "--report and --map go with --log LOG"
        raise UsageError(msg)
    path: Path = args.configuration or args.config
    check_targets((args.json, args.report), (path, *(args.log or ())))
    problems = problems_of(path)
    config = None if problems else load_config(path)
    warnings = dbc_warnings(config, path.parent) if config else []
    checked = None
    if config is not None and args.log:
        checked = check_logs(args, path)
    if args.json:
        result: dict[str, Any] = {"file": str(path), "problems": problems}
        if config is not None:
            result["warnings"] = warnings
            result["configuration"] = config.model_dump(mode="json")
        if checked is not None:
            result["log"] = checked.data
        write_json(args.json, result)
    if config is None:
        raise ConfigError(problems)
    print(summary(config, path) if checked is None else checked.text)
    for number, warning in enumerate(warnings):
        print(f"{'' if number else chr(10)}warning: {warning}")
    return 0 if checked is None or checked.usable else 1


def problems_of(path: Path) -> list[str]:
    """List every problem of the configuration *path*, one line each.

    The file itself, its DBC files and its effects are all looked at, whatever
    is wrong with the others; if nothing is, the model is built as well.

    Raises:
        FileAccessError: The file is missing or unreadable.

    """
    from bstm_daemon.model.effects.catalogue import (  # noqa: PLC0415
        problems_of as problems_of_effects,
    )

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
    from bstm_daemon.bus.signals.signal_map import compile_signal_map  # noqa: PLC0415

    if not draft.bus:
        return []
    radius_m = draft.vehicle.wheel_radius_m if draft.vehicle else _ANY_RADIUS_M
    try:
        compile_signal_map(
            draft.bus,
            usable_signals(draft),
            folder,
            radius_m,
            e2e=usable_e2e(draft),
        )
    except ConfigError as error:
        return error.problems
    return []


def dbc_warnings(config: Config, folder: Path) -> list[str]:
    """List what is overlooked in the DBC files of *config*, a line each.

    DBC paths are relative to *folder*.
    """
    from bstm_daemon.bus.signals.dbc import read_dbc  # noqa: PLC0415

    return [
        f"[[bus]] {bus.name} {bus.dbc}: {defect}"
        for bus in config.bus
        for defect in read_dbc(
            folder / bus.dbc, strict=bus.strict, encoding=bus.encoding
        ).warnings
    ]


def _model_problems(path: Path) -> list[str]:
    from bstm_daemon.cli.vehicle import load_vehicle  # noqa: PLC0415
    from bstm_daemon.estimator.corner_model import compile_corner  # noqa: PLC0415

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
    blocks = [
        f"{path}: no problems",
        _block(
            [
                ("vehicle", f"{vehicle.id}, {vehicle.mass_kg:g} kg"),
                ("heat", _heat(config)),
                ("effects", _effects(config)),
                ("fluid", _fluid(config)),
                ("publish", _publish(config)),
            ]
        ),
        _block(
            [
                ("bus", "interface", "channel", "bitrate", "DBC"),
                *(
                    (
                        bus.name,
                        bus.interface,
                        bus.channel,
                        "-" if bus.bitrate is None else str(bus.bitrate),
                        bus.dbc,
                    )
                    for bus in config.bus
                ),
            ]
        ),
        _block(
            [
                ("role", "source", "unit", "timeout"),
                *(
                    _signal(role, signal, config)
                    for role, signal in config.signals.items()
                ),
            ]
        ),
        _block(
            [
                ("corner", "type", "circuit", "piston", "disc", "pads"),
                *(_corner(corner) for corner in config.corner),
            ]
        ),
    ]
    return "\n\n".join(blocks)


def _block(rows: Sequence[tuple[str, ...]]) -> str:
    return "\n".join(columns(rows, left=None))


def _heat(config: Config) -> str:
    heat = config.heat
    if heat.mode == "ff":
        return "ff, from brake pressure and friction"
    if heat.mode == "measured":
        return "measured, the disc temperature is given"
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
    road = "; the road is taken as flat" if is_flat else ""
    return f"{way}{assumed}{road}"


def _effects(config: Config) -> str:
    from bstm_daemon.model.effects.catalogue import STRUCTURES  # noqa: PLC0415

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
    bus = publish.bus or config.bus[0].name
    return f"on {bus} from id 0x{publish.id_base:X}"


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
