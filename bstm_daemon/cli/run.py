"""``bstm run``: the live service, in the foreground as systemd wants it."""

import argparse
import os
from pathlib import Path

from bstm_daemon.cli.arguments import PORT, number, option, shared
from bstm_daemon.service.assembly import BusOverride
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.notify import Notifier
from bstm_daemon.service.service import Options, Service
from bstm_daemon.service.wake import SignalWaiter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; those of the bus are python-can's."""
    shared(parser, "config")
    what = "python-can interface of the first [[bus]], such as socketcan"
    option(parser, "-i --interface", what, str)
    what = "channel of the first [[bus]], such as can0"
    option(parser, "--channel", what, str)
    what = "bitrate of the first [[bus]]"
    option(parser, "-b --bitrate", what, number(1, kind=int))
    what = "receive CAN FD frames on the first [[bus]]"
    option(parser, "--fd", what, action="store_true", default=None)
    what = "state file, instead of the configured or default one"
    option(parser, "--state FILE", what, Path)
    what = "serve /metrics and /healthz on 127.0.0.1:PORT"
    option(parser, "--metrics-port PORT", what, PORT)
    option(parser, "--duration S", "stop after S seconds", number(0.0))
    shared(parser, "no-forecast")
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
