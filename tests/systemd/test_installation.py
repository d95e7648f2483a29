"""What is installed for systemd: nothing to complain of, little exposed."""

import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from .commands import run, until
from .conftest import Unit

pytestmark = pytest.mark.systemd

SHIPPED = Path(sys.prefix) / "share" / "bstm-daemon" / "systemd"
BSTM = Path(sys.prefix) / "bin" / "bstm"


@pytest.mark.parametrize("name", ["bstm.service", "bstm@second.service"])
def test_the_installed_unit_has_nothing_to_complain_of(
    installed: None, name: str
) -> None:
    done = run("systemd-analyze", "verify", name)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("name", ["bstm.service", "bstm@.service"])
def test_the_shipped_unit_has_nothing_to_complain_of(
    box: None, tmp_path: Path, name: str
) -> None:
    program = Path("/opt/bstm/bin/bstm")
    program.parent.mkdir()
    try:
        program.symlink_to(BSTM)
        unit = tmp_path / name.replace("@", "@any")
        shutil.copy(SHIPPED / name, unit)
        done = run("systemd-analyze", "verify", unit)
    finally:
        shutil.rmtree(program.parent)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("name", ["bstm.service", "bstm@second.service"])
def test_the_exposure_is_at_most_1_2(installed: None, name: str) -> None:
    """Of that, 0.4 is for asking whether the clock is synchronised."""
    done = run("systemd-analyze", "security", "--no-pager", name)
    [level] = re.findall(
        r"Overall exposure level for .*: ([0-9.]+)", done.stdout
    )
    assert float(level) <= 1.2


def test_an_interpreter_that_the_sandbox_hides_is_refused(
    box: None, tmp_path: Path
) -> None:
    program = Path("/root/python")
    program.symlink_to("/usr/bin/python3")
    try:
        done = run(
            *(program, "-m", "bstm_daemon.cli.main", "install-service"),
            *("-o", tmp_path),
            check=False,
            env={"PYTHONPATH": str(Path(can.__file__).parents[1])},
        )
    finally:
        program.unlink()
    assert done.returncode == 2
    assert "/root/python is in /root, which ProtectHome= hides" in done.stderr
    assert not list(tmp_path.iterdir())


def test_networkd_takes_the_examples(
    box: None, unit_named: Callable[[str], Unit]
) -> None:
    folder = Path("/run/systemd/network")
    folder.mkdir(exist_ok=True)
    networkd = unit_named("systemd-networkd.service")
    for path in [*SHIPPED.glob("80-*")]:
        text = path.read_text().replace("vcan0", "vcan7")
        (folder / path.name).write_text(text)
    try:
        networkd.control("start")
        flags = Path("/sys/class/net/vcan7/flags")
        until(
            lambda: flags.exists() and int(flags.read_text(), 16) & 1 == 1,
            networkd,
        )
        # what it does not know it names with file and line
        assert not re.search(r"/80-\S+:\d+:", networkd.journal())
    finally:
        networkd.control("stop")
        for path in folder.glob("80-*"):
            path.unlink()
        run("ip", "link", "del", "vcan7", check=False)
