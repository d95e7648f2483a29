"""``bstm config``: what editors need to know of the configuration."""

import argparse
import json

from bstm_daemon.cli.arguments import option
from bstm_daemon.config.schema import config_schema


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is asked for."""
    option(
        parser,
        "what",
        "schema: print the JSON schema, by which an editor completes and "
        "checks a file whose first line is #:schema FILE",
        choices=("schema",),
    )


def run(_: argparse.Namespace) -> int:
    """Print the schema."""
    print(json.dumps(config_schema(), indent=1, ensure_ascii=False))
    return 0
