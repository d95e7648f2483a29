"""What a command answers to a mistake.

One line that names the file, key or argument and what is allowed there, the
exit code of docs/reference.md, and no work before it.
"""

import gzip
import re
import shlex
import shutil
import sys
import time
from importlib import util
from pathlib import Path

import pytest

from bstm_daemon.cli.main import COMMANDS, main
from bstm_daemon.service import unit_files

ROOT = Path(__file__).parents[2]
LOGS = ROOT / "tests" / "golden" / "logs"
MOST_CPU_S = 2.0

USAGE, LOG, FILE, CONFIG = 2, 65, 74, 78

MISTAKES = [
    # arguments that no command has
    ("repaly drive.log -c car.toml", USAGE, "COMMAND.*'replay'"),
    ("check car.toml drive.log", USAGE, "bstm check: .* drive.log"),
    ("demo alpine", USAGE, "bstm demo: .* alpine"),
    ("demo --live --vew", USAGE, "bstm demo: .* --vew"),
    ("config", USAGE, "{schema}"),
    ("config shema", USAGE, "'shema': did you mean 'schema'"),
    ("shell fish", USAGE, "'fish': known are bash, man, tcsh, zsh"),
    ("bridge", USAGE, "{mqtt}"),
    ("fleet pln", USAGE, "STEP: no 'pln': did you mean 'plan'"),
    ("fmu exprt -c car.toml", USAGE, "did you mean 'export'"),
    ("model shw -c car.toml", USAGE, "did you mean 'show'"),
    ("gap rnu drive.log -c car.toml", USAGE, "did you mean 'run'"),
    ("gap drive.log -c car.toml", USAGE, "'drive.log': known are adopt"),
    ("identify drive.log -c car.toml", USAGE, "known are brakes, coastdown"),
    # arguments in each other's place
    ("replay car.toml -c drive.log", USAGE, "drive.log: this is a log, not"),
    ("heat car.toml -c car.toml", USAGE, "car.toml: this is a configuration"),
    ("check drive.log", USAGE, "drive.log: this is a log, not a config"),
    ("check car.dbc", CONFIG, "car.dbc: line 1"),
    ("init --dbc car.toml -o new.toml", CONFIG, "car.toml: not a DBC"),
    ("fleet plan --vehicles car.toml -o lake drive.log", CONFIG, "one car"),
    ("forecast -c car.toml --now car.toml", FILE, "--now car.toml: .* state"),
    ("gap run -c car.toml --holdout drive.log", USAGE, "--holdout took every"),
    # arguments that are missing, or of no use without another
    ("replay drive.log", USAGE, "-c/--config"),
    ("check", USAGE, "bstm check CONFIG"),
    ("init --dbc car.dbc", USAGE, "-o CAR.toml"),
    ("init --log drive.log -o new.toml", USAGE, "needs --dbc CAR.dbc"),
    ("simulate", USAGE, "DRIVE and -o LOG"),
    (
        "replay drive.log -c car.toml --repot x",
        USAGE,
        "did you mean '--report'",
    ),
    ("view --log drive.log", USAGE, "--log needs .* -c FILE"),
    ("demo --view", USAGE, "--live --view"),
    ("replay drive.log -c car.toml --speed 2", USAGE, "--speed .* --watch"),
    ("gap locate -c car.toml", USAGE, "logs are required"),
    ("fmu export -c car.toml", USAGE, "-o FILE.fmu"),
    ("bridge mqtt", USAGE, "--broker, or 'broker' in --credentials"),
    # files
    ("replay missing.log -c car.toml", FILE, "missing.log: .*No such file"),
    ("verify drive.log -c missing.toml", FILE, "missing.toml: No such file"),
    ("match folder -c car.toml", FILE, "folder: .*Is a directory"),
    ("run -c folder", FILE, "folder: Is a directory"),
    ("watch -c missing.toml", FILE, "missing.toml: No such file"),
    ("view -c car.toml --log missing.log", FILE, "missing.log: No such file"),
    ("init --dbc missing.dbc -o new.toml", FILE, "missing.dbc: .*No such"),
    ("forecast -c car.toml --now folder", FILE, "folder: is not a regular"),
    ("bridge mqtt --credentials missing", FILE, "missing: No such file"),
    ("fleet replay missing", FILE, "missing/plan.sqlite: no plan: .*plan'"),
    ("fleet report missing", FILE, "missing/plan.sqlite: no plan"),
    ("gap run drive.log -c car.toml --holdout missing.log", FILE, "missing"),
    # places that can not be written, or must not be
    ("replay drive.log -c car.toml -o /proc/x", FILE, "/proc/x: .*created"),
    ("replay drive.log -c car.toml --report no/x.html", FILE, "no/x.html: "),
    ("heat drive.log -c car.toml --json folder", FILE, "folder: .*directory"),
    ("simulate rich -o no/x.log", FILE, "no/x.log: .*No such file"),
    ("demo -o car.toml", FILE, "car.toml: cannot be created: File exists"),
    ("fmu export -c car.toml -o folder", FILE, "folder: cannot be written"),
    ("replay drive.log -c car.toml --publish drive.log", USAGE, "overwrite"),
    ("match drive.log -c car.toml -o car.toml", USAGE, "exists.*--force"),
    ("init --dbc car.dbc -o car.toml", USAGE, "car.toml: exists.*--force"),
    ("simulate rich -o x.blf", USAGE, "x.blf: .*ending .log"),
    ("model show -c car.toml -o x.png", USAGE, "must end in .svg or .json"),
    ("install-service -o /proc/x", FILE, "/proc/x.*No such file"),
    # names of effects, drives, interfaces ...
    ("simulate grosglockner -o x.log", USAGE, "did you mean 'grossglockner'"),
    ("simulate rich -o x.log --effect disk_hat=1", USAGE, "mean 'disc_hat'"),
    ("simulate rich -o x.log --effect disc_hat", USAGE, "NAME=STRENGTH"),
    ("gap advise -c car.toml --among disk_hat", USAGE, "mean 'disc_hat'"),
    ("verify drive.log -c car.toml --require golden", USAGE, "mean 'goal'"),
    ("replay drive.log -c car.toml --format paquet", USAGE, "'parquet'"),
    ("replay drive.log -c car.toml --map can0", USAGE, "IFACE=BUS"),
    ("replay drive.log -c car.toml --map can0=x", USAGE, "there are: chassis"),
    ("watch -i soketcan", CONFIG, "did you mean 'socketcan'"),
    ("fmu export -c car.toml -o x.fmu --platform x", USAGE, "linux64, aarch"),
    ("install-service -c car.toml --with vew", USAGE, "did you mean 'view'"),
    # numbers
    ("replay drive.log -c car.toml --every 0.25", USAGE, "multiple of 0.1 s"),
    ("run -c car.toml --bitrate -5", USAGE, "'-5' is not a whole number of 1"),
    ("run -c car.toml --duration -1", USAGE, "'-1' is not a number of 0 or"),
    ("run -c car.toml --metrics-port http", USAGE, "'http' .*from 0 to 65535"),
    ("watch --id-base car", USAGE, "0x0 to 0x7EC"),
    ("bridge mqtt --every often", USAGE, "'often' is not a number of 0 or"),
    ("view -c car.toml --log drive.log --speed -3", USAGE, "'-3' is not a"),
    ("view -c car.toml --log drive.log --listen x", USAGE, "ADDRESS:PORT"),
    ("fleet replay lake --jobs 0", USAGE, "'0' is not a whole number of 1"),
    ("simulate rich -o x.log --seed -1", USAGE, "--seed: '-1'"),
    ("simulate rich -o x.log --effect disc_hat=-1", USAGE, "-1 is not 0 to"),
    # logs
    ("replay empty.log -c car.toml", LOG, "empty.log: the log is empty"),
    ("heat words.log -c car.toml", LOG, "words.log: no data frame .*1 malf"),
    ("match notes.mf4 -c car.toml", LOG, "ending .mf4 but does not begin"),
    ("replay other.log.gz -c car.toml", LOG, "none of the wanted ids: .*seen"),
    ("check car.toml --log other.log.gz", LOG, "other.log.gz: none of the"),
    ("init --dbc car.dbc --log other.log.gz -o n.toml", LOG, "id of the DBC"),
    ("replay table.csv -c car.toml", LOG, "table.csv: is a signal table"),
    # configurations
    ("check key.toml", CONFIG, r"\[vehicle\] mas_kg .*mean 'mass_kg'"),
    ("replay drive.log -c section.toml", CONFIG, r"\[coling\].*'cooling'"),
    ("heat drive.log -c role.toml", CONFIG, r"\[signals.rian\].*'rain'"),
    ("run -c unit.toml", CONFIG, '"bar": .*speed needs .*km/h, mph'),
    ("check negative.toml", CONFIG, "mass_kg = -3.0: must be from 100 to 60"),
    ("check text.toml", CONFIG, 'mass_kg = "2194": must be a number from'),
    ("check effect.toml", CONFIG, r"\[\[effect\]\].*mean 'gap_conduction'"),
    ("match drive.log -c message.toml", CONFIG, "'Inertia': .* 'Inertial'"),
    ("fmu export -c signal.toml -o x.fmu", CONFIG, "'VehicleSpeed'"),
    ("check no_dbc.toml", CONFIG, "no.dbc: cannot be read: No such file"),
    ("check broken.toml", CONFIG, "broken.toml: line 1, column 9: "),
]
"""Command line, exit code, what the answer has."""

