"""``bstm init``: a first configuration from a DBC and logs, or a table."""

import argparse
from pathlib import Path

from bstm_daemon.analysis.setup import writing
from bstm_daemon.analysis.setup.name_rules import name_matches, unit_matches
from bstm_daemon.analysis.setup.proposal import Candidate, Proposal, propose
from bstm_daemon.analysis.setup.recording import read_recording
from bstm_daemon.analysis.setup.table import (
    propose_for,
    read_table,
    table_notes,
)
from bstm_daemon.bus.opening import is_table
from bstm_daemon.bus.signals.dbc import read_dbc
from bstm_daemon.bus.signals.dbc_text import guess_encoding
from bstm_daemon.cli.arguments import add_force, add_out, check_new, option
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import FileAccessError, UsageError
from bstm_daemon.files import replacing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``--dbc``, ``--log``, ``-o`` and ``--force``."""
    what = "DBC of the car's frames; a signal table needs none"
    option(parser, "--dbc CAR.dbc", what, Path)
    what = (
        "recorded drive with some braking, to check the choice by names; may "
        "be repeated"
    )
    option(parser, "--log LOG", what, Path, action="append", default=[])
    add_out(parser, "configuration to write", "CAR.toml")
    add_force(parser, "CAR.toml")


def run(args: argparse.Namespace) -> int:
    """Write the proposed configuration and print a summary."""
    if args.out is None:
        msg = "init needs -o CAR.toml, the configuration to write"
        raise UsageError(msg)
    out: Path = args.out
    check_new(out, force=args.force)
    kind = "table" if args.dbc is None else "DBC"
    made = _from_table(args.log) if args.dbc is None else _from_dbc(args)
    proposal, text, notes = made
    with replacing(out) as file:
        file.write_text(text, "utf-8")
    for note in notes:
        print(note)
    by = "" if args.log else ", by name and unit only"
    print(
        f"{out}: roles: {len(proposal.sure)}, unsure, as comments: "
        f"{len(proposal.unsure)}{by}"
    )
    if args.log and not proposal.sure:
        print(f"{out}: no role is sure: check that this is the car's {kind}")
    for one in proposal.sure:
        print(f"  {one.role:26} {_worded(one)}")
    for one in proposal.unsure:
        print(f"? {one.role:26} {_worded(one)}")
    for role, count in proposal.more.items():
        print(f"? {role:26} {count} more, less likely")
    print(
        "Every value marked 'typical, replace' stands for one of your car; "
        f"bstm check {out} accepts the file as it is."
    )
    return 0


def _from_dbc(args: argparse.Namespace) -> tuple[Proposal, str, list[str]]:
    """Return proposal, configuration and what is to be said of them."""
    encoding = _encoding(args.dbc)
    loaded = read_dbc(args.dbc, strict=False, encoding=encoding)
    database = loaded.database
    matches = [*name_matches(database), *unit_matches(database)]
    recording = None
    if args.log:
        with Progress("init") as progress:
            recording = read_recording(
                args.log, database, matches, progress.show
            )
    proposal = propose(database, recording)
    notes = writing.notes_of(recording) if recording else []
    dbc = args.dbc.resolve()
    source = writing.bus_section(
        recording,
        dbc=dbc,
        folder=args.out.resolve().parent,
        strict=all(one.harmless for one in loaded.warnings),
        encoding=encoding,
    )
    text = writing.configuration_text(
        proposal, recording, origin=dbc, source=source, notes=notes
    )
    warnings = [f"{args.dbc}: {warning}" for warning in loaded.warnings]
    return proposal, text, warnings + notes


def _from_table(logs: list[Path]) -> tuple[Proposal, str, list[str]]:
    """Return the same as :func:`_from_dbc`, for a signal table."""
    if not logs:
        msg = "init needs --dbc CAR.dbc, or --log TABLE for a signal table"
        raise UsageError(msg)
    for log in logs:
        if not is_table(log):
            msg = f"{log}: a log of CAN frames needs --dbc CAR.dbc"
            raise UsageError(msg)
    with Progress("init") as progress:
        table = read_table(logs, progress.show)
    proposal = propose_for(table)
    notes = table_notes(table, proposal)
    text = writing.configuration_text(
        proposal,
        table.recording,
        origin=logs[0],
        source=writing.table_section(table.time),
        notes=notes,
        columns=table.columns,
    )
    return proposal, text, notes


def _encoding(path: Path) -> str:
    try:
        return guess_encoding(path.read_bytes())
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error


def _worded(one: Candidate) -> str:
    source = f"{one.match.message.name}.{one.match.signal.name}"
    factor = one.sign * one.scale
    corrected = f" x {factor:g}" if factor != 1 else ""
    unread = f" [NOT READ: {one.unread}]" if one.unread else ""
    return f"{source} {one.unit}{corrected}: {one.reason}{unread}"
