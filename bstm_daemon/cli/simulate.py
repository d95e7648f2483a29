"""``bstm simulate``: the CAN log of the simulated car on a drive."""

import argparse
from pathlib import Path

from bstm_daemon.cli.arguments import (
    LOG_ENDINGS,
    add_out,
    check_targets,
    number,
    option,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import UsageError
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import (
    SENSOR_PRESETS,
    Drive,
    Effects,
    drive_names,
    load_drive,
    load_vehicle,
    preset_effects,
    read_drive,
    simulate,
    vehicle_names,
)
from bstm_daemon.simulation.recorder import (
    Encoder,
    write_candump,
    write_samples,
    write_truth,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm simulate``."""
    what = "a drive of --list, or a TOML file that describes one"
    option(parser, "drive DRIVE", what, nargs="?")
    add_out(parser, "candump log to write", "LOG")
    option(
        parser,
        "--preset",
        "effects of the simulated car's brakes: plain or road (default: "
        "plain)",
        default="plain",
    )
    option(
        parser,
        "--effect NAME=STRENGTH",
        "switch one effect in addition to the preset's; 0 is off, 1 typical; "
        "may be repeated",
        action="append",
        default=[],
    )
    option(
        parser,
        "--sensors",
        "errors of the sensors, n1 good to n4 poor (default: none)",
        default="none",
        choices=tuple(SENSOR_PRESETS),
    )
    what = "the car that drives (default: the drive's own, mostly nominal)"
    option(parser, "--vehicle", what, choices=tuple(vehicle_names()))
    what = "write the sensors' samples at 100 Hz, without frames"
    option(parser, "--samples FILE.npz", what, Path)
    what = "write the true temperatures, a row a second, to FILE.csv"
    option(parser, "--truth FILE.csv", what, Path)
    what = "of the sensors' noise (default: 0)"
    option(parser, "--seed", what, number(0, kind=int), default=0)
    option(parser, "--list", "list the drives and stop")


def run(args: argparse.Namespace) -> int:
    """Simulate a drive and write its log."""
    if args.list:
        for name in drive_names():
            print(f"{name:16} {load_drive(name).drive.description}")
        return 0
    if args.drive is None or not (args.out or args.samples):
        msg = (
            "simulate needs a DRIVE and -o LOG or --samples FILE "
            "(bstm simulate --list)"
        )
        raise UsageError(msg)
    targets = (args.out, args.samples, args.truth)
    check_targets(targets, (Path(args.drive),))
    others = LOG_ENDINGS - {".log"}
    if args.out is not None and args.out.suffix in others:
        msg = f"{args.out}: a candump log is written, give it the ending .log"
        raise UsageError(msg)
    with Progress("simulate") as progress:
        driven = simulate(
            _drive(args.drive),
            load_vehicle(args.vehicle) if args.vehicle else None,
            preset=_effects(args.preset, args.effect),
            sensors=args.sensors,
            seed=args.seed,
        )
        show = progress.part(0.35, 1.0)
        show(0.0)
        if args.out is not None:
            encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
            frames = write_candump(args.out, driven, encoder, progress=show)
    minutes = float(driven.time_s[-1]) / 60.0
    if args.out is not None:
        print(f"{args.out}: {frames} frames, {minutes:.1f} min")
    if args.samples is not None:
        write_samples(args.samples, driven)
        print(f"{args.samples}: {len(driven.time_s)} samples a role")
    if args.truth is not None:
        write_truth(args.truth, driven)
        print(f"{args.truth}: {len(driven.slow_time_s)} rows of truth")
    return 0


def _effects(preset: str, switched: list[str]) -> Effects:
    effects = preset_effects(preset)
    for text in switched:
        name, _, value = text.partition("=")
        try:
            strength = float(value)
        except ValueError:
            msg = f"--effect {text}: give NAME=STRENGTH, as in disc_hat=1.0"
            raise UsageError(msg) from None
        effects = effects.with_strength(name, strength)
    return effects


def _drive(name: str) -> Drive:
    path = Path(name)
    if path.suffix == ".toml":
        return read_drive(path)
    return load_drive(name)
