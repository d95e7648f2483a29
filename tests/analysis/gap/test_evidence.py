"""What is missing though no effect explains it; two effects at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.analysis.gap.changes import LARGEST
from bstm_daemon.analysis.gap.composing import CLEAR
from bstm_daemon.analysis.gap.evidence import (
    Candidate,
    cross_validated,
    explained_share,
    held_back,
    is_clearly_better,
    may_stand_in,
    missing_evidence,
    missing_probability,
    probabilities,
    strength_prior,
    unnamed_beside,
    weigh,
)
from bstm_daemon.analysis.gap.joint_effects import (
    JointEffects,
    _pairs,
    search_joint_effects,
)
from bstm_daemon.analysis.gap.naming import (
    AGAINST,
    EXPLAINED,
    GATE_Z,
    SOMETHING,
    SURE,
    UNEXPLAINED,
    name_effect,
)
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
)
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.matching.problem import Series
from bstm_daemon.analysis.statistics.evidence import (
    FREE,
    Projector,
    fit_terms,
)
from bstm_daemon.analysis.statistics.whitening import SensorNoise

POINTS = 300
MIXED_POINTS = 400
DRIVES = 2
NAMES = ("hub_conduction", "gap_conduction", "pad_wear", "disc_hat")
WHITE = SensorNoise(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PRIOR = np.ones(2)


def drive(number: int) -> Series:
    time_s = 10.0 * np.arange(POINTS)
    still = np.zeros(POINTS)
    return Series(
        number,
        "disc",
        (("FL", "disc"),),
        np.arange(POINTS),
        time_s,
        still,
        still,
        still,
    )


def test_a_strength_stays_within_what_physics_allows() -> None:
    """Data that ask for 3 get no more than 2.5, and less evidence."""
    change = np.ones(POINTS)
    most = Signature("cooling_band", change, 0.0 * change, change, False)
    project = Projector(np.zeros((POINTS, 2)), PRIOR)

    free = weigh(project, -3.0 * change, most)
    held = weigh(project, -3.0 * change, replace(most, most=2.5))

    assert free.strength == pytest.approx(3.0, abs=0.02)
    assert 2.3 < held.strength <= 2.5
    assert held.log_evidence < free.log_evidence
    grid, weights = strength_prior(2.5, either_sign=True)
    assert abs(grid).max() <= 2.5
    assert weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("near", [2.0, -2.0])
def test_what_is_simulated_on_one_side_says_nothing_of_the_other(
    near: float,
) -> None:
    change = np.ones(POINTS)
    both = Signature("change.disc_air", change, 0.0 * change, change, True)
    both = replace(both, even=True)
    there = replace(both, near=near)
    project = Projector(np.zeros((POINTS, 2)), PRIOR)

    free = weigh(project, -near * change, both)
    same = weigh(project, -near * change, there)
    other = weigh(project, near * change, there)

    # the side costs what it did when both were open
    assert same == free
    assert same.strength == pytest.approx(near, abs=0.02)
    assert other.strength * near > 0.0
    assert abs(other.strength) < 0.06
    assert other.log_evidence < 0.0


@pytest.mark.parametrize(
    ("strength", "deviation", "most", "share"),
    [
        (4.0, 0.1, LARGEST, 0.15),
        (-3.8, 0.3, LARGEST, 0.15),
        (3.6, 0.35, LARGEST, 0.0),
        (3.6, 2.0, LARGEST, 0.0),
        (3.7, 2.0, LARGEST, 0.15),
        (3.0, 9.0, LARGEST, 0.0),
        (2.4, 0.3, 2.5, 0.0),
        (3.9, 0.3, 3.95, 0.0),
        (8.0, 0.3, 10.0, 0.0),
    ],
)
def test_what_would_be_stronger_than_any_counts_less(
    strength: float, deviation: float, most: float, share: float
) -> None:
    """A tenth beyond at the most; not where physics ends elsewhere."""
    one = Candidate("caliper_bypass", strength, deviation, 60.0, 50.0, 1.0)

    counted = held_back(one, most)

    assert counted.log_evidence == pytest.approx(50.0 - share * 60.0)
    assert counted.gain == one.gain


@pytest.mark.parametrize(
    ("name", "stands_in"),
    [
        ("change.shim_resistance", False),
        ("change.effect.friction_fade.strength", False),
        ("change.disc_mass", True),
        ("caliper_bypass", True),
    ],
)
def test_what_can_fall_to_nothing_is_no_stand_in(
    name: str, *, stands_in: bool
) -> None:
    less = Candidate(name, -LARGEST, 0.3, 60.0, 50.0, 1.0)

    assert may_stand_in(less, LARGEST) == stands_in
    assert may_stand_in(replace(less, strength=LARGEST), LARGEST)


def test_strengths_are_tried_as_far_as_physics_has_room() -> None:
    usual, _ = strength_prior(either_sign=False)
    wide, _ = strength_prior(10.0, either_sign=True)

    assert usual[[0, -1]] == pytest.approx([0.05, LARGEST])
    assert wide.max() == -wide.min() == pytest.approx(10.0, rel=0.05)
    assert np.isin(usual, wide).all()


def test_one_of_usual_strength_is_named_before_a_stand_in(
    layout: Layout,
) -> None:
    """What would be 4.3 times the typical explains a little more."""
    at = np.arange(DRIVES * POINTS)
    own, beside = np.sin(at / 20.0), np.cos(at / 7.0)
    noise = np.random.default_rng(1).normal(size=len(at))
    strong = (2.0 * own + 0.35 * beside) / 4.3
    signatures = tuple(
        Signature(name, one, 0.0 * one, one, either_sign=False)
        for name, one in (("caliper_bypass", strong), ("shim_contact", own))
    )
    tunables = np.zeros((len(at), len(PRIOR)))
    known = Linearised(
        *(-2.0 * own - 0.35 * beside + noise, tunables, signatures, (), ())
    )

    found = name_effect(layout, known, alone=True)

    first, second = found.candidates
    assert (first.name, second.name) == ("shim_contact", "caliper_bypass")
    assert second.gain > first.gain
    assert (found.answer, found.names) == ("name", ("shim_contact",))


@pytest.fixture
def layout() -> Layout:
    series = [drive(number) for number in range(DRIVES)]
    return Layout(series, {"disc": WHITE}, PRIOR, ("a", "b"))


@pytest.fixture
def quiet() -> Linearised:
    """Return two drives with nothing missing."""
    rng = np.random.default_rng(4)
    size = DRIVES * POINTS
    signatures = []
    for name in NAMES:
        change = rng.normal(0.0, 0.2, size)
        signatures.append(
            Signature(name, change, 0.0 * change, change, either_sign=False)
        )
    heats = tuple(
        Unnamed(node, regime, rng.normal(0.0, 0.2, size))
        for node in ("disc", "fluid")
        for regime in ("braking", "driving", "parked")
    )
    return Linearised(
        rng.normal(0.0, 1.0, size),
        rng.normal(0.0, 1.0, (size, 2)),
        tuple(signatures),
        (),
        heats,
    )


def test_nothing_missing_is_said_to_be_nothing(
    layout: Layout, quiet: Linearised
) -> None:
    assert name_effect(layout, quiet).answer == "nothing"


def test_heat_at_one_place_does_not_pay_for_all_places(
    layout: Layout, quiet: Linearised
) -> None:
    project = Projector(quiet.jacobian, layout.prior)
    residual = quiet.residual - 0.9 * quiet.unknown[1].change
    everywhere = np.column_stack([one.change for one in quiet.unknown])

    at_one = missing_evidence(project, residual, quiet.unknown)

    assert (
        at_one
        > fit_terms(project, residual, everywhere, 1.0).log_evidence + 1.0
    )


def moved(
    layout: Layout, quiet: Linearised, deviations: dict[str, float]
) -> Linearised:
    """Return *quiet* where effects score these standard deviations."""
    project = Projector(quiet.jacobian, layout.prior)
    own = np.column_stack(
        [s.linear for s in quiet.signatures if s.name in deviations]
    )
    projected = project(own)
    gram = own.T @ projected
    aimed = -np.array(list(deviations.values())) * np.sqrt(np.diag(gram))
    short = aimed - projected.T @ quiet.residual
    residual = quiet.residual + own @ np.linalg.solve(gram, short)
    return replace(quiet, residual=residual)


def test_two_at_once_are_seen_though_neither_is_named(
    layout: Layout, quiet: Linearised
) -> None:
    one, two = NAMES[:2]
    alone = name_effect(layout, moved(layout, quiet, {one: 3.0, two: 0.0}))
    both = name_effect(layout, moved(layout, quiet, {one: 3.6, two: 3.6}))

    assert alone.answer == "nothing"
    assert both.gate_z < GATE_Z
    assert both.answer == "undecided"
    assert both.names[:2] in {(one, two), (two, one)}
    assert SOMETHING <= both.probability < 1.0


def test_below_the_gate_an_effect_is_likely_and_not_named(
    layout: Layout, quiet: Linearised
) -> None:
    weak = name_effect(layout, moved(layout, quiet, {NAMES[0]: 3.9}))
    plain = name_effect(layout, moved(layout, quiet, {NAMES[0]: 4.6}))

    odds = [weak.odds[name] for name in weak.names]
    enough = SURE * (1.0 - weak.odds[""])

    assert weak.answer == "undecided"
    # no more of them than it takes
    assert sum(odds) >= enough > sum(odds[:-1])
    assert len(odds) < len(NAMES)
    assert weak.names[0] == NAMES[0]
    assert SOMETHING <= weak.probability < 1.0
    assert weak.explained > 0.5
    assert weak.best_placebo_z < weak.gate_z
    assert plain.answer == "name"


@pytest.mark.slow
def test_a_pair_weighs_what_its_normal_strengths_do(
    layout: Layout, quiet: Linearised
) -> None:
    """Against the densities of both models, of free signs."""
    # a second to import, which every collection would wait for
    from scipy.stats import multivariate_normal  # noqa: PLC0415

    pair = tuple(replace(s, either_sign=True) for s in quiet.signatures[:2])
    known = moved(layout, replace(quiet, signatures=pair), {NAMES[0]: 5.0})
    project = Projector(known.jacobian, layout.prior)
    found = [weigh(project, known.residual, one) for one in pair]
    tunables = known.jacobian * layout.prior
    strengths = FREE * np.column_stack([s.linear for s in pair])
    free = np.eye(len(known.residual)) + tunables @ tunables.T

    with_pair = multivariate_normal.logpdf(
        known.residual, cov=free + strengths @ strengths.T
    )
    without = multivariate_normal.logpdf(known.residual, cov=free)

    *_, logs = _pairs(project, known, found)
    assert logs == pytest.approx([with_pair - without], abs=1e-6)


@pytest.mark.parametrize("known_of", [2, 1])
def test_a_pair_has_the_change_up_to_the_strengths_that_fit(
    layout: Layout, quiet: Linearised, known_of: int
) -> None:
    """Those of each one alone; 1 where that is not known."""
    curved = tuple(
        replace(one, curved=0.1 * one.linear, either_sign=True)
        for one in quiet.signatures[:2]
    )
    known = moved(layout, replace(quiet, signatures=curved), {NAMES[0]: 5.0})
    project = Projector(known.jacobian, layout.prior)
    found = [weigh(project, known.residual, one) for one in curved]
    strengths = [one.strength for one in found[:known_of]] + [1.0]
    straight = tuple(
        replace(s, linear=s.linear + strength * s.curved, curved=0 * s.curved)
        for s, strength in zip(curved, strengths, strict=False)
    )

    *_, expected = _pairs(project, replace(known, signatures=straight), found)

    assert max(abs(one.strength - 1.0) for one in found) > 0.1
    *_, logs = _pairs(project, known, found[:known_of])
    assert logs == pytest.approx(expected)


def test_without_heats_to_ask_for_much_that_is_left_is_not_guessed(
    layout: Layout, quiet: Linearised
) -> None:
    """As by forces alone: four effects, of which three could be named."""
    all_four = dict.fromkeys(NAMES, 5.5)
    known = replace(moved(layout, quiet, all_four), unknown=())

    found = name_effect(layout, known)

    assert found.answer == "unknown"
    assert found.unknown_place == ""


@pytest.mark.parametrize(
    ("of_heat", "answer"), [(1.6, "name"), (2.6, "unknown")]
)
def test_two_that_leave_much_stand_in_for_something_else(
    layout: Layout, quiet: Linearised, of_heat: float, answer: str
) -> None:
    """Little may be left of plain ones, whose forms are not the real ones."""
    pair = NAMES[:2]
    # 20 deviations are a usual strength
    signatures = tuple(
        replace(one, linear=10.0 * one.linear, kelvin=10.0 * one.kelvin)
        for one in quiet.signatures
    )
    quiet = replace(quiet, signatures=signatures)
    known = moved(layout, quiet, dict.fromkeys(pair, 20.0))
    heat = quiet.unknown[0].change
    known = replace(known, residual=known.residual - of_heat * heat)
    project = Projector(known.jacobian, layout.prior)
    both = search_joint_effects(
        project,
        known,
        sorted(
            (weigh(project, known.residual, one) for one in known.signatures),
            key=lambda one: -one.log_evidence,
        ),
    ).chosen
    explained, left = explained_share(project, known, both)

    found = name_effect(layout, known)

    assert found.answer == answer
    assert set(found.names) == (set(pair) if answer == "name" else set())
    # whichever the answer, something else is plainly there
    assert {one.name for one in both} == set(pair)
    assert explained == pytest.approx(found.explained)
    assert explained > EXPLAINED
    assert left > UNEXPLAINED
    assert unnamed_beside(project, known, both) > 0.0


def test_ways_of_missing_are_as_likely_each() -> None:
    assert missing_probability([0.0, 0.0, 0.0]) == pytest.approx(0.5)
    assert missing_probability([np.log(27.0), -np.inf, -np.inf]) == (
        pytest.approx(0.9)
    )
    assert missing_probability([-np.inf] * 3) == 0.0
    assert missing_probability([5000.0, 0.0, 0.0]) == pytest.approx(1.0)


def test_an_effect_that_another_drive_contradicts_is_not_named(
    layout: Layout, quiet: Linearised
) -> None:
    own = quiet.signatures[0]
    both = np.repeat((3.0, 0.0), POINTS)
    agreed = replace(quiet, residual=quiet.residual - 3.0 * own.kelvin)
    contradicted = replace(quiet, residual=quiet.residual - both * own.kelvin)

    named = name_effect(layout, agreed)
    refused = name_effect(layout, contradicted)

    assert (named.answer, named.names) == ("name", (own.name,))
    assert min(refused.cross_validated.values()) < -AGAINST
    assert refused.answer == "unknown"


def signature(name: str, change: np.ndarray) -> Signature:
    return Signature(name, change, 0.0 * change, change, either_sign=False)


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    found = {
        name: rng.normal(0.0, 1.0, MIXED_POINTS)
        for name in ("pad_wear", "wet_disc", "disc_hat")
    }
    # neither is missing, but alone it explains more than each that is
    own = rng.normal(0.0, 0.3, MIXED_POINTS)
    found["mass_error"] = 0.7 * (found["pad_wear"] + found["wet_disc"]) + own
    return found


def searched(
    columns: dict[str, np.ndarray], strengths: dict[str, float]
) -> JointEffects:
    rng = np.random.default_rng(12)
    residual = rng.normal(0.0, 1.0, MIXED_POINTS)
    for name, strength in strengths.items():
        residual = residual - strength * columns[name]
    signatures = tuple(signature(*one) for one in columns.items())
    linearised = Linearised(
        residual, rng.normal(0.0, 1.0, (MIXED_POINTS, 2)), signatures, (), ()
    )
    project = Projector(linearised.jacobian, PRIOR)
    found = sorted(
        (weigh(project, residual, one) for one in signatures),
        key=lambda one: -one.log_evidence,
    )
    return search_joint_effects(project, linearised, found)


def test_a_wrong_first_pick_is_undone(columns: dict[str, np.ndarray]) -> None:
    found = searched(columns, {"pad_wear": 1.2, "wet_disc": 0.8})

    assert {one.name for one in found.chosen} == {"pad_wear", "wet_disc"}
    assert set(found.sure) == {"pad_wear", "wet_disc"}
    assert found.share > 0.9


def test_one_effect_stays_alone(columns: dict[str, np.ndarray]) -> None:
    found = searched(columns, {"pad_wear": 1.0})

    assert [one.name for one in found.chosen] == ["pad_wear"]
    assert found.sure == ("pad_wear",)
    assert found.leftover is not None


def test_what_is_small_beside_the_first_is_not_added(
    columns: dict[str, np.ndarray],
) -> None:
    found = searched(columns, {"pad_wear": 3.0, "disc_hat": 0.4})

    assert [one.name for one in found.chosen] == ["pad_wear"]
    assert found.leftover is not None
    assert found.leftover.name == "disc_hat"
    assert found.leftover.z > 5.0


@pytest.mark.parametrize(
    ("first", "second", "is_added"),
    [
        ("pad_wear", "clock_offset", False),
        ("pad_wear", "disc_hat", True),
        ("thermocouple_lag", "disc_hat", False),
        ("thermocouple_offset", "clock_offset", True),
    ],
)
def test_a_late_sensor_and_a_twin_beside_an_effect_must_be_plainer(
    columns: dict[str, np.ndarray],
    first: str,
    second: str,
    is_added: bool,  # noqa: FBT001
) -> None:
    """A fifth of the first one's gain is what another form leaves."""
    a, b, *_ = (one / np.linalg.norm(one) for one in columns.values())
    both = {first: 30.0 * a, second: 30.0 * (b - (a @ b) * a)}

    found = searched(both, {first: 1.0, second: 0.42})

    assert {one.name for one in found.chosen} == (
        {first, second} if is_added else {first}
    )
    more = searched(both, {first: 1.0, second: 0.8})
    assert {one.name for one in more.chosen} == {first, second}


