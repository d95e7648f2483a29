"""``bstm shell``: completion scripts and the man page, from the arguments."""

import argparse
from importlib import import_module
from typing import Final

from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.main import COMMANDS, parser_of
from bstm_daemon.errors import require_packages

SHELLS: Final = ("bash", "zsh", "tcsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is printed."""
    what = (
        "bash, zsh, tcsh: its completion of commands and options; man: the "
        "page bstm(1)"
    )
    option(parser, "what", what, choices=(*SHELLS, "man"))


def run(args: argparse.Namespace) -> int:
    """Print it."""
    package = "argparse_manpage" if args.what == "man" else "shtab"
    require_packages(package, extra="shell", purpose=f"shell {args.what}")
    parser = parser_of(COMMANDS)
    if args.what == "man":
        page = import_module("argparse_manpage.manpage").Manpage(parser)
        page.manual = "Brake temperatures from a CAN bus"
        print(page)
    else:
        print(import_module("shtab").complete(parser, shell=args.what))
    return 0
