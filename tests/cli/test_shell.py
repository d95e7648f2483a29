"""``bstm shell``: what a shell and ``man`` make of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.main import COMMANDS, main

if TYPE_CHECKING:
    from pathlib import Path


def printed(what: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["shell", what]) == 0
    return capsys.readouterr().out


def test_bash_completes_commands_and_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "bstm"
    script.write_text(printed("bash", capsys), encoding="utf-8")
    code = (
        'complete() { FUNCTION="${@: -2:1}"; }; . ./bstm; compopt() { :; }\n'
        'reply() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()\n'
        '$FUNCTION bstm "${@: -1}"; echo "${COMPREPLY[@]}"; }\n'
        "reply bstm che; reply bstm gap adv; reply bstm replay --publ\n"
    )

    done = subprocess.run(
        ["bash", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.stderr == ""
    assert done.stdout.split("\n")[:3] == ["check", "advise", "--publish"]


@pytest.mark.parametrize("shell", ["zsh", "tcsh"])
def test_other_shells_know_every_command(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    script = printed(shell, capsys)

    assert all(name in script for name in COMMANDS)


def test_the_man_page_has_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = printed("man", capsys)

    assert page.startswith(".TH BSTM ")
    assert all(f"bstm {name}" in page.replace("\\-", "-") for name in COMMANDS)
    if shutil.which("man"):
        (tmp_path / "bstm.1").write_text(page, encoding="utf-8")
        shown = subprocess.run(
            ["man", "-l", tmp_path / "bstm.1"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert "Brake temperatures from a CAN bus" in shown.stdout


def test_an_absent_package_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)

    assert main(["shell", "bash"]) == 2
    assert "bstm-daemon[shell]" in capsys.readouterr().err
