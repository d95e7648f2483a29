"""Which drive to drive next: predicted by the model, kept by the reality."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap import advising
from bstm_daemon.analysis.gap.advising import (
    MENU,
    MOST_MEMBERS,
    Advice,
    Prospect,
    advise,
    candidate_drive,
    members_of,
    prospect,
    samples_of,
)
from bstm_daemon.analysis.gap.evidence import weigh
from bstm_daemon.analysis.gap.naming import Naming, name_effect
from bstm_daemon.analysis.gap.recording import recorded
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    sensed,
)
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.tunables import TUNABLES, Target
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.simulation import drive_names, load_drive, simulate
from bstm_daemon.simulation.parameters import Effects

from ...made_drives import driven  # noqa: TID252  (tests are no package)

if TYPE_CHECKING:
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config

TRUE, RIVAL = "disc_radiation_driving", "speed_dependent_convection"
MATCHED = {
    "thermal.heat_partition_correction_factor": 0.93,
    "cooling.s_per_s at 36 km/h": 1.63,
    "cooling.s_per_s at 70 km/h": 1.40,
    "cooling.s_per_s at 150 km/h": 1.25,
}
"""Factors that fit the simulated car on simalp and rich without an effect."""

AMONG = (TRUE, RIVAL, "hub_conduction")
ADVISED, POOR = "m13", "m15"


def signature(name: str, column: Column) -> Signature:
    return Signature(name, column, 0 * column, column, either_sign=False)


def known(residual: Column, *columns: Column) -> Linearised:
    rng = np.random.default_rng(1)
    found = [
        signature(name, column)
        for name, column in zip((TRUE, RIVAL), columns, strict=True)
    ]
    jacobian = rng.normal(0.0, 0.3, (len(residual), 2))
    return Linearised(residual, jacobian, tuple(found), (), ())


def drive(name: str, minutes: float, *columns: Column) -> Prospect:
    size = len(columns[0])
    found = {
        member: signature(member, column)
        for member, column in zip((TRUE, RIVAL), columns, strict=True)
    }
    return Prospect(name, name, 60.0 * minutes, np.zeros((size, 2)), found)


def test_the_drive_that_parts_the_twins_is_advised() -> None:
    rng = np.random.default_rng(4)
    one, two = rng.normal(0.0, 1.0, (2, 60))
    data = known(-one + 0.1 * two, one, one)

    found = advise(
        data,
        np.ones(2),
        (TRUE, RIVAL),
        [
            drive("alike", 10.0, one, one),
            drive("apart", 20.0, one, two),
            drive("apart, longer", 60.0, 2.0 * one, 2.0 * two),
        ],
    )

    by_name = {each.drive: each for each in found}
    assert [each.drive for each in found][-1] == "alike"
    assert by_name["alike"].named < 0.05
    assert by_name["apart"].named > 0.9
    assert by_name["apart"].wrong < 0.05
    assert by_name["apart"].log_bayes_factor > by_name["apart"].now + 5.0
    # as good but for less than chance: the shorter one first
    assert found[0].drive == "apart"


def test_what_is_drawn_is_as_sure_as_it_is_said_to_be() -> None:
    """Named with 95 % or more, at most one in twenty is wrong."""
    rng = np.random.default_rng(8)
    one, two = rng.normal(0.0, 1.0, (2, 60))
    data = known(-one, one, one)

    (found,) = advise(
        data,
        np.ones(2),
        (TRUE, RIVAL),
        [drive("a little apart", 10.0, 0.3 * one, 0.3 * two)],
    )

    assert 0.1 < found.named < 0.95
    assert found.wrong < 0.06


@pytest.mark.parametrize(
    ("short", "long", "first"),
    [
        (0.90, 0.91, "short"),
        # 9 % a minute against 1.5 %
        (0.87, 0.90, "short"),
        (0.10, 0.90, "long"),
        # below 2 % no drive is worth its minutes: the better one
        (0.010, 0.019, "long"),
        (0.0, 0.0, "long"),
    ],
)
def test_the_drive_with_the_most_names_a_minute_is_advised(
    monkeypatch: pytest.MonkeyPatch, short: float, long: float, first: str
) -> None:
    """Ten minutes against an hour."""
    odds = {"short": short, "long": long, "poor": 0.0}
    factors = {"short": 1.0, "long": 2.0, "poor": 0.5}
    minutes = {"short": 10.0, "long": 60.0, "poor": 5.0}

    def judged(_: object, one: Prospect) -> Advice:
        return Advice(
            *(one.drive, one.drive, one.duration_s, odds[one.drive], 0.0),
            *(factors[one.drive], 0.0),
        )

    monkeypatch.setattr(advising._Judge, "advice", judged)
    column = np.ones(10)
    found = advise(
        known(-column, column, column),
        np.ones(2),
        (TRUE, RIVAL),
        [drive(name, minutes[name], column, column) for name in odds],
    )

    assert found[0].drive == first
    assert [one.drive for one in found][-1] == "poor"


def test_the_menu_is_of_drives_that_there_are() -> None:
    assert set(MENU) <= set(drive_names())


@pytest.fixture(scope="module")
def target() -> Target:
    """Return the front of the example car, heat by pressure."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    changes = {
        "heat": config.heat.model_copy(update={"mode": "ff"}),
        "cooling": config.cooling.model_copy(update={"form": "conductance"}),
    }
    config = config.model_copy(update=changes)
    plain = Target(config, ("FL", "FR"))
    return plain.changed(
        {
            key: factor * plain.value(TUNABLES[key])
            for key, factor in MATCHED.items()
        }
    )


