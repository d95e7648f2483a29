"""``bstm install-service``: refusals, files, what it says."""

import sys
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.service import unit_files

ELSEWHERE = Path("/usr/bin/env")


@pytest.fixture
def visible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the program be where the service can see it.

    The interpreter of the tests may well be in somebody's home; the real
    check runs in tests/systemd.
    """
    monkeypatch.setattr(unit_files, "program_places", lambda: [ELSEWHERE])
    monkeypatch.setattr(sys, "executable", "/opt/venv/bin/python")


def install(folder: Path, *arguments: str) -> int:
    return main(["install-service", "-o", str(folder), *arguments])


def test_the_unit_has_the_absolute_interpreter(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert install(tmp_path) == 0

    assert [path.name for path in tmp_path.iterdir()] == ["bstm.service"]
    text = (tmp_path / "bstm.service").read_text()
    assert (
        "\nExecStart=/opt/venv/bin/python -P -m bstm_daemon.cli.main run "
        "-c /etc/bstm/vehicle.toml $BSTM_OPTIONS\n"
    ) in text
    out = capsys.readouterr().out
    assert f"wrote {tmp_path}/bstm.service\n" in out
    assert "systemctl daemon-reload\n" in out
    assert "systemctl enable --now bstm.service\n" in out
    assert " check /etc/bstm/vehicle.toml\n" in out


def test_an_instance_is_a_template(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        install(tmp_path, "--instance", "front", "--metrics-port", "80") == 0
    )

    text = (tmp_path / "bstm@.service").read_text()
    assert "run -c /etc/bstm/%i.toml $BSTM_OPTIONS\n" in text
    drop_in = tmp_path / "bstm@front.service.d" / "metrics-http.conf"
    assert "--metrics-port 80" in drop_in.read_text()
    out = capsys.readouterr().out
    assert "systemctl enable --now bstm@front.service\n" in out
    assert " check /etc/bstm/front.toml\n" in out


def test_another_configuration(visible: None, tmp_path: Path) -> None:
    assert install(tmp_path, "--config", "/srv/../srv/car.toml") == 0

    text = (tmp_path / "bstm.service").read_text()
    assert " run -c /srv/car.toml $BSTM_OPTIONS\n" in text


def test_an_instance_has_its_own_configuration(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = install(tmp_path, "--instance", "front", "-c", "/srv/car.toml")

    assert code == 2
    assert "/etc/bstm/front.toml" in capsys.readouterr().err


def test_a_hidden_configuration_is_refused(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert install(tmp_path, "-c", "/root/car.toml") == 2

    err = capsys.readouterr().err
    assert "/root/car.toml is in /root, which ProtectHome= hides" in err
    assert list(tmp_path.iterdir()) == []


def test_a_hidden_interpreter_is_refused(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(
        unit_files,
        "program_places",
        lambda: [Path("/home/me/venv/bin/python")],
    )

    for more in ([], ["--dry-run"], ["--force"]):
        assert install(tmp_path, *more) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert "/home/me/venv/bin/python is in /home" in err
        assert "/usr/bin/python3 -m venv /opt/bstm" in err
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_prints_and_writes_nothing(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert install(tmp_path, "--metrics-port", "9000", "--dry-run") == 0

    out = capsys.readouterr().out
    assert out.startswith(f"# {tmp_path}/bstm.service\n")
    assert f"\n# {tmp_path}/bstm.service.d/metrics-http.conf\n" in out
    assert "ExecStart=/opt/venv/bin/python" in out
    assert list(tmp_path.iterdir()) == []


def test_a_changed_unit_is_replaced_with_force_only(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unit = tmp_path / "bstm.service"
    unit.write_text("mine\n")

    assert install(tmp_path, "--metrics-port", "9000") == 2
    assert f"{unit}: exists already" in capsys.readouterr().err
    # neither is the drop-in written, although that is not there
    assert [path.name for path in tmp_path.iterdir()] == ["bstm.service"]
    assert unit.read_text() == "mine\n"

    assert install(tmp_path, "--force") == 0
    assert "ExecStart=/opt/venv/bin/python" in unit.read_text()


def test_installing_again_changes_nothing(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert install(tmp_path) == 0
    before = (tmp_path / "bstm.service").stat()
    capsys.readouterr()

    assert install(tmp_path) == 0

    assert f"unchanged: {tmp_path}/bstm.service\n" in capsys.readouterr().out
    after = (tmp_path / "bstm.service").stat()
    assert (after.st_ino, after.st_mtime_ns) == (
        before.st_ino,
        before.st_mtime_ns,
    )


def test_a_folder_that_can_not_be_written(
    visible: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()

    assert install(tmp_path / "file" / "units") == 74

    assert str(tmp_path / "file" / "units") in capsys.readouterr().err
