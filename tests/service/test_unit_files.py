"""The shipped units and how they are fitted to an installation."""

import os
import re
import sys
from configparser import ConfigParser
from pathlib import Path

import pytest

from bstm_daemon.errors import (
    ConfigError,
    MissingExtraError,
    StateLockedError,
    UsageError,
)
from bstm_daemon.service.unit_files import (
    COMPANIONS,
    DEFAULT_CONFIG,
    HIDDEN,
    PROGRAM,
    ServiceUnit,
    UnitFile,
    obstacles,
    program_command,
    program_places,
    refuse_hidden,
    require_plain,
)

FOLDER = Path(__file__).parents[2] / "systemd"
UNITS = ("bstm.service", "bstm@.service")
BESIDE = tuple(f"bstm-{name}.service" for name in COMPANIONS)
SANDBOX = "# -- Sandbox."
DIRECTIVE = re.compile(r"([A-Z]\w+)=(.*)")


def text_of(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")


def values(name: str, key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", text_of(name), re.MULTILINE)


def sandbox(name: str) -> list[tuple[str, str]]:
    """Return (comment above, line) for every directive of the sandbox."""
    part = text_of(name).split(SANDBOX)[1].split("[Install]")[0]
    found, comment = [], ""
    for line in part.splitlines()[2:]:
        if line.startswith("# "):
            comment += line
        elif line:
            found.append((comment, line))
            comment = ""
    return found


@pytest.fixture
def open_folder(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Return a folder that every user may enter."""
    own = tmp_path_factory.getbasetemp().parent
    for folder in (tmp_path, *tmp_path.parents):
        is_open = folder.stat().st_mode & 0o001
        if folder.is_relative_to(own):
            folder.chmod(0o711)
        elif not is_open:
            pytest.skip(f"{folder} is closed to other users")
    return tmp_path


@pytest.mark.parametrize("name", [*UNITS, *BESIDE])
def test_every_line_of_the_sandbox_says_what_it_breaks(name: str) -> None:
    lines = sandbox(name)
    assert len(lines) > 30
    for comment, line in lines:
        assert DIRECTIVE.fullmatch(line), line
        assert re.match(r"# Breaks: \S.{10,}[.]", comment), line


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("Type", "notify"),
        ("NotifyAccess", "main"),
        ("Restart", "on-failure"),
        ("StartLimitIntervalSec", "0"),
        ("WatchdogSec", "10s"),
        ("ExecReload", "kill -HUP $MAINPID"),
        ("ConfigurationDirectory", "bstm"),
        ("DynamicUser", "yes"),
        ("CapabilityBoundingSet", ""),
        ("RestrictAddressFamilies", "AF_CAN AF_UNIX"),
        ("MemoryDenyWriteExecute", "yes"),
        ("ProtectSystem", "strict"),
    ],
)
def test_keys(name: str, key: str, value: str) -> None:
    assert values(name, key) == [value]


@pytest.mark.parametrize("name", BESIDE)
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("Restart", "on-failure"),
        ("RestartPreventExitStatus", "2 78"),
        ("Group", "bstm-feed"),
        ("DynamicUser", "yes"),
        ("CapabilityBoundingSet", ""),
        ("MemoryDenyWriteExecute", "yes"),
        ("ProtectSystem", "strict"),
        # no CAN: no frame is sent from there
        ("RestrictAddressFamilies", "AF_UNIX AF_INET AF_INET6"),
    ],
)
def test_keys_of_what_reads_the_feed(name: str, key: str, value: str) -> None:
    assert values(name, key) == [value]


@pytest.mark.parametrize("name", [*UNITS, *BESIDE])
@pytest.mark.parametrize("key", ["BindsTo", "Requires", "PartOf", "Requisite"])
def test_the_end_of_one_unit_is_none_of_another(name: str, key: str) -> None:
    assert values(name, key) == []


def test_the_page_is_for_this_computer_only() -> None:
    assert values("bstm-view.service", "IPAddressDeny") == ["any"]
    assert values("bstm-view.service", "IPAddressAllow") == ["localhost"]
    assert "--listen" not in values("bstm-view.service", "ExecStart")[0]


def test_the_password_is_a_credential() -> None:
    name = "bstm-mqtt.service"
    credential = "mqtt.toml:/etc/bstm/mqtt.toml"
    assert values(name, "LoadCredential") == [credential]
    [command] = values(name, "ExecStart")
    assert "--credentials ${CREDENTIALS_DIRECTORY}/mqtt.toml" in command


def test_what_reads_the_feed_is_installed_on_request() -> None:
    unit = ServiceUnit("/py -m x", companions=COMPANIONS)
    _, *found = unit.files(Path("/units"))
    assert [file.path for file in found] == [
        Path("/units") / name for name in BESIDE
    ]
    for file in found:
        assert "ExecStart=/py -m x " in file.text
        assert PROGRAM not in file.text


@pytest.mark.parametrize("name", UNITS)
def test_what_stays_wrong_is_not_tried_again(name: str) -> None:
    errors = (MissingExtraError, StateLockedError, ConfigError)
    codes = {error.exit_code for error in errors}
    [listed] = values(name, "RestartPreventExitStatus")
    assert {int(code) for code in listed.split()} == codes


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize(
    "key",
    [
        "BindsTo",  # the service waits for the interface itself
        "PrivateNetwork",  # would hide it
        "ProcSubset",  # would hide boot_id
    ],
)
def test_keys_that_must_stay_away(name: str, key: str) -> None:
    assert values(name, key) == []


@pytest.mark.parametrize("name", UNITS)
def test_the_last_saves_fit_into_the_time_to_stop(name: str) -> None:
    """State and record wait 30 s each for the medium, one after the other."""
    [stop] = values(name, "TimeoutStopSec")
    assert int(stop.removesuffix("s")) > 30 + 30


def test_an_instance_differs_in_its_names_only() -> None:
    one, many = (
        [line for line in text_of(name).splitlines() if line[:1] != "#"]
        for name in UNITS
    )
    named = [
        line.replace(" (%i)", "").replace("%i", "vehicle")
        if "toml" in line
        else line.replace(" (%i)", "").replace("-%i", "")
        for line in many
    ]
    assert named == one
    assert many != one


def test_folders_of_an_instance_are_not_inside_the_other_ones() -> None:
    """Else bstm.service could not start, and would remove them."""
    for key in ("StateDirectory", "RuntimeDirectory"):
        [one], [many] = (values(name, key) for name in UNITS)
        assert not many.startswith(f"{one}/")


@pytest.mark.parametrize("name", UNITS)
def test_the_program_is_replaced_once_and_completely(name: str) -> None:
    assert text_of(name).count(PROGRAM) == 1
    instance = "front" if "@" in name else None
    unit = ServiceUnit("/srv/py -P -m x", DEFAULT_CONFIG, instance)
    [file] = unit.files(Path("/units"))
    assert file.path == Path("/units") / name
    assert file.text == text_of(name).replace(PROGRAM, "/srv/py -P -m x")


def test_the_configuration_is_replaced() -> None:
    unit = ServiceUnit("/py", Path("/srv/car.toml"))
    [file] = unit.files(Path("/units"))
    assert "ExecStart=/py run -c /srv/car.toml $BSTM_OPTIONS\n" in file.text


@pytest.mark.parametrize(
    ("instance", "folder"),
    [(None, "bstm.service.d"), ("front", "bstm@front.service.d")],
)
def test_the_page_is_a_drop_in(instance: str | None, folder: str) -> None:
    unit = ServiceUnit("/py", instance=instance, metrics_port=1234)
    _, file = unit.files(Path("/units"))
    assert file.path == Path("/units") / folder / "metrics-http.conf"
    assert "9745" not in file.text
    parser = ConfigParser()
    parser.optionxform = str  # type: ignore[method-assign,assignment]
    parser.read_string(file.text)
    assert dict(parser["Service"]) == {
        "Environment": '"BSTM_OPTIONS=--metrics-port 1234"',
        "RestrictAddressFamilies": "AF_INET",
        "IPAddressDeny": "any",
        "IPAddressAllow": "localhost",
    }


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_a_port_that_can_not_be(port: int) -> None:
    with pytest.raises(UsageError, match="--metrics-port"):
        ServiceUnit("/py", metrics_port=port).files(Path("/units"))


@pytest.mark.parametrize("name", ["", "a/b", "a b", "-a", "%i", "a" * 65, "ä"])
def test_an_instance_that_can_not_be(name: str) -> None:
    with pytest.raises(UsageError, match="--instance"):
        ServiceUnit("/py", instance=name).files(Path("/units"))


def test_a_file_is_written_once_and_readable_for_all(tmp_path: Path) -> None:
    file = UnitFile(tmp_path / "x.service.d" / "x.conf", "text\n")
    mask = os.umask(0o077)
    try:
        assert file.write()
    finally:
        os.umask(mask)
    assert file.path.read_text() == "text\n"
    assert file.path.stat().st_mode & 0o777 == 0o644
    assert not file.write()
    assert UnitFile(file.path, "other\n").write()
    assert file.path.read_text() == "other\n"


@pytest.mark.parametrize("folder", HIDDEN)
def test_what_the_sandbox_hides_is_an_obstacle(folder: Path) -> None:
    [reason] = obstacles([folder / "venv" / "bin" / "python"])
    assert reason.endswith(f"which {HIDDEN[folder]} hides from it")


def test_a_link_into_a_hidden_folder_is_an_obstacle(tmp_path: Path) -> None:
    hidden = {tmp_path / "home": "ProtectHome="}
    (tmp_path / "home").mkdir()
    target = tmp_path / "home" / "python"
    target.touch()
    link = tmp_path / "python"
    link.symlink_to(target)
    assert any(
        f"{target} is in" in reason for reason in obstacles([link], hidden)
    )


def test_a_link_out_of_a_hidden_folder_is_an_obstacle(tmp_path: Path) -> None:
    hidden = {tmp_path / "home": "ProtectHome="}
    (tmp_path / "home").mkdir()
    link = tmp_path / "home" / "python"
    link.symlink_to(sys.executable)
    assert any(str(link) in reason for reason in obstacles([link], hidden))


def test_a_neighbour_of_a_hidden_folder_is_none() -> None:
    assert not obstacles([Path("/homeless/python"), Path("/rooted/python")])


@pytest.mark.parametrize(
    ("mode", "wanted"), [(0o600, "chmod o\\+r"), (0o640, "chmod o\\+r")]
)
def test_a_file_closed_to_others_is_an_obstacle(
    open_folder: Path, mode: int, wanted: str
) -> None:
    file = open_folder / "python"
    file.touch(mode)
    [reason] = obstacles([file], {})
    assert re.search(f"{re.escape(str(file))} is closed .*{wanted}", reason)
    file.chmod(0o644)
    assert not obstacles([file], {})


def test_a_folder_closed_to_others_is_an_obstacle(open_folder: Path) -> None:
    folder = open_folder / "venv"
    (folder / "bin").mkdir(parents=True)
    folder.chmod(0o750)
    [reason] = obstacles([folder / "bin", folder / "lib" / "x"], {})
    assert f"{folder} is closed to other users (chmod o+x)" in reason


def test_what_is_below_a_refused_place_is_not_named_again() -> None:
    places = [Path("/home/me/venv"), Path("/home/me/venv/bin/python")]
    assert len(obstacles(places)) == 1


def test_a_refusal_says_what_to_do() -> None:
    with pytest.raises(UsageError) as refusal:
        refuse_hidden([Path("/home/me/venv")])
    assert "/home/me/venv is in /home" in str(refusal.value)
    assert "-m venv /opt/bstm" in str(refusal.value)


def test_the_places_are_those_of_this_program() -> None:
    places = program_places()
    assert {Path(sys.executable), Path(sys.prefix)} <= set(places)
    names = {place.parent.name for place in places}
    assert {"bstm_daemon", "numpy", "can", "cantools"} <= names
    assert all(place.exists() for place in places)


def test_a_link_into_an_environment_stays_a_link(tmp_path: Path) -> None:
    """Resolved, it would be an interpreter without the environment."""
    link = tmp_path / "python"
    link.symlink_to(sys.executable)
    assert program_command(link) == f"{link} -P -m bstm_daemon.cli.main"


@pytest.mark.parametrize(
    "path", ["/a b/python", "/a%b/python", "/a$b", '/a"b', "/a\\b", "/a;b"]
)
def test_a_path_that_a_unit_would_read_otherwise(path: str) -> None:
    with pytest.raises(UsageError, match="not allowed in a unit"):
        require_plain(Path(path))
