"""``bstm run``: the live service, in the foreground as systemd wants it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from bstm_daemon.cli.arguments import (
    LAST_PORT,
    add_config,
    add_no_forecast,
    add_path,
    number,
)
from bstm_daemon.service.assembly import BusOverride
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.notify import Notifier
from bstm_daemon.service.service import Options, Service
from bstm_daemon.service.wake import SignalWaiter

if TYPE_CHECKING:
    import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; those of the bus are python-can's."""
    add_config(parser)
    parser.add_argument(
        "-i",
        "--interface",
        help="python-can interface of the first [[bus]], such as socketcan",
    )
    parser.add_argument(
        "--channel", help="channel of the first [[bus]], such as can0"
    )
    parser.add_argument(
        *("-b", "--bitrate"),
        type=number(1, kind=int),
        help="bitrate of the first [[bus]]",
    )
    parser.add_argument(
        "--fd",
        action="store_true",
        default=None,
        help="receive CAN FD frames on the first [[bus]]",
    )
    what = "state file, instead of the configured or default one"
    add_path(parser, "--state", "FILE", what)
    parser.add_argument(
        "--metrics-port",
        type=number(0, LAST_PORT, int),
        metavar="PORT",
        help="serve /metrics and /healthz on 127.0.0.1:PORT",
    )
    parser.add_argument(
        "--duration",
        type=number(0.0),
        metavar="S",
        help="stop after S seconds",
    )
    add_no_forecast(parser)
    # a service logs what it does; -q logs warnings only, -qq errors
    parser.set_defaults(verbosity_offset=1)


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGINT or the end of ``--duration``."""
    options = Options(
        config=args.config,
        state=args.state,
        override=BusOverride(
            args.interface, args.channel, args.bitrate, args.fd
        ),
        metrics_port=args.metrics_port,
        forecast=args.forecast,
        until_us=None if args.duration is None else round(args.duration * 1e6),
    )
    notifier = Notifier.from_environment(os.environ)
    with SignalWaiter() as waiter:
        Service(options, notifier, ServiceLog()).run(waiter)
    return 0
