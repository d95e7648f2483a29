"""Which of several signals gets a role."""

from collections.abc import Callable

import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup.proposal import Candidate, propose
from bstm_daemon.analysis.setup.recording import Recording, Samples, Series

Maker = Callable[..., Database]

WHEELS = [f"WS_{corner} m/s" for corner in ("FL", "FR", "RL", "RR")]
TIME_S = np.arange(0.0, 60.0, 0.02)
SPEED: Series = 15 + 5 * np.sin(0.3 * TIME_S)


def recorded(values: dict[tuple[str, str], Series]) -> Recording:
    return Recording(
        interface="can0",
        duration_s=60.0,
        samples={
            name: Samples(TIME_S[:: len(TIME_S) // len(value)], value)
            for name, value in values.items()
        },
    )


def by_role(candidates: tuple[Candidate, ...]) -> dict[str, str]:
    return {
        one.role: f"{one.match.message.name}.{one.match.signal.name}"
        for one in candidates
    }


def test_the_signal_that_is_in_the_log_wins(make_database: Maker) -> None:
    database = make_database(WHEELS, WHEELS)
    values = {("M1", name.split()[0]): SPEED for name in WHEELS}

    proposal = propose(database, recorded(values))

    assert by_role(proposal.sure)["wheel_speed_fl"] == "M1.WS_FL"
    assert proposal.unsure == ()


def test_the_faster_of_two_wins_and_the_other_is_named(
    make_database: Maker,
) -> None:
    database = make_database(WHEELS, WHEELS)
    values = {("M0", name.split()[0]): SPEED[::10] for name in WHEELS}
    values |= {("M1", name.split()[0]): SPEED for name in WHEELS}

    one = propose(database, recorded(values)).sure[0]

    assert one.match.message.name == "M1"
    assert "also M0.WS_FL" in one.reason


def test_a_signal_in_another_unit_than_the_dbc_says_is_unsure(
    make_database: Maker,
) -> None:
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    values["M0", "WS_RR"] = 3.6 * SPEED

    proposal = propose(make_database(WHEELS), recorded(values))

    assert "wheel_speed_rr" not in proposal.roles()
    (unsure,) = proposal.unsure
    assert "260.0 % off the other speeds" in unsure.reason


def test_an_angular_speed_may_have_any_usual_radius(
    make_database: Maker,
) -> None:
    """The radius of the car is not known: only the other unit is preferred."""
    database = make_database(WHEELS, ["WS_FL rad/s"])
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    values["M1", "WS_FL"] = SPEED / 0.32

    sure = by_role(propose(database, recorded(values)).sure)

    assert sure["wheel_speed_fl"] == "M0.WS_FL"


@pytest.mark.parametrize("with_log", [True, False])
def test_an_id_of_two_messages_is_read_as_one(
    make_database: Maker, *, with_log: bool
) -> None:
    database = make_database(WHEELS, ["LONG_ACCEL m/s2", "GEAR"])
    database.messages[1].frame_id = database.messages[0].frame_id
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    values["M1", "GEAR"] = np.round(SPEED)

    proposal = propose(database, recorded(values) if with_log else None)

    assert len({one.match.message.name for one in proposal.sure}) == 1
    assert by_role(proposal.unsure)["gear"] == "M1.GEAR"


def test_a_frame_of_another_length_is_not_ready(make_database: Maker) -> None:
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    recording = recorded(values)
    recording.lengths["M0"] = 12

    proposal = propose(make_database(WHEELS), recording)

    assert "wheel_speed_fl" in proposal.roles()
    assert not proposal.ready("wheel_speed_fl")


@pytest.mark.parametrize(
    ("felt", "stands"),
    [
        (0.03 * np.sin(7.0 * TIME_S), True),  # it shakes
        (1.5 * np.cos(0.3 * TIME_S), False),  # dv/dt: the sensors are dead
        (np.zeros_like(TIME_S), False),  # a dead accelerometer shows nothing
    ],
)
def test_an_axle_at_rest_on_a_stand_is_no_dead_sensor(
    make_database: Maker, felt: Series, *, stands: bool
) -> None:
    database = make_database(WHEELS, ["LONG_ACCEL m/s2"])
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    values["M0", "WS_FL"] = values["M0", "WS_FR"] = np.zeros_like(SPEED)
    values["M1", "LONG_ACCEL"] = felt

    proposal = propose(database, recorded(values))

    assert ("wheel_speed_fl" in proposal.roles()) == stands
    assert "wheel_speed_rl" in proposal.roles()
    if stands:
        by_name = {one.role: one for one in proposal.sure}
        assert "stand or roller" in by_name["wheel_speed_fr"].reason
        assert by_name["acceleration_longitudinal"].sign == 1


def test_one_wheel_at_rest_is_a_dead_sensor(make_database: Maker) -> None:
    database = make_database(WHEELS, ["LONG_ACCEL m/s2"])
    values = {("M0", name.split()[0]): SPEED for name in WHEELS}
    values["M0", "WS_FL"] = np.zeros_like(SPEED)
    values["M1", "LONG_ACCEL"] = 0.03 * np.sin(7.0 * TIME_S)

    proposal = propose(database, recorded(values))

    assert "wheel_speed_fl" not in proposal.roles()