def present() -> dict[int, int]:
    signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    return present_roles(signal_map)


def real(name: str, config: Config, seed: int) -> Recording:
    """Return drive *name* of the simulated car with the hidden effect."""
    simulated = simulate(
        load_drive(name),
        preset=Effects(disc_radiation_driving=1.0),
        sensors="n2",
        seed=seed,
    )
    samples = samples_of(simulated, present(), temperatures=True)
    return recorded(name, [samples], config, present())


@pytest.mark.full  # six searches
@pytest.mark.slow
def test_the_advised_drive_resolves_what_a_poor_one_does_not(
    target: Target,
) -> None:
    """Radiation of the driving disc, below the gate on one drive alone."""
    config = target.config
    first = real("simalp", config, 11)
    comparison = compare(target, [first])
    data = sensed(comparison, AMONG).whitened(comparison)
    before = name_effect(comparison, data)
    members = members_of(before, data.silent)
    couples = {name: tuple(first.drive.measured[name]) for name in ("FL",)}
    drives = [
        candidate_drive(name, config, present(), couples)
        for name in (ADVISED, POOR)
    ]
    prospects = [
        prospect(
            compare(Target(config, ("FL",)), [recording]),
            members,
            description,
        )
        for recording, description in drives
    ]

    advice = advise(data, comparison.prior, members, prospects)

    assert before.answer == "nothing"
    assert {TRUE, RIVAL} <= set(members)
    assert [one.drive for one in advice] == [ADVISED, POOR]
    assert advice[0].named > 0.6
    assert advice[1].named < 0.3

    resolved = {ADVISED: 0, POOR: 0}
    for name in resolved:
        for seed in (21, 22):
            both = compare(target, [first, real(name, config, seed)])
            answer = name_effect(both, sensed(both, AMONG).whitened(both))
            resolved[name] += answer.names == (TRUE,)
            assert answer.names != (RIVAL,)

    assert resolved[ADVISED] == 2
    assert resolved[POOR] == 0


