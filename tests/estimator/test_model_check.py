"""A model that disagrees: told, kept, and what is kept is named from."""

from __future__ import annotations

import json
import random
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from cantools.database.can import Database

from bstm_daemon.bus.live.link import Frame
from bstm_daemon.bus.opening import open_log
from bstm_daemon.cli.main import main
from bstm_daemon.estimate import Reason, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.model_check import Couple
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.service.assembly import BusOverride, Monitor, build_monitor
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.intake import Intake
from bstm_daemon.service.metrics import StatusMetrics
from bstm_daemon.service.reporting import ServiceReporter
from bstm_daemon.service.sender import Sender
from bstm_daemon.service.status import StateFileStatus, collected, status_line
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.parameters import Effects
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config, CornerConfig
    from bstm_daemon.estimator.blocks import Block

ROOT = Path(__file__).parents[2]
SECOND = 1_000_000
CAR = Database()
CAR.add_dbc_file(ROOT / "dbc" / "example_vehicle.dbc")
DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")

pytestmark = [pytest.mark.slow] if load_kernel() is None else []

HOT = """
[drive]
name = "hot"
description = "a short descent, then parked"
ambient_c = 15.0
thermocouple_logger = true
[[segment]]
speed_kmh = 45.0
rate_ms2 = 2.0
gear = 3
duration_s = 240.0
grade_percent = -10.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
gear = 0
[[segment]]
parked = true
duration_s = 200.0
"""

STOPS = """
[drive]
name = "stops"
description = "four stops"
ambient_c = 15.0
[[segment]]
repeat = 4
[[segment.segment]]
speed_kmh = 90.0
rate_ms2 = 3.0
gear = 3
[[segment.segment]]
speed_kmh = 20.0
rate_ms2 = 4.0
gear = 3
"""

ACCURACY = """
[accuracy]
disc_k = 8.0
pad_front_k = 6.0
pad_back_k = 6.0
fluid_k = 4.0
"""


class Lines:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []

    def _take(self, event: str, **fields: Any) -> None:
        self.said.append((event, fields))

    debug = info = warning = error = _take

    def of(self, name: str) -> list[dict[str, Any]]:
        """Return the fields of each line *name*."""
        return [fields for event, fields in self.said if event == name]


class Seen(NamedTuple):
    """What a drive beside the service left."""

    car: Path
    lines: Lines
    flags: list[str]
    text: str
    metrics: str
    monitor: Monitor


