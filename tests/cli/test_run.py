"""What the command line of ``bstm run`` refuses before it starts."""

from __future__ import annotations

import pytest

from bstm_daemon.cli.main import main


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_a_port_that_can_not_be(
    port: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "-c", "absent.toml", "--metrics-port", port]) == 2
    assert "--metrics-port" in capsys.readouterr().err
