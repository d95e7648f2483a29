"""``bstm fmu``: the model as an FMU for other simulation tools."""

import argparse

from bstm_daemon.cli.arguments import add_out, check_targets, option, shared
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import UsageError
from bstm_daemon.exchange.fmu import PLATFORMS, this_platform, write_fmu
from bstm_daemon.exchange.fmu_model import car_fmu, corner_fmu
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.roles import CORNERS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is exported, how, and where to."""
    what = "export: write an FMU for co-simulation, C without Python"
    option(parser, "what", what, choices=("export",))
    shared(parser, "config")
    part = parser.add_mutually_exclusive_group()
    what = "one corner, from brake power to temperatures (default: FL)"
    option(part, "--corner", what, choices=CORNERS, default=CORNERS[0])
    option(part, "--car", "all corners, from the mapped signals of the car")
    add_out(parser, "the FMU", "FILE.fmu")
    option(parser, "--fmi", "version of FMI", int, choices=(2, 3), default=2)
    option(
        parser,
        "--platform",
        f"of {', '.join(PLATFORMS)}; each needs its C compiler; an empty one "
        "writes the sources only (default: this machine's)",
        default=this_platform(),
        metavar="NAME,...",
    )


def run(args: argparse.Namespace) -> int:
    """Write the FMU.

    Raises:
        UsageError: no FILE, or a compiler is missing.
    """
    if args.out is None:
        msg = "fmu export: -o FILE.fmu is needed"
        raise UsageError(msg)
    check_targets((args.out,), (args.config,))
    config, signal_map = load_vehicle(args.config)
    model = (
        car_fmu(config, present_roles(signal_map))
        if args.car
        else corner_fmu(config, args.corner)
    )
    platforms = [name for name in args.platform.split(",") if name]
    write_fmu(model, args.out, args.fmi, platforms)
    inputs = [v.name for v in model.variables if v.causality == "input"]
    print(f"{args.out}: {model.text}")
    print(f"FMI {args.fmi}.0, {', '.join(platforms) or 'sources only'}")
    print(f"inputs: {', '.join(inputs)}")
    return 0