def car(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the example car with *changes* of its text."""
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    head, record, tail = text.partition("[record]")
    text = head + record + tail.replace("enabled = false", "enabled = true", 1)
    for old, new in (
        ('"../dbc/', f'"{ROOT}/dbc/'),
        ('interface = "socketcan"', 'interface = "virtual"'),
        *changes,
    ):
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "car.toml"
    path.write_text(text + ACCURACY, encoding="utf-8")
    return path


def beside(
    folder: Path,
    path: Path,
    drive: str,
    effects: Effects,
    heard: Callable[[int, int, bytes], bytes] = lambda *sent: sent[-1],
) -> Seen:
    """Let the car of *path* hear *drive* as the live service does.

    Everything is the service's own but the clock, which is the log's.
    *heard* makes of the time in the drive, the id and what was sent what is
    heard.
    """
    log = folder / "drive.log"
    simulated = simulate(parse_drive(drive, "own"), preset=effects, seed=2)
    write_candump(
        log, simulated, Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    )
    monitor = build_monitor(path, BusOverride(), forecast=False)
    axis, lines = SteadyAxis(), Lines()
    intake = Intake(monitor.links(), axis)
    sender = Sender(None, frozenset(), monitor.engine.publication)
    reporter = ServiceReporter(ServiceLog(lines), axis, folder, None)
    reporter.begin(monitor, intake, sender)
    engine, flags = monitor.engine, []
    engine.estimator.start.end()
    status = DATABASE.get_message_by_name("BSTM_Status")
    next_us = tick_us = first_us = 0
    for chunk in open_log(log).chunks():
        for stamp_us, can_id, payload, length in zip(
            chunk.time_us.tolist(),
            chunk.can_id.tolist(),
            chunk.data,
            chunk.length.tolist(),
            strict=True,
        ):
            first_us = first_us or stamp_us
            data = heard(
                stamp_us - first_us, can_id, payload.tobytes()[:length]
            )
            if stamp_us >= tick_us:
                tick_us = stamp_us // SECOND * SECOND + SECOND
                published = engine.tick(stamp_us)
                reporter.note_flags()
                flags += [
                    str(status.decode(one.frame.data)["ModelDisagrees"])  # type: ignore[index]
                    for one in published
                    if one.frame.name == "BSTM_Status"
                ]
                if next_us:
                    reporter.report(StateFileStatus(), stamp_us)
                next_us = stamp_us
            engine.frame(0, can_id, False, data, stamp_us)
            reporter.record(
                stamp_us,
                0,
                Frame(stamp_us * 1000, can_id, False, data, False, False),
            )
    told = collected(monitor, intake, sender, 0)
    reporter.close()
    intake.close()
    metrics = StatusMetrics()
    metrics.update(told)
    text = metrics.text().decode()
    return Seen(path, lines, flags, status_line(told), text, monitor)


def kept(folder: Path) -> Path:
    """Return the folder of the only record that was kept."""
    (found,) = (folder / "record" / "kept").iterdir()
    return found


@pytest.mark.slow
def test_a_hidden_effect_is_noticed_kept_and_named(tmp_path: Path) -> None:
    seen = beside(tmp_path, car(tmp_path), HOT, Effects(gap_conduction=3.0))

    assert seen.flags[0] == "none"
    assert seen.flags[-1] == "disagrees"
    what = {one["what"] for one in seen.lines.of("model_disagrees")}
    assert "FL pad_front" in what
    assert {"reason": "model"} in seen.lines.of("record_kept")
    assert "model disagrees: " in seen.text
    assert 'bstm_model_disagrees{what="FL pad_front"} 1.0' in seen.metrics

    record, result = kept(tmp_path), tmp_path / "gap.json"
    code = main(
        [
            *("gap", "name", str(record), "-c", str(seen.car), "--anyway"),
            *("--json", str(result)),
        ]
    )

    assert code == 0
    (corner, *_) = json.loads(result.read_text("utf-8"))["corners"]
    assert corner["naming"]["answer"] != "nothing"
    names = [one["name"] for one in corner["naming"]["candidates"][:2]]
    assert "gap_conduction" in names


@pytest.mark.slow
@pytest.mark.parametrize("error", ["offset", "drift"])
def test_readings_that_are_known_to_be_poor_do_not_disagree(
    tmp_path: Path, error: str
) -> None:
    path = car(tmp_path)
    with path.open("a", encoding="utf-8") as file:
        file.write(f"thermocouple_{error}_k = 60.0\n")

    seen = beside(tmp_path, path, HOT, Effects(gap_conduction=3.0))

    assert seen.lines.of("model_disagrees") == []


def test_a_sound_model_raises_nothing(tmp_path: Path) -> None:
    seen = beside(tmp_path, car(tmp_path), STOPS, Effects())

    assert set(seen.flags) == {"none"}
    assert seen.lines.of("model_disagrees") == []
    assert (
        abs(seen.monitor.engine.estimator.model_check.force_difference) < 0.1
    )
    assert 'bstm_model_disagrees{what="heat"} 0.0' in seen.metrics
    assert not (tmp_path / "record" / "kept").exists()


@pytest.mark.slow
def test_what_is_found_wrong_is_no_disagreement(tmp_path: Path) -> None:
    """A plug works loose: thrice the pressure, seen only once it is noise."""
    chance = random.Random(0)  # noqa: S311
    message = CAR.get_message_by_name("BrakePressure")
    found: list[int] = []

    def heard(at_us: int, can_id: int, data: bytes) -> bytes:
        if can_id != message.frame_id or at_us > 60 * SECOND:
            return data
        if at_us % (5 * SECOND) > 4 * SECOND:
            return chance.randbytes(len(data))
        values = message.decode(data, decode_choices=False)
        assert isinstance(values, dict)
        found.append(can_id)
        return message.encode(
            {name: 3.0 * float(one) for name, one in values.items()},  # type: ignore[arg-type]
            strict=False,
        )

    long = STOPS.replace("repeat = 4", "repeat = 16")
    seen = beside(tmp_path, car(tmp_path), long, Effects(), heard)

    assert found
    assert {"fault": "pressure suspect"} in seen.lines.of("input_fault")
    assert {"what": "heat"} not in seen.lines.of("model_disagrees")
    assert (
        abs(seen.monitor.engine.estimator.model_check.force_difference) < 0.1
    )


def test_pressure_and_motion_that_differ_are_noticed(tmp_path: Path) -> None:
    """Pads that grip less than configured, which mode fused would learn."""
    weak = ("friction_coefficient = 0.38", "friction_coefficient = 0.65")
    path = car(tmp_path, weak, ('mode = "auto"', 'mode = "ff"'))
    seen = beside(tmp_path, path, STOPS, Effects())

    assert seen.flags[-1] == "disagrees"
    assert seen.lines.of("model_disagrees") == [{"what": "heat"}]
    assert seen.monitor.engine.estimator.model_check.force_difference > 0.3
    assert kept(tmp_path).name.endswith("-model")


def test_the_first_reading_of_a_couple_is_one_of_many() -> None:
    """A spike as the ignition comes on is no disagreement later."""
    couple = Couple("FL", "disc", "disc", floor_k=8.0, share=0.05)
    couple.take(1500.0, 50.0, 0.1)
    for _ in range(2000):
        couple.take(5.0, 50.0, 0.1)
        assert not couple.disagrees
    assert couple.mean_k == pytest.approx(5.0, abs=2.0)


def test_a_couple_goes_on_after_a_restart() -> None:
    """What it knew counts; what is no memory of one is refused."""
    before, after = (
        Couple("FL", "disc", "disc", floor_k=8.0, share=0.05) for _ in range(2)
    )
    for _ in range(2000):
        before.take(60.0, 200.0, 0.1)
    assert before.disagrees

    after.restore(json.loads(json.dumps(before.export())))

    for couple in (before, after):
        couple.take(20.0, 200.0, 0.1)
    assert after == before
    assert after.disagrees
    with pytest.raises(ValueError, match="valid number"):
        after.restore(before.export() | {"known_s": None})


CORNERS = ("FL", "FR", "RL", "RR")
MOTION = ("acceleration_longitudinal", "powertrain_torque")
FORMED = ("vehicle_speed", "primary_pressure", *MOTION)
Spans = list[tuple[float, dict[str, float]]]


def marched(config: Config, spans: Spans) -> tuple[Estimator, list[Block]]:
    """Run held values over (seconds, values by role), start known."""
    names = sorted({name for _, values in spans for name in values})
    estimator = Estimator(
        config,
        {ROLE_INDEX[name]: 5 * SECOND for name in names},
        history_known=True,
    )
    times, roles, values = array("q"), array("i"), array("d")
    at_us = 0
    for seconds, held in spans:
        for _ in range(round(seconds * 10)):
            for name, value in held.items():
                times.append(at_us)
                roles.append(ROLE_INDEX[name])
                values.append(value)
            at_us += SECOND // 10
    return estimator, estimator.advance(times, roles, values)


def disagreeing(blocks: list[Block], corner: str) -> list[bool]:
    """Whether the model disagrees strongly, at each publication."""
    bit = Reason.MODEL_DISAGREES
    return [bool(c & bit) for b in blocks for c in b.reasons[corner]]


@pytest.mark.parametrize(
    ("share", "weak", "strong"),
    [(1.0, False, False), (0.5, True, False), (0.35, True, True)],
)
def test_works_far_apart_degrade_every_corner(
    steady: Callable[[float], tuple[Config, Spans]],
    share: float,
    weak: bool,  # noqa: FBT001
    strong: bool,  # noqa: FBT001
) -> None:
    """Half is a gap of the model, a third is a wrong input."""
    config, spans = steady(share)

    estimator, blocks = marched(config, spans)

    assert estimator.model_check.force_difference == pytest.approx(
        share - 1.0, abs=0.02
    )
    assert blocks[-1].at(len(blocks[-1].times_us) - 1).model_disagrees is weak
    for corner in CORNERS:
        assert disagreeing(blocks, corner)[-1] is strong
        assert any(disagreeing(blocks, corner)) is strong


@pytest.fixture
def steady(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Callable[[float], tuple[Config, Spans]]:
    """Return the maker of a minute at 20 m/s against the brakes.

    Its argument is the work by pressure over that by motion.
    """
    config = make_car(
        *(make_corner(name) for name in CORNERS), heat={"mode": "ff"}
    )
    held = dict(zip(FORMED, (20.0, 20e5, 0.0, 0.0), strict=True))

    def make(share: float) -> tuple[Config, Spans]:
        _, (block,) = marched(config, [(2.0, held)])
        pressed_n = (
            sum(
                block.at(15).channel(name, "brake_power_w") for name in CORNERS
            )
            / 20.0
        )
        drag_n = Vehicle.of_config(config.vehicle).resistance_n(20.0)
        torque = (pressed_n / share + drag_n) * config.vehicle.wheel_radius_m
        return config, [(60.0, held | {MOTION[1]: torque})]

    return make


def test_a_thermocouple_far_off_degrades_its_corner_and_is_remembered(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> None:
    """200 K above a cold disc for 150 s; 30 times as long after it."""
    cooling = {"speed_ms": [0.0, 40.0], "s_per_s": [0.02, 0.02]}
    config = make_car(
        *(make_corner(name) for name in ("FL", "FR")),
        heat={"mode": "ff"},
        cooling=cooling,
    )
    parked = {"vehicle_speed": 0.0, "primary_pressure": 0.0}
    hot, right = (
        parked | {"temp_fl_disc": kelvin, "temp_fr_disc": 293.15}
        for kelvin in (493.15, 293.15)
    )

    _, blocks = marched(config, [(150.0, hot), (400.0, right)])

    front_left = disagreeing(blocks, "FL")
    # known from 120 s on; the mean of two minutes then falls to 30 K
    assert front_left.index(True) / 10 == pytest.approx(120.0, abs=1.0)
    assert all(front_left[1210:])
    assert not any(disagreeing(blocks, "FR"))
    assert blocks[-1].validity["FL"][-1] == Validity.DEGRADED


def test_a_strong_disagreement_ends_within_the_tolerance() -> None:
    """It comes at one and a half times the tolerance of 30 K."""
    couple = Couple("FL", "disc", "disc", floor_k=10.0, share=0.0)
    seen = []
    for residual_k in (40.0, 60.0, 40.0, 20.0):
        for _ in range(2000):
            couple.take(residual_k, 0.0, 1.0)
        seen.append((couple.disagrees, couple.strongly))

    assert seen == [(True, False), (True, True), (True, True), (True, False)]


def test_what_disagreed_counts_after_the_car_stood(
    steady: Callable[[float], tuple[Config, Spans]],
) -> None:
    """The state of a parked car: held as long as the brakes remember."""
    config, spans = steady(0.3)
    before, _ = marched(config, spans)
    document = json.loads(
        json.dumps({"model_check": before.model_check.export()})
    )
    after, _ = marched(config, [(0.5, spans[0][1])])

    after.model_check.resume(document, 60.0)

    assert after.model_check.holds("FL", 0.1, found=False)
    assert after.model_check.disagreements == ()
    after.model_check.park(1e6)
    assert not after.model_check.holds("FL", 0.1, found=False)
    after.model_check.resume(document, None)
    assert after.model_check.disagreements == ("heat",)
    after.model_check.resume({"model_check": {"trust": 1}}, None)
