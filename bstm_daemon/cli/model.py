"""``bstm model``: the thermal network of a corner as a readable graph."""

import argparse

from bstm_daemon.cli.arguments import add_out, check_targets, option, shared
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import UsageError
from bstm_daemon.exchange.fmu_model import corner_program
from bstm_daemon.files import replacing
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.network import graph_text, network_graph, picture
from bstm_daemon.roles import CORNERS
from bstm_daemon.watch.terminal_text import visible


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is shown, and where to."""
    what = "show: nodes, links and sources of a corner with their values"
    option(parser, "what", what, choices=("show",))
    shared(parser, "config")
    what = f"the corner (default: {CORNERS[0]})"
    option(parser, "--corner", what, choices=CORNERS, default=CORNERS[0])
    add_out(parser, "a picture, or the graph", "FILE.svg|FILE.json")


def run(args: argparse.Namespace) -> int:
    """Print the graph, or write it.

    Raises:
        UsageError: no such corner, or FILE is neither.
        MissingExtraError: a picture is asked for, jinja2 is not installed.
    """
    check_targets((args.out,), (args.config,))
    if args.out is not None and args.out.suffix not in {".svg", ".json"}:
        msg = f"{args.out}: must end in .svg or .json"
        raise UsageError(msg)
    config, _ = load_vehicle(args.config)
    graph = network_graph(
        corner_program(config, args.corner).network,
        f"{config.vehicle.id}, corner {args.corner}",
        config.vehicle.ambient_k,
    )
    if args.out is None:
        print(graph_text(graph))
    elif args.out.suffix == ".json":
        write_json(args.out, graph)
    else:
        with replacing(args.out) as temporary:
            # names may hold characters that XML has not
            text = visible(picture(graph), "\n")
            temporary.write_text(text, encoding="utf-8")
    return 0
