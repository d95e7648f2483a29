"""``bstm install-service``: units for systemd that fit this installation.

Writes files only: starting a service on a car is for its owner to do.
"""

import argparse
import sys
from pathlib import Path

from bstm_daemon.cli.arguments import PORT, add_config, option
from bstm_daemon.errors import UsageError
from bstm_daemon.files import shipped_file
from bstm_daemon.service import unit_files


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is installed, where, and ``--dry-run``."""
    what = f"configuration of the vehicle; default {unit_files.DEFAULT_CONFIG}"
    add_config(parser, what)
    option(
        parser,
        "--instance NAME",
        "install bstm@.service, of which bstm@NAME reads "
        f"{unit_files.CONFIG_FOLDER}/NAME.toml: for several cars or buses",
    )
    what = f"folder of the units; default {unit_files.UNIT_FOLDER}"
    option(parser, "-o --out DIR", what, Path, default=unit_files.UNIT_FOLDER)
    what = "add the drop-in that serves metrics on 127.0.0.1:PORT"
    option(parser, "--metrics-port PORT", what, PORT)
    option(
        parser,
        "--with",
        "add the unit of the live page or of the MQTT bridge; may be repeated",
        dest="companions",
        action="append",
        choices=unit_files.COMPANIONS,
        default=[],
    )
    option(parser, "--force", "replace existing units that differ")
    option(parser, "--dry-run", "print the files instead of writing them")


def run(args: argparse.Namespace) -> int:
    """Write the units and print the next steps."""
    unit_files.refuse_hidden(unit_files.program_places())
    unit = unit_files.ServiceUnit(
        unit_files.program_command(Path(sys.executable)),
        _config(args.config, args.instance),
        args.instance,
        args.metrics_port,
        tuple(args.companions),
    )
    files = unit.files(args.out)
    if args.dry_run:
        for file in files:
            print(f"# {file.path}\n{file.text}")
        return 0
    _write(files, force=args.force)
    _print_next_steps(unit)
    return 0


def _config(asked: Path | None, instance: str | None) -> Path:
    """Return the configuration of the unit, which the service must see."""
    if asked is None:
        path = unit_files.DEFAULT_CONFIG
        if instance is not None:
            path = unit_files.CONFIG_FOLDER / f"{instance}.toml"
    elif instance is not None:
        msg = (
            "--config and --instance: an instance reads "
            f"{unit_files.CONFIG_FOLDER}/{instance}.toml, put the "
            "configuration there"
        )
        raise UsageError(msg)
    else:
        path = unit_files.require_plain(asked)
    found = unit_files.obstacles([path])
    if found:
        msg = (
            f"{path}: the service could not read it: {'; '.join(found)}. Put "
            f"configuration and DBC files into {unit_files.CONFIG_FOLDER}"
        )
        raise UsageError(msg)
    return path


def _write(files: list[unit_files.UnitFile], *, force: bool) -> None:
    """Write all *files*, or none where one must not be replaced."""
    for file in files:
        if file.path.exists() and not file.is_there() and not force:
            msg = (
                f"{file.path}: exists already and differs, give --force to "
                "replace it"
            )
            raise UsageError(msg)
    for file in files:
        done = "wrote" if file.write() else "unchanged:"
        print(f"{done} {file.path}")


def _print_next_steps(unit: unit_files.ServiceUnit) -> None:
    examples = shipped_file("systemd/README.md").parent
    print("\nNext:")
    if not unit.config.exists():
        print(
            f"  put the configuration at {unit.config}, its DBC files beside "
            "it, readable for all"
        )
    names = " ".join(
        [unit.name, *(f"bstm-{name}" for name in unit.companions)]
    )
    print(
        f"  {unit.program} check {unit.config}\n"
        "  systemctl daemon-reload\n"
        f"  systemctl enable --now {names}\n"
        f"Bit rate and receive buffer of the bus: {examples}/README.md"
    )
