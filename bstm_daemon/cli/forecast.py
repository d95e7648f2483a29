"""``bstm forecast``: what the brake fluid will do, from a saved state."""

import argparse
from pathlib import Path

from bstm_daemon.cli.arguments import check_targets, option, shared
from bstm_daemon.cli.vehicle import read_state
from bstm_daemon.config.reading import load_config
from bstm_daemon.errors import UsageError
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import restore_state
from bstm_daemon.forecast.offline_forecast import outlook
from bstm_daemon.report.forecast import forecast_json, forecast_text
from bstm_daemon.report.json_file import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm forecast``."""
    shared(parser, "config")
    option(
        parser,
        "--now STATE",
        "state file of the daemon; the car parks at its save. It is only read",
        Path,
        required=True,
    )
    shared(parser, "json")


def run(args: argparse.Namespace) -> int:
    """Print the forecast and write it where that is asked for."""
    check_targets((args.json,), (args.config, args.now))
    config = load_config(args.config)
    document = read_state(args.now, "--now")
    vehicle_id = document.get("vehicle_id")
    if vehicle_id != config.vehicle.id:
        msg = (
            f"--now {args.now}: it is of vehicle {vehicle_id!r}, not "
            f"{config.vehicle.id!r}"
        )
        raise UsageError(msg)
    estimator = Estimator(config, {})
    try:
        restore_state(estimator, document, resume=False)
    except StateError as error:
        msg = f"--now {args.now}: the state does not match: {error}"
        raise UsageError(msg) from error
    found = outlook(config, estimator, document)
    print(forecast_text(config.vehicle.id, args.now, found))
    if args.json is not None:
        write_json(args.json, forecast_json(config.vehicle.id, found))
        print(args.json)
    return 0
