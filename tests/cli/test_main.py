"""The entry point: finding commands, exit codes, the log's level."""

import argparse
import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import structlog

from bstm_daemon import __version__
from bstm_daemon.cli import main as entry
from bstm_daemon.cli.main import COMMANDS, main
from bstm_daemon.errors import (
    BstmError,
    ConfigError,
    FileAccessError,
    LogError,
    MissingExtraError,
    StateLockedError,
    UsageError,
)

ROOT = Path(__file__).parents[2]
SUBARU = ROOT / "config" / "subaru_wrx_sti.toml"
REFERENCE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> "Failing":
    """Return a maker of a command ``fail`` that raises what it is told."""
    return Failing(monkeypatch)


class Failing:
    """Adds a command that raises."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Register the command's module."""
        self.monkeypatch = monkeypatch

    def __call__(self, error: BaseException) -> int:
        """Run the command and return the exit code."""

        def run(args: argparse.Namespace) -> int:
            assert args is not None
            raise error

        module = SimpleNamespace(add_arguments=lambda _: None, run=run)
        self.monkeypatch.setitem(sys.modules, "bstm_daemon.cli.fail", module)
        self.monkeypatch.setitem(COMMANDS, "fail", "-")
        return main(["fail"])


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    """The version comes with what the program is not."""
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == (
        f"bstm {__version__}: estimate and advice, not a safety function\n"
    )


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    """The overview names each command with its summary."""
    assert main(["--help"]) == 0

    out = " ".join(capsys.readouterr().out.split())
    assert all(
        f"{name} {summary}" in out for name, summary in COMMANDS.items()
    )


def test_reference_lists_every_command() -> None:
    """docs/reference.md has each command."""
    assert all(f"`{name}`" in REFERENCE for name in COMMANDS)