def test_a_twin_that_makes_up_for_the_form_is_not_added() -> None:
    """Late by a strength of 3, of which the course bends."""
    rng = np.random.default_rng(13)
    late, bent, own, noise = rng.normal(0.0, 1.0, (4, MIXED_POINTS))
    lag = replace(signature("thermocouple_lag", late), curved=bent)
    clock = signature("clock_offset", bent)
    other = signature("wet_disc", bent)

    def chosen(residual: np.ndarray, second: Signature) -> list[str]:
        known = Linearised(
            residual, np.zeros((MIXED_POINTS, 2)), (lag, second), (), ()
        )
        project = Projector(known.jacobian, PRIOR)
        found = [weigh(project, residual, one) for one in (lag, second)]
        several = search_joint_effects(project, known, found)
        return sorted(one.name for one in several.chosen)

    bends = noise - lag.at(3.0)
    assert chosen(bends, clock) == ["thermocouple_lag"]
    # what is no twin may be beside it, and so may a twin that is plain
    assert chosen(bends, other) == ["thermocouple_lag", "wet_disc"]
    plain = signature("clock_offset", own)
    both = noise - lag.at(1.0) - plain.at(2.0)
    assert chosen(both, plain) == ["clock_offset", "thermocouple_lag"]


def inverse_of(known: Linearised) -> np.ndarray:
    """Return the inverse covariance of the residual, tunables left free."""
    tunables = known.jacobian * PRIOR
    return np.linalg.inv(np.eye(len(tunables)) + tunables @ tunables.T)


