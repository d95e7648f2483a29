"""Names, classes and silence on drives whose missing effect is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.evidence import Candidate, probabilities, weigh
from bstm_daemon.analysis.gap.fitting import directions, fit
from bstm_daemon.analysis.gap.holdout_comparison import (
    CONFIGURED,
    EXTENDED,
    REFITTED,
    show,
)
from bstm_daemon.analysis.gap.naming import Naming, cosine, name_effect
from bstm_daemon.analysis.gap.searching import search
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    candidates,
    sensed,
)
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.model.effects.catalogue import effect_class, effect_names

from ...made_drives import effect_entries  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config

AMONG = (
    "gap_conduction",
    "hub_conduction",
    "disc_radiation_driving",
    "backplate_loss",
    "bracket_conduction",
    "caliper_radiation",
    "shim_contact",
)
LEFT: Final = 100.0
"""Of log-likelihood, put where no heat is."""
MANY_TOGETHER: Final = 3
"""Of the directions of all effects, by size, one that takes many of them."""


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing(
    target: Target, made: Callable[..., Recording]
) -> None:
    comparison = compare(target, [made()])

    found = name_effect(
        comparison, sensed(comparison, AMONG).whitened(comparison)
    )

    assert found.answer == "nothing"
    assert found.probability > 0.5
    assert all(np.isfinite(one.reach) for one in found.candidates)


@pytest.mark.slow
def test_what_an_adopted_effect_is_off_by_is_no_further_one(
    config: Config, made: Callable[..., Recording]
) -> None:
    """A strength of `[[effect]]` is no better known than any tunable."""
    weak = with_effects(config, effect_entries({"gap_conduction": 0.7}))
    comparison = compare(
        Target(weak, ("FL",)), [made({"gap_conduction": 1.0})]
    )
    among = [name for name in AMONG if name != "gap_conduction"]

    found = name_effect(
        comparison, sensed(comparison, among).whitened(comparison)
    )

    assert found.answer == "nothing"
    assert found.gate_z < 2.0


@pytest.mark.slow
def test_noise_of_a_reading_is_no_error_of_its_gain(
    target: Target, made: Callable[..., Recording]
) -> None:
    """Noise of 4 K, as great in the residual as in the reading."""
    comparison = compare(target, [made(noise_k=4.0)])
    simulated = sensed(comparison, ["thermocouple_offset"])

    _, found = search(comparison, simulated, directions(comparison))

    assert found.answer == "nothing"
    assert found.gate_z < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gap_conduction", "shim_contact"])
def test_the_hidden_effect_is_named(
    target: Target, made: Callable[..., Recording], name: str
) -> None:
    recordings = [made({name: 1.3}), made({name: 1.3}, "other", seed=2)]
    comparison = compare(target, recordings)

    found = name_effect(
        comparison, sensed(comparison, AMONG).whitened(comparison)
    )

    assert (found.answer, found.names) == ("name", (name,))
    assert found.candidates[0].strength == pytest.approx(1.3, rel=0.1)
    assert found.best_placebo_z < found.gate_z
    assert all(gain > 0.0 for gain in found.cross_validated.values())


def test_twins_are_a_class(
    target: Target, made: Callable[..., Recording]
) -> None:
    comparison = compare(target, [made({"backplate_loss": 4.0})])
    among = ("backplate_loss", "bracket_conduction", "gap_conduction")

    found = name_effect(
        comparison, sensed(comparison, among).whitened(comparison)
    )

    assert found.names[0] in {"backplate_loss", "bracket_conduction"}
    assert found.answer in {"name", "class"}
    if found.answer == "class":
        assert set(found.names) == {"backplate_loss", "bracket_conduction"}


def test_without_the_right_candidate_no_name_is_forced(
    target: Target, made: Callable[..., Recording]
) -> None:
    comparison = compare(target, [made({"gap_conduction": 1.5})])
    among = ["hub_conduction", "caliper_radiation", "backplate_loss"]

    found = name_effect(
        comparison, sensed(comparison, among).whitened(comparison)
    )

    assert found.answer == "unknown"
    assert found.names == ()
    assert "pad_front" in found.unknown_place


@pytest.mark.slow
def test_noise_of_another_form_takes_no_name(
    target: Target, made: Callable[..., Recording]
) -> None:
    """What all effects together explain, and no heat does, is no heat."""
    recordings = [made({"gap_conduction": 0.12}, noise_k=1.0)]
    comparison = compare(target, recordings)
    among = [
        name
        for name in candidates(target.config)
        if effect_class(name).kind == "thermal"
        # which direction the noise has depends on who is asked
        and effect_class(name).number < 40
    ]
    known = sensed(comparison, among).whitened(comparison)
    own = [s.at(1.0) for s in known.signatures if s.name == "gap_conduction"]
    heats = [one.change for one in known.unknown]
    kept = np.linalg.qr(np.column_stack((known.jacobian, *heats, *own)))[0]
    others = np.column_stack([s.at(1.0) for s in known.signatures])
    others /= np.linalg.norm(others, axis=0)
    beside = others - kept @ (kept.T @ others)
    left = np.linalg.svd(beside, full_matrices=False)[0]
    noise = np.sqrt(2.0 * LEFT) * left[:, MANY_TOGETHER]

    for sign in (1.0, -1.0):
        found = name_effect(
            comparison, replace(known, residual=known.residual + sign * noise)
        )

        assert found.explained < 0.6
        assert (found.answer, found.names) == ("name", ("gap_conduction",))


def test_candidates_are_what_the_car_does_not_have_yet(
    config: Config,
) -> None:
    extended = config.model_copy(
        update={
            "thermal": config.thermal.model_copy(
                update={"structure": "extended"}
            )
        }
    )

    assert set(candidates(config)) == set(effect_names())
    assert "gap_conduction" not in candidates(extended)


def test_what_the_tunables_can_do_is_no_evidence() -> None:
    rng = np.random.default_rng(5)
    jacobian = rng.normal(0.0, 10.0, (200, 3))
    direction = jacobian @ np.array([0.2, -0.1, 0.05])
    own = rng.normal(0.0, 1.0, 200)
    project = Projector(jacobian, np.ones(3))

    twin = Signature("twin", direction, 0 * own, direction, either_sign=False)
    other = Signature("other", own, 0 * own, own, either_sign=False)
    on_twin = weigh(project, -direction, twin)
    on_other = weigh(project, -0.7 * own, other)

    assert on_twin.log_evidence < 0.5
    assert on_other.strength == pytest.approx(0.7, abs=0.02)
    assert on_other.log_evidence > 20.0


def test_probabilities_sum_to_one() -> None:
    found = [
        Candidate("a", 1.0, 0.1, 5.0, 4.0, 0.3),
        Candidate("b", 1.0, 0.1, 1.0, -1.0, 0.3),
    ]

    odds = probabilities(found)

    assert sum(odds.values()) == pytest.approx(1.0)
    assert odds["a"] > odds[""] > odds["b"]


@pytest.mark.slow
def test_the_fit_finds_strength_and_the_gap_shrinks(
    target: Target, made: Callable[..., Recording]
) -> None:
    effects = {"gap_conduction": 1.3}
    comparison = compare(target, [made(effects)])

    found = fit(comparison, {"gap_conduction": 0.7})
    shown = show(comparison, found, [made(effects, "held out", seed=3)])

    assert found.strengths["gap_conduction"] == pytest.approx(1.3, rel=0.05)
    assert shown.held_out
    assert shown.shrinks[CONFIGURED].factor > 3.0
    assert shown.shrinks[CONFIGURED].lower > 1.0
    assert shown.bends[EXTENDED] < 0.3 * shown.bends[REFITTED]


ONES: Final = np.ones(2)


class Grid:
    """A layout of 200 points of one drive, white already."""

    prior = ONES
    drive_names = ("made",)

    def slices(self, drive: int) -> list[slice]:
        assert drive == 0
        return [slice(0, 200)]

    def whiten(self, apart_k: Any) -> Any:
        return apart_k


def spike(place: int, height: float = 1.0, width: int = 1) -> Any:
    """Return *height* in *width* points from *place* on, 0 elsewhere."""
    column = np.zeros(200)
    column[place : place + width] = height
    return column


def answer(residual: Any, signatures: dict[str, Any]) -> Naming:
    """Return the answer where *signatures* could explain *residual*."""
    zero = np.zeros(200)
    found = tuple(
        Signature(name, column, zero, column, either_sign=False)
        for name, column in signatures.items()
    )
    linearised = Linearised(residual, np.zeros((200, 2)), found, (), ())
    layout: Any = Grid()
    return name_effect(layout, linearised)


@pytest.mark.parametrize(
    ("z", "others", "strength", "named"),
    [
        # plain, and few candidates that chance could have picked
        (6.0, 1, 1.0, True),
        # below the 4.1 standard deviations, though likely
        (4.0, 1, 1.0, False),
        # above them, but of 30 candidates one far stronger than usual
        (4.2, 29, 4.0, False),
        (6.0, 29, 3.5, True),
    ],
)
def test_the_gate_is_of_deviations_and_of_nothing(
    z: float, others: int, strength: float, *, named: bool
) -> None:
    names = effect_names()[: others + 1]
    columns = {
        name: spike(5 * i, z / strength) for i, name in enumerate(names)
    }
    residual = -strength * columns[names[3 % len(names)]]

    found = answer(residual, columns)

    assert found.gate_z == pytest.approx(z, rel=1e-3)
    assert (0.05 < found.odds[""] < 0.5) is (z == 4.2)
    assert (found.answer == "name") is named
    assert (found.answer == "nothing") is (z == 4.2)
    if named:
        assert found.names == (names[3 % len(names)],)
        assert found.probability == found.odds[found.names[0]] > 0.95


def test_an_effect_as_good_at_other_times_is_not_named() -> None:
    """Twice as much, and for long, where its signature is not."""
    own = spike(0, 1.0, 20)
    residual = -1.5 * own - spike(40, 4.0, 120)

    found = answer(residual, {"hub_conduction": own})

    assert found.gate_z == pytest.approx(1.5 * 20**0.5, rel=1e-3)
    assert found.best_placebo_z == pytest.approx(4.0 * 20**0.5)
    assert (found.answer, found.names) == ("undecided", ("hub_conduction",))
    assert found.reason == (
        "hub_conduction at other times than its own explains as much"
    )
    alone = answer(-1.5 * own, {"hub_conduction": own})
    assert (alone.answer, alone.names) == ("name", ("hub_conduction",))
    assert alone.best_placebo_z < 0.1


@pytest.mark.parametrize(
    ("others", "answered"), [(24, "unknown"), (8, "name"), (0, "name")]
)
def test_a_name_must_explain_most_of_what_all_together_could(
    others: int, answered: str
) -> None:
    """None of the others is plain, and 24 of them explain half of it."""
    first, *rest = effect_names()[: others + 1]
    columns = {first: spike(0, 6.0)}
    columns |= {name: spike(5 * i + 5, 2.2) for i, name in enumerate(rest)}
    residual = -sum(columns.values())

    found = answer(residual, columns)

    # half of the squares, less what chance explains
    gain, left = 0.5 * 36.0, others * (0.5 * 2.2**2 - 0.5)
    assert found.explained == pytest.approx(gain / (gain + left), rel=0.1)
    assert found.answer == answered
    if answered == "unknown":
        assert found.names == ()
        assert found.reason == (
            f"the best, {first}, explains {100 * found.explained:.0f} % of "
            "what all together could"
        )


@pytest.mark.parametrize(("strength", "answered"), [
    (3.5, "name"), (3.7, "unknown"), (4.4, "unknown"),
])  # fmt: skip
def test_what_would_be_stronger_than_any_is_rather_something_similar(
    strength: float, answered: str
) -> None:
    """One that alone explains everything, a tenth beyond 4 at the most."""
    own = spike(3, 2.0)

    found = answer(-strength * own, {"caliper_bypass": own})

    size = found.candidates[0].strength
    assert size == pytest.approx(min(strength, 4.0), abs=0.15)
    assert found.answer == answered
    if answered == "unknown":
        assert found.reason == (
            f"caliper_bypass would be {size:.1f} times its typical size: "
            "rather something similar"
        )
        # and beside a plainer one it is not sure
        beside = spike(90, 12.0)
        both = answer(
            -strength * own - beside,
            {"caliper_bypass": own, "hub_conduction": beside},
        )
        assert (both.answer, both.names) == ("name", ("hub_conduction",))
        assert both.reason == "and another one, perhaps caliper_bypass"


class TwoDrives(Grid):
    """The points of two drives, 100 of each."""

    drive_names = ("first", "second")

    def slices(self, drive: int) -> list[slice]:
        return [slice(100 * drive, 100 * drive + 100)]


@pytest.mark.parametrize(
    ("reading", "named"), [(-1.0, True), (0.0, True), (2.5, False)]
)
def test_a_drive_may_speak_a_little_against_an_effect(
    reading: float, *, named: bool
) -> None:
    """What the others predict there may be wrong by chance, not by far."""
    own = spike(0, 8.0) + spike(100, 2.4)
    residual = -spike(0, 8.0) + reading * spike(100)
    zero = np.zeros(200)
    signature = Signature("hub_conduction", own, zero, own, either_sign=False)
    layout: Any = TwoDrives()

    found = name_effect(
        layout, Linearised(residual, np.zeros((200, 2)), (signature,), (), ())
    )

    # of a density at 2.4 below 0 against one at 0
    against = 0.5 * ((reading + 2.4) ** 2 - reading**2)
    assert found.cross_validated["second"] == pytest.approx(-against, abs=1.2)
    assert (found.answer == "name") is named


@pytest.mark.parametrize(
    ("name", "height", "reading", "sure"),
    [
        ("caliper_bypass", 8.0, -0.5, True),
        ("caliper_bypass", 8.0, 2.5, False),
        # a small error of a sensor is the car's only where no drive lacks it
        ("thermocouple_lag", 80.0, -0.5, False),
        ("thermocouple_lag", 80.0, -2.4, True),
    ],
)
def test_what_a_drive_contradicts_beside_the_first_is_not_sure(
    name: str, height: float, reading: float, *, sure: bool
) -> None:
    """The first is in both drives, the second by *reading* in the other."""
    first = spike(5, 10.0) + spike(105, 10.0)
    second = spike(0, height) + spike(100, 0.3 * height)
    strength = 8.0 / height
    residual = -first - strength * spike(0, height) + reading * spike(100)
    zero = np.zeros(200)
    both = tuple(
        Signature(one, column, zero, column, either_sign=False)
        for one, column in (("hub_conduction", first), (name, second))
    )
    layout: Any = TwoDrives()

    found = name_effect(
        layout, Linearised(residual, np.zeros((200, 2)), both, (), ())
    )

    assert found.answer == "name"
    assert found.names == ("hub_conduction", *([name] if sure else []))
    if not sure:
        assert found.reason == f"and another one, perhaps {name}"


def test_what_is_not_seen_is_like_nothing() -> None:
    project = Projector(np.zeros((200, 2)), ONES)
    zero = np.zeros(200)

    def of(column: Any) -> Signature:
        return Signature("a", column, zero, column, either_sign=False)

    assert cosine(project, of(zero), of(spike(3))) == 0.0
    assert cosine(project, of(spike(3, 2.0)), of(spike(3))) == (
        pytest.approx(1.0)
    )


@pytest.mark.parametrize(
    ("likeness", "kind"), [(0.90, "undecided"), (0.93, "undecided"),
                         (0.96, "class"), (0.99, "class")]
)  # fmt: skip
def test_a_class_is_of_signatures_that_are_alike(
    likeness: float, kind: str
) -> None:
    """No twins by declaration; equal evidence for both."""
    one, other = "hub_conduction", "pad_wear"
    assert other not in effect_class(one).twins
    assert one not in effect_class(other).twins
    apart = np.sqrt(1.0 - likeness**2)
    columns = {
        one: spike(3, 6.0),
        other: 6.0 * (likeness * spike(3) + apart * spike(90)),
    }

    found = answer(-0.5 * (columns[one] + columns[other]), columns)

    assert found.answer == kind
    assert set(found.names) == {one, other}
    assert found.odds[one] == pytest.approx(found.odds[other], rel=0.01)
    assert ("cosine" in found.reason) is (kind == "class")