def test_help_imports_no_command() -> None:
    """The overview loads neither a command nor a heavy package."""
    heavy = ("numpy", "cantools", "can", "pydantic", "structlog")
    code = (
        "import sys\n"
        "from bstm_daemon.cli.main import main\n"
        "assert main(['--help']) == 0\n"
        "loaded = {n.partition('.')[0] for n in sys.modules}\n"
        f"assert not loaded & set({heavy!r}), loaded\n"
        "assert [n for n in sys.modules if n.startswith('bstm_daemon.cli')]"
        " == ['bstm_daemon.cli', 'bstm_daemon.cli.main']\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )

    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_module(name: str) -> None:
    """Each entry of the table can be loaded and asked for help."""
    module = importlib.import_module(
        f"bstm_daemon.cli.{name.replace('-', '_')}"
    )

    assert callable(module.add_arguments)
    assert callable(module.run)
    assert main([name, "--help"]) == 0


@pytest.mark.parametrize(
    "arguments", [[], ["chekc"], ["check", "--wrong"], ["-x", "check"]]
)
def test_usage_error(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Wrong arguments are exit code 2 and one line on stderr."""
    assert main(arguments) == 2

    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "usage: bstm" in err


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (BstmError("no pass"), 1, "bstm: no pass\n"),
        (UsageError("which?"), 2, "bstm: which?\n"),
        (
            MissingExtraError("plotly", "report", "a report"),
            2,
            (
                "bstm: a report needs the package 'plotly': "
                "pip install 'bstm-daemon[report]'\n"
            ),
        ),
        (LogError("a.log: empty"), 65, "bstm: a.log: empty\n"),
        (FileAccessError("a.log: gone"), 74, "bstm: a.log: gone\n"),
        (StateLockedError("busy"), 75, "bstm: busy\n"),
        (ConfigError(["a: b"]), 78, "a: b\n"),
        (ConfigError(["a: b", "a: c"]), 78, "a: b\na: c\n2 problems\n"),
        (
            PermissionError(13, "Permission denied", "a.log"),
            74,
            "bstm: a.log: Permission denied\n",
        ),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_error_becomes_a_message_and_an_exit_code(
    failing: Failing,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    text: str,
) -> None:
    """Each error has its code and its words, and no traceback."""
    assert failing(error) == code
    assert capsys.readouterr().err == text


@pytest.mark.parametrize("code", [0, 1, 2, 65, 74, 75, 78, 130, 141])
def test_reference_lists_every_exit_code(code: int) -> None:
    """docs/reference.md explains each exit code."""
    assert f"\n- {code}: " in REFERENCE


def test_a_programming_error_is_not_hidden(failing: Failing) -> None:
    """What is nobody's input keeps its traceback."""
    with pytest.raises(ZeroDivisionError):
        failing(ZeroDivisionError())


@pytest.mark.slow
def test_closed_stdout() -> None:
    """A reader that leaves early gets silence and the code of SIGPIPE."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "bstm_daemon.cli.main",
                "check",
                str(SUBARU),
            ],
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            cwd=ROOT,
        )
    finally:
        os.close(writer)

    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize(
    ("flags", "shown"),
    [
        (["check"], ["warning", "error"]),
        (["check", "-v"], ["info", "warning", "error"]),
        (["-v", "check"], ["info", "warning", "error"]),
        (["check", "-vv"], ["debug", "info", "warning", "error"]),
        (["check", "-q"], ["error"]),
    ],
)
def test_verbosity(
    flags: list[str], shown: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The level of the log follows -v and -q, before or after the command."""
    assert main([*flags, str(SUBARU)]) == 0
    capsys.readouterr()
    log = structlog.get_logger()
    for level in ("debug", "info", "warning", "error"):
        getattr(log, level)("bus_up", channel="can0")

    lines = capsys.readouterr().err.splitlines()

    assert len(lines) == len(shown)
    assert all(
        f'"level": "{level}"' in line
        for level, line in zip(shown, lines, strict=True)
    )


def test_commands_are_found_in_their_table_only() -> None:
    """No other module of the room can be called by its name."""
    assert "progress" not in entry.COMMANDS
    assert main(["progress"]) == 2


@pytest.mark.parametrize(
    ("package", "argv"),
    [
        ("plotly", ["verify", "a.log", "--report", "a.html"]),
        ("jinja2", ["gap", "run", "a.log", "--report", "a.html"]),
        ("tomlkit", ["match", "a.log", "-o", "a.toml"]),
        ("tomlkit", ["gap", "run", "a.log", "-o", "a.toml"]),
    ],
)
def test_an_absent_package_is_named_before_any_file_is_read(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    package: str,
    argv: list[str],
) -> None:
    monkeypatch.setitem(sys.modules, package, None)

    assert main([*argv, "-c", "a.toml"]) == 2
    assert f"needs the package '{package}'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "text"),
    [
        (["chekc"], "did you mean 'check'?"),
        (["gap", "rnu", "a.log", "-c", "a.toml"], "did you mean 'run'?"),
        (["config", "schemma"], "did you mean 'schema'?"),
        (["shell", "fish"], "known are bash, man, tcsh, zsh"),
        (["simulate", "simlap", "-o", "a"], "did you mean 'simalp'?"),
        (
            ["simulate", "simalp", "-o", "a", "--effect", "disc_hta=1"],
            "did you mean 'disc_hat'?",
        ),
        (
            ["gap", "advise", "-c", "a.toml", "--among", "disc_hta"],
            "did you mean 'disc_hat'?",
        ),
        (
            ["gap", "advise", "-c", "a.toml", "--menu", "simlap"],
            "did you mean 'simalp'?",
        ),
        (["check", "a.log"], "a.log: this is a log, not a configuration"),
        (
            ["replay", "a.toml", "-c", "a.mf4"],
            "a.mf4: this is a log, not a configuration",
        ),
        (
            ["match", "a.toml", "-c", "a.toml"],
            "a.toml: this is a configuration, not a log",
        ),
        (
            ["gap", "run", "-c", "a.toml", "--holdout", "a.log", "b.log"],
            "gap: --holdout took every LOG that follows it",
        ),
    ],
)
def test_a_mistake_is_answered_with_what_was_meant(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    argv: list[str],
    text: str,
) -> None:
    monkeypatch.chdir(tmp_path)

    assert main(argv) == 2

    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert text in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "argv",
    [
        ["gap", "run", "--report", "a.html", "a.log", "-c", "a.toml", "b.log"],
        ["-v", "gap", "-c", "a.toml", "run", "a.log", "b.log", "-q"],
        ["match", "a.log", "-c", "a.toml", "b.log"],
    ],
)
def test_options_stand_anywhere_among_the_logs(argv: list[str]) -> None:
    args = entry.parser_of({"gap", "match"}).parse_args(argv)

    assert args.logs == [Path("a.log"), Path("b.log")]
    assert args.config == Path("a.toml")


@pytest.mark.slow
def test_a_format_read_otherwise_costs_no_command_pandas() -> None:
    code = (
        "import sys\n"
        "from bstm_daemon.cli.main import parser_of\n"
        "parser_of({'gap'})\n"
        "print('cantools' in sys.modules, 'pandas' in sys.modules)\n"
        "import can.io.mf4, asammdf\n"
        "print(asammdf.MDF.__name__)\n"
    )
    pytest.importorskip("asammdf")

    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=True,
        text=True,
    )

    assert done.stdout == "True False\nMDF\n"