def log_bayes_factor(
    known: Linearised, own: np.ndarray, *, either_sign: bool
) -> float:
    """Return it by the normal densities at every strength of the prior."""
    inverse = inverse_of(known)
    grid, weights = strength_prior(either_sign=either_sign)
    left = known.residual[:, None] + np.outer(own, [0.0, *grid])
    logs = -0.5 * np.einsum("ig,ij,jg->g", left, inverse, left, optimize=True)
    return float(np.log(np.sum(weights * np.exp(logs[1:] - logs[0]))))


@pytest.mark.parametrize("either_sign", [False, True])
def test_an_effect_weighs_what_the_densities_do(
    quiet: Linearised, *, either_sign: bool
) -> None:
    """And its strength, deviation and reach are those of the best fit."""
    one = replace(quiet.signatures[0], either_sign=either_sign)
    known = replace(quiet, residual=quiet.residual - 1.3 * one.linear)
    project = Projector(known.jacobian, PRIOR)

    found = weigh(project, known.residual, one)

    assert found.log_evidence == pytest.approx(
        log_bayes_factor(known, one.linear, either_sign=either_sign), abs=1e-6
    )
    inverse = inverse_of(known)
    slope = one.linear @ inverse @ one.linear
    best = -(one.linear @ inverse @ known.residual) / slope
    assert found.strength == pytest.approx(best, abs=0.005)
    assert found.deviation == pytest.approx(slope**-0.5)
    assert found.reach == pytest.approx(3.5 * slope**-0.5)
    assert found.gain == pytest.approx(0.5 * slope * best**2, rel=1e-4)
    assert found.z == pytest.approx(best * slope**0.5, rel=1e-4)


