"""Files that no vehicle needs are refused in one line, and at once."""

import os
from pathlib import Path

import pytest

from bstm_daemon.bus.signals.dbc import read_dbc
from bstm_daemon.bus.signals.expression import (
    ExpressionError,
    evaluate,
    parse_expression,
)
from bstm_daemon.config.limits import (
    DBC_BYTES,
    EXPRESSION_CHARACTERS,
    EXPRESSION_TERMS,
    TOML_BYTES,
    read_limited,
)
from bstm_daemon.config.reading import load_config
from bstm_daemon.errors import ConfigError

DBC = """VERSION ""

BU_: X

BO_ 100 BRAKE: 8 X
 SG_ pressure : 0|16@1+ (0.1,0) [0|250] "bar" X

"""


def problem_of(path: Path) -> str:
    """Return the one problem of a configuration, without the file's name."""
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.exit_code == 78
    (line,) = caught.value.problems
    assert line.startswith(f"{path}: ")
    return line.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            f"[vehicle]\nid = {'[' * 100_000}",
            "TOML: tables and lists nested deeper than 16",
        ),
        (
            f"a = {'{a = ' * 3000}1{'}' * 3000}",
            "TOML: tables and lists nested deeper than 16",
        ),
        (
            f"[{'.'.join('a' * 40)}]\nb = 1",
            f"{'.'.join('a' * 17)}: tables and lists nested deeper than 16",
        ),
        (
            f"[vehicle]\nmass_kg = {'9' * 5000}",
            "TOML: an integer of more than 63 bits",
        ),
        (
            f"[vehicle]\nmass_kg = 0x{'F' * 5000}",
            "vehicle.mass_kg: an integer of more than 63 bits",
        ),
        (
            "[[corner]]\n[[corner]]\nx = [0, 9223372036854775808]",
            "corner[1].x[1]: an integer of more than 63 bits",
        ),
    ],
    ids=["lists", "tables", "keys", "digits", "hexadecimal", "65 bits"],
)
def test_what_toml_may_not_hold(
    tmp_path: Path, text: str, problem: str
) -> None:
    path = tmp_path / "car.toml"
    path.write_text(text)

    assert problem_of(path) == problem


def test_a_long_configuration(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_bytes(b"#" * (TOML_BYTES + 1))

    assert problem_of(path) == "is longer than 4 MiB, the most that is read"


def test_a_device_is_no_configuration(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.symlink_to("/dev/zero")

    assert problem_of(path) == "is no regular file"


def test_a_pipe_does_not_block(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)

    with pytest.raises(ValueError, match="is no regular file"):
        read_limited(path, 10)


def test_a_file_at_its_limit_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ten"
    path.write_bytes(b"0123456789")

    assert read_limited(path, 10) == b"0123456789"
    with pytest.raises(ValueError, match="is longer than"):
        read_limited(path, 9)


@pytest.mark.parametrize("strict", [True, False])
def test_a_dbc_that_is_no_file_or_too_long(
    tmp_path: Path, *, strict: bool
) -> None:
    path = tmp_path / "car.dbc"
    with path.open("wb") as file:
        file.truncate(DBC_BYTES + 1)

    for dbc, reason in (
        (path, "is longer than 64 MiB, the most that is read"),
        (Path("/dev/zero"), "is no regular file"),
    ):
        with pytest.raises(ConfigError) as caught:
            read_dbc(dbc, strict=strict, encoding="cp1252")
        assert caught.value.problems == [f"{dbc}: {reason}"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            ' SG_ s : 0|1000000000@1+ (1,0) [0|1] "" X\n',
            (
                "line 8: message 'BRAKE': signal 's' has 1000000000 bits, "
                "more than 512: dropped"
            ),
        ),
        (
            ' SG_ s : 999999999|8@1+ (1,0) [0|1] "" X\n',
            (
                "line 8: message 'BRAKE': signal 's' begins at bit 999999999, "
                "beyond 4095 bytes: dropped"
            ),
        ),
        (
            "BO_ 101 LONG: 999999999 X\n",
            (
                "line 8: message 'LONG': has 999999999 bytes, more than 4095: "
                "dropped"
            ),
        ),
        (
            f' SG_ s : 0|{"9" * 5000}@1+ (1,0) [0|1] "" X\n',
            "line 8: message 'BRAKE': cannot be read: SG_ s : 0|9999",
        ),
    ],
    ids=["length", "start", "message", "digits"],
)
def test_what_a_dbc_may_not_declare(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(DBC.rstrip("\n") + "\n\n" + text)

    with pytest.raises(ConfigError) as caught:
        read_dbc(path, strict=True, encoding="cp1252")

    (problem,) = caught.value.problems
    assert problem.startswith(f"{path}: {reason}")
    loaded = read_dbc(path, strict=False, encoding="cp1252")
    (message,) = loaded.database.messages
    assert [signal.name for signal in message.signals] == ["pressure"]


def test_a_long_comment_is_left_out_at_once(tmp_path: Path) -> None:
    """10 MB of a text that no value needs took a minute."""
    path = tmp_path / "car.dbc"
    path.write_text(f'{DBC}CM_ BO_ 100 "{"x" * 10_000_000}";\n')

    loaded = read_dbc(path, strict=True, encoding="cp1252")

    assert loaded.database.messages[0].comment is None
    (warning,) = loaded.warnings
    assert str(warning) == "line 8: a comment of 10000015 characters: left out"


def test_a_long_expression() -> None:
    with pytest.raises(ExpressionError, match="has 4097 characters, at most"):
        parse_expression("a" * (EXPRESSION_CHARACTERS + 1))


def test_an_expression_of_many_terms() -> None:
    """As many as allowed are evaluated; 900 ended in a recursion."""
    tree = parse_expression("-a" * EXPRESSION_TERMS)

    assert evaluate(tree, {"a": 2.0}) == -400.0
    with pytest.raises(
        ExpressionError, match="position 801: more than 200 numbers and names"
    ):
        parse_expression("1 + " * 900 + "a")
