"""``bstm bridge mqtt``: the feed, published to an MQTT broker."""

import argparse
import signal
from pathlib import Path
from threading import Event

from bstm_daemon.cli.arguments import number, option
from bstm_daemon.config.reading import load_section
from bstm_daemon.errors import UsageError, require_packages
from bstm_daemon.feed.reader import DEFAULT_SOCKET, records
from bstm_daemon.files import read_secret


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the kind of bridge, the feed and the broker."""
    option(parser, "kind", "kind of broker", choices=["mqtt"])
    what = "mqtts://HOST[:PORT], or mqtt:// without TLS; default: of FILE"
    option(parser, "--broker URL", what)
    what = "TOML with broker, username, password, ca_file, cert_file, key_file"
    option(parser, "--credentials FILE", what, Path)
    what = f"socket of the live service (default: {DEFAULT_SOCKET})"
    option(parser, "--feed SOCKET", what, Path)
    what = "seconds between two publications (default: 1; 0 is all)"
    option(parser, "--every S", what, number(0.0), default=1.0)
    what = "announce the values to Home Assistant (default: homeassistant)"
    option(parser, "--discovery", what, nargs="?", const="homeassistant")
    parser.set_defaults(verbosity_offset=1)


def run(args: argparse.Namespace) -> int:
    """Publish until SIGTERM or SIGINT."""
    require_packages("paho", extra="mqtt", purpose="bstm bridge mqtt")
    from bstm_daemon.feed.mqtt import MqttFile, run_bridge  # noqa: PLC0415

    credentials = MqttFile()
    if args.credentials is not None:
        read_secret(args.credentials)
        credentials = load_section(args.credentials, MqttFile)
    url = args.broker or credentials.broker
    if url is None:
        msg = "bridge mqtt: needs --broker, or 'broker' in --credentials FILE"
        raise UsageError(msg)
    stop = Event()
    for one in (signal.SIGTERM, signal.SIGINT):
        signal.signal(one, lambda *_: stop.set())
    feed = records(args.feed or Path(DEFAULT_SOCKET), stop)
    run_bridge(feed, url, credentials, args.every, args.discovery)
    return 0