def test_the_data_so_far_weigh_as_elsewhere() -> None:
    """Worlds are drawn by the evidence that names an effect."""
    rng = np.random.default_rng(5)
    one, two = rng.normal(0.0, 1.0, (2, 60))
    data = known(0.4 * rng.normal(0.0, 1.0, 60) - 0.8 * one, one, two)
    prior = np.array([0.5, 2.0])
    judge = advising._Judge(data, prior, (TRUE, RIVAL))
    project = Projector(data.jacobian, prior)

    for row, own in enumerate(data.signatures):
        sign = effect_class(own.name).either_sign
        expected = weigh(
            project, data.residual, replace(own, either_sign=sign)
        )
        assert judge._logs_now[row, 0] == pytest.approx(expected.log_evidence)


def test_odds_and_advantage_of_the_true_one() -> None:
    """Three to one, and to nothing; half of the chance is nothing's."""
    column = np.ones(10)
    data = known(-column, column, column)
    judge = advising._Judge(data, np.ones(2), (TRUE, RIVAL))
    worlds = len(judge._which)
    logs = np.repeat(np.log([[3.0], [1.0]]), worlds, axis=1)

    assert judge._odds(logs)[:, 0].tolist() == pytest.approx(
        [1 / 2, 1 / 6, 1 / 3]
    )
    judge._which = np.zeros(worlds, int)
    assert judge._advantage(logs) == pytest.approx(np.log(3.0))
    judge._which = np.ones(worlds, int)
    assert judge._advantage(logs) == pytest.approx(-np.log(3.0))
    # each world has its own true one
    judge._which = np.arange(worlds) % 2
    logs[:, ::2] *= 2.0
    half = 0.5 * (2.0 - 1.0) * np.log(3.0)
    assert judge._advantage(logs) == pytest.approx(half)


def test_so_many_are_asked_about_as_can_be_told_apart() -> None:
    """The likeliest; below the gate also what the data could not show."""
    odds = {f"e{i}": 0.1 - 0.005 * i for i in range(12)} | {"": 0.3}
    among = Naming("class", ("e3", "e1"), 0.9, (), {**odds, "e2": 0.004}, "")

    left = members_of(among, ["silent"])
    assert left[:2] == ("e3", "e1")
    assert left[2:] == ("e0", "e4", "e5", "e6", "e7", "e8")
    nothing = among.answered("nothing", (), 0.3, "")
    likely = members_of(replace(nothing, odds=odds), ["silent"])
    assert likely == (*(f"e{i}" for i in range(MOST_MEMBERS)), "silent")
    assert MOST_MEMBERS == 8


def test_a_drive_is_predicted_as_it_would_be_read(config: Config) -> None:
    """Each two seconds, at the nodes that the model has."""
    profile = ((20.0, 0.0, 5.0), (20.0, 30e3, 30.0), (20.0, 0.0, 60.0))
    made = driven(config, "made", profile, every=4)

    found = advising._predicted(config, made, "FL", ("disc", "fluid", "rim"))

    assert found.keys() == {"disc", "fluid"}
    assert found["disc"].time_s.tolist() == made.time_s[::4].tolist()
    whole = made.measured["FL"]["disc"]
    assert found["disc"].temperature_k[1:] == pytest.approx(
        np.interp(found["disc"].time_s[1:], whole.time_s, whole.temperature_k),
        abs=6.0,
    )


def test_a_drive_shows_what_each_would_do_on_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those that change nothing are left out."""
    made = SimpleNamespace(name="m01", duration_s=90.0)
    comparison: Any = SimpleNamespace(
        recordings=[SimpleNamespace(drive=made)], start="start"
    )
    jacobian = np.ones((4, 2))
    monkeypatch.setattr(advising, "sensitivities", lambda *of: (of, jacobian))
    monkeypatch.setattr(
        advising,
        "signature_of",
        lambda of, name, base: None if name == RIVAL else (of, name, base),
    )

    found = prospect(comparison, (TRUE, RIVAL), "what it is")

    assert (found.drive, found.description) == ("m01", "what it is")
    assert found.duration_s == 90.0
    assert found.jacobian is jacobian
    assert found.signatures == {
        TRUE: (comparison, TRUE, (comparison, "start"))
    }