EDITS = {
    "key": ("mass_kg = 2194.0", "mas_kg = 2194.0"),
    "section": ("\n[cooling]\n", "\n[coling]\n"),
    "role": ("[signals.rain]", "[signals.rian]"),
    "unit": ('unit = "km/h"', 'unit = "bar"'),
    "negative": ("mass_kg = 2194.0", "mass_kg = -3.0"),
    "text": ("mass_kg = 2194.0", 'mass_kg = "2194"'),
    "effect": (
        "\n[thermal]\n",
        '\n[[effect]]\nname = "gap_conducton"\n\n[thermal]\n',
    ),
    "message": ('message = "Inertial"', 'message = "Inertia"'),
    "signal": ('signal = "VehicleSpeed"', 'signal = "VehicleSped"'),
    "no_dbc": ('dbc = "car.dbc"', 'dbc = "no.dbc"'),
    "broken": ("[vehicle]", "[vehicle"),
}
"""What is wrong in the configuration of this name."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a car, a drive and what is easily mistaken."""
    folder = tmp_path_factory.mktemp("desk")
    example = (ROOT / "config/example_vehicle.toml").read_text("utf-8")
    car = example.replace("../dbc/example_vehicle.dbc", "car.dbc")
    car = car.removeprefix("#:schema vehicle.schema.json\n")
    car = car[car.index("[vehicle]") :]
    shutil.copy(ROOT / "dbc/example_vehicle.dbc", folder / "car.dbc")
    shutil.copy(LOGS / "subaru.log.gz", folder / "other.log.gz")
    drive = gzip.decompress((LOGS / "stops.log.gz").read_bytes())
    (folder / "drive.log").write_bytes(drive)
    (folder / "folder").mkdir()
    texts = {
        "car.toml": car,
        "empty.log": "",
        "words.log": "this is not a log\n",
        "notes.mf4": "so is this",
        "table.csv": "time,speed\n0.0,1.0\n0.1,1.0\n",
    }
    for name, (before, after) in EDITS.items():
        assert before in car
        texts[f"{name}.toml"] = car.replace(before, after, 1)
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize(
    ("line", "code", "answer"), MISTAKES, ids=[one[0] for one in MISTAKES]
)
def test_a_mistake_has_one_line(
    *,
    line: str,
    code: int,
    answer: str,
    desk: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(desk)
    monkeypatch.setattr(unit_files, "program_places", list)
    monkeypatch.setattr(sys, "executable", "/opt/venv/bin/python")
    there = sorted(desk.iterdir())
    begun_s = time.process_time()

    ended = main(["-qq", *shlex.split(line)])

    spent_s = time.process_time() - begun_s
    out, err = capsys.readouterr()
    assert (ended, out) == (code, "")
    assert err.count("\n") == 1, err
    assert re.search(answer, err), err
    assert spent_s < MOST_CPU_S
    assert sorted(desk.iterdir()) == there


def test_every_command_is_mistaken() -> None:
    assert {line.split()[0] for line, *_ in MISTAKES} >= COMMANDS.keys()


@pytest.mark.parametrize(
    ("line", "package", "extra"),
    [
        ("replay drive.log -c car.toml --report x.html", "plotly", "report"),
        ("match drive.log -c car.toml -o new.toml", "tomlkit", "identify"),
        ("replay drive.log -c car.toml -o r --format mf4", "asammdf", "mf4"),
        ("view -c car.toml --log drive.log", "tornado", "view"),
        ("bridge mqtt --broker mqtt://localhost", "paho", "mqtt"),
        ("fleet replay lake", "distributed", "fleet"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    *,
    line: str,
    package: str,
    extra: str,
    desk: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(desk)
    found = util.find_spec
    monkeypatch.setattr(
        "bstm_daemon.errors.find_spec",
        lambda name: None if name == package else found(name),
    )

    assert main(shlex.split(line)) == USAGE

    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f"needs the package '{package}'" in err
    assert f"pip install 'bstm-daemon[{extra}]'" in err


@pytest.mark.parametrize("cut", ["cut.log", "cut.log.gz"])
def test_a_truncated_log_is_replayed_as_far_as_it_goes(
    cut: str,
    desk: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole = (desk / "drive.log").read_bytes()
    data = gzip.compress(whole) if cut.endswith(".gz") else whole
    path = tmp_path / cut
    path.write_bytes(data[: len(data) // 2 - 3])

    assert main(["replay", str(path), "-c", str(desk / "car.toml")]) == 0

    out = capsys.readouterr().out
    assert "cut short: its end is missing" in out or "1 malformed" in out
