"""``bstm watch``: the brakes of a car, live, from the published frames."""

import argparse
import sys
from argparse import ArgumentTypeError
from contextlib import suppress
from typing import Any, Final

from bstm_daemon.bus.output.layout import BLOCK_IDS, MAX_STANDARD_ID
from bstm_daemon.cli.arguments import add_config, number, option
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import BusConfig, Config
from bstm_daemon.config.service import PublishConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.watch.board import Board
from bstm_daemon.watch.live import link_of, watch_link
from bstm_daemon.watch.terminal_text import raw_stream
from bstm_daemon.watch.view import open_view

LAST_BASE: Final = MAX_STANDARD_ID - BLOCK_IDS + 1
"""The last id at which the whole block is of 11 bits."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm watch``."""
    add_config(parser, "configuration of the vehicle, for bus and ids (TOML)")
    option(
        parser,
        "-i --interface IFACE",
        "python-can interface (default: from CONFIG, python-can's own "
        "configuration, or socketcan)",
        _name,
    )
    what = "channel of the interface (default: likewise, or can0)"
    option(parser, "--channel CH", what, _name)
    what = "bitrate, for interfaces that need it"
    option(parser, "-b --bitrate BIT/S", what, number(1, kind=int))
    option(
        parser,
        "--id-base ID",
        "id of BSTM_Status (default: [publish] id_base of CONFIG, or 0x5B0)",
        _id_base,
    )


def run(args: argparse.Namespace) -> int:
    """Show the view until the user leaves."""
    view = open_view(raw_stream(sys.stdout))
    config = None if args.config is None else load_config(args.config)
    publish = PublishConfig() if config is None else config.publish
    id_base = publish.id_base if args.id_base is None else args.id_base
    corners = [corner.name for corner in config.corner] if config else []
    board = Board(id_base, corners)
    link = link_of(_bus(args, config), board)
    with suppress(KeyboardInterrupt):
        watch_link(link, board, view)
    return 0


def _bus(args: argparse.Namespace, config: Config | None) -> BusConfig:
    """Return the bus to read: arguments, then CONFIG, then python-can's."""
    asked: dict[str, Any] = {
        key: value
        for key in ("interface", "channel", "bitrate")
        if (value := getattr(args, key)) is not None
    }
    if config is not None:
        if not config.bus:
            msg = f"{args.config}: has no [[bus]] to watch"
            raise ConfigError([msg])
        return config.bus[config.publishing_bus].model_copy(update=asked)
    from can.util import load_environment_config, load_file_config  # noqa: PLC0415  (slow, and not needed with -c)

    own = {**load_file_config(), **load_environment_config()}
    fallback = {
        key: own[key] for key in ("interface", "channel") if own.get(key)
    }
    return BusConfig(name="watched", dbc="none", **{**fallback, **asked})


def _id_base(text: str) -> int:
    id_base = -1
    with suppress(ValueError):
        id_base = int(text, 0)
    if not 0 <= id_base <= LAST_BASE:
        msg = (
            f"{text}: the block of {BLOCK_IDS} ids begins at 0x0 to "
            f"0x{LAST_BASE:X}"
        )
        raise ArgumentTypeError(msg)
    return id_base


def _name(text: str) -> str:
    if not text:
        msg = "needs a name, such as can0"
        raise ArgumentTypeError(msg)
    return text