def test_each_drive_is_weighed_by_what_the_others_leave_open(
    layout: Layout, quiet: Linearised
) -> None:
    """Evidence of both drives less that of the other one alone."""
    one = quiet.signatures[0]
    known = replace(quiet, residual=quiet.residual - 1.3 * one.linear)

    found = cross_validated(layout, known, one)

    def evidence(part: slice) -> float:
        some = replace(
            known,
            residual=known.residual[part],
            jacobian=known.jacobian[part],
        )
        return log_bayes_factor(some, one.linear[part], either_sign=False)

    whole, first, second = (
        evidence(part)
        for part in (slice(None), slice(0, POINTS), slice(POINTS, None))
    )
    assert found == pytest.approx(
        {"a": whole - second, "b": whole - first}, abs=1e-6
    )


def test_strengths_are_log_normal_about_the_typical_one() -> None:
    """exp(-0.2), and of both signs the typical one thrice as likely."""
    grid, weights = strength_prior(either_sign=False)
    assert grid[[0, -1]] == pytest.approx([0.05, 4.0])
    assert len(grid) == 60
    assert weights.sum() == pytest.approx(1.0)
    assert grid[np.argmax(weights)] == pytest.approx(np.exp(-0.2), rel=0.04)
    at_one, at_most = np.argmin(np.abs(grid - 1.0)), -1
    assert weights[at_most] / weights[at_one] == pytest.approx(
        np.exp(
            (np.log(grid[at_one]) + 0.2) ** 2 / 1.28
            - (np.log(4.0) + 0.2) ** 2 / 1.28
        )
    )

    both, shares = strength_prior(either_sign=True)
    assert both.tolist() == [*(-grid[::-1]), *grid]
    assert shares[60:].tolist() == pytest.approx((0.75 * weights).tolist())
    assert shares[:60].tolist() == pytest.approx(
        (0.25 * weights[::-1]).tolist()
    )


def test_probabilities_of_candidates_and_of_nothing() -> None:
    """Half for nothing before data, the rest shared."""
    likely = Candidate("a", 1.0, 0.1, 1.0, float(np.log(3.0)), 1.0)
    even = replace(likely, name="b", log_evidence=0.0)

    assert probabilities([likely, even]) == pytest.approx(
        {"": 1 / 3, "a": 1 / 2, "b": 1 / 6}
    )
    assert probabilities([]) == {"": 1.0}


def test_what_would_be_detected_is_told_of_small_signatures_too() -> None:
    """3.5 deviations of noise: of the size that the residual has not."""
    column = 0.01 * np.ones(100)
    one = Signature("a", column, 0.0 * column, column, either_sign=True)
    project = Projector(np.zeros((100, 0)), np.zeros(0))

    found = weigh(project, np.zeros(100), one)

    assert found.reach == pytest.approx(3.5 / 0.1)


@pytest.mark.parametrize(
    ("gain", "named", "better"),
    [
        (29.9, 20.0, False),
        (30.1, 20.0, True),
        # half as much again, where that is more
        (89.9, 60.0, False),
        (90.1, 60.0, True),
        (9.9, 0.0, False),
    ],
)
def test_a_name_goes_for_what_is_clearly_better(
    gain: float, named: float, *, better: bool
) -> None:
    assert is_clearly_better(gain, named, CLEAR) is better
