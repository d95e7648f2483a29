"""The joint refinement on drives whose right values are known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.matching import refine as refine_module
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.identifiability import ratios, verdicts
from bstm_daemon.analysis.matching.matcher import NO_FLUID, match_drives
from bstm_daemon.analysis.matching.problem import (
    FIRST,
    Problem,
    whole_drives,
)
from bstm_daemon.analysis.matching.refine import (
    Refinement,
    errors_of,
    fitted,
    folds_of,
    learned,
    peaks_of,
    refine,
    rms_of,
)
from bstm_daemon.analysis.matching.tunables import (
    FAST,
    MASS,
    MIDDLE,
    REFINED,
    SIDES,
    SLOW,
    TUNABLES,
)
from bstm_daemon.analysis.statistics.levenberg_marquardt import Solution
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.report.match import match_page

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target

TIME_S = np.arange(0.0, 2000.0, 10.0)
RIGHT = {
    "thermal.disc_mass_correction_factor": 1.0,
    "thermal.heat_partition_correction_factor": 1.1,
    "thermal.pad_backplate_thermal_resistance_m2k_w": 4.0e-3,
    "thermal.fluid_static_convection_w_k": 1.2,
    "thermal.fluid_caliper_thermal_capacity_j_k": 2100.0,
    "cooling.s_per_s at 36 km/h": 1.15,
}


@pytest.mark.slow
def test_right_values_are_found(
    target: Target, made: Callable[..., Drive]
) -> None:
    drives = [made(RIGHT, noise_k=0.5)]

    fit = refine(target, drives, REFINED)

    for key, right in RIGHT.items():
        assert fit.values[key] == pytest.approx(right, rel=0.03), key
        # not overconfident: most errors are below two deviations
        assert abs(fit.values[key] - right) < 4.0 * (
            fit.standard_deviation(key) + 0.002 * right
        )
    assert not fit.at_bound
    assert fit.rms_k.keys() == {"disc", "pad_front", "pad_back", "fluid"}
    assert max(fit.rms_k.values()) < 2.0


@pytest.mark.slow
def test_alike_discs_have_values_of_their_own(
    target: Target, made: Callable[..., Drive]
) -> None:
    """The right brake takes a tenth less of the heat and gets less air."""
    both = replace(target, corners=("FL", "FR"))
    sides = {
        corner: made(
            {MASS: mass, **dict.fromkeys((SLOW, MIDDLE, FAST), air)},
            nodes=("disc",),
            noise_k=0.5,
        )
        for corner, mass, air in (("FL", 1.0, 1.0), ("FR", 1.1, 0.9))
    }
    left = sides["FL"]
    drive = replace(
        left,
        corners=("FL", "FR"),
        inputs=np.repeat(left.inputs, 2, axis=1),
        measured={corner: one.measured["FL"] for corner, one in sides.items()},
    )

    matches = match_drives(both.config, [Reading(None, [drive])])

    page = match_page(matches, "")
    worst = max(matches, key=lambda match: match.joint.rms_k["disc"])
    assert page.tiles == [
        (
            f"{worst.joint.rms_k['disc']:.1f} K",
            f"RMS disc in the fit, {worst.corners[0]}",
        )
    ]
    assert str(page.lead).count("(a disc of one node: ") == 2
    assert all(NO_FLUID in match.remarks for match in matches)
    left, right = (match.joint for match in matches)
    assert [match.corners for match in matches] == [("FL",), ("FR",)]
    for fit in (left, right):
        assert fit.keys == tuple(fit.values)
        assert not SIDES.keys() & fit.values.keys()
        assert fit.rms_k["disc"] < 1.0
    assert right.values[MASS] / left.values[MASS] == pytest.approx(
        1.1, abs=0.02
    )
    assert right.values[FAST] / left.values[FAST] == pytest.approx(
        0.9, abs=0.03
    )


@pytest.mark.slow
def test_a_wrong_form_ends_at_a_bound_and_says_so(
    target: Target, made: Callable[..., Drive]
) -> None:
    """Half the heat is missing: the disc would have to be too light."""
    drives = [made(RIGHT, scale=1.0)]
    starved = [drives[0].with_power_times(0.5)]

    fit = refine(target, starved, ("thermal.disc_mass_correction_factor",))

    assert fit.at_bound == ("thermal.disc_mass_correction_factor",)
    assert "physical bound 0.7" in verdicts(fit)[0].reason
    # what the drives say nothing of may lie there by chance
    unknown = replace(fit, covariance=np.diag(fit.prior**2))
    assert "bound" not in verdicts(unknown)[0].reason
    assert fit.values[fit.keys[0]] == pytest.approx(0.7)


def test_without_temperatures_of_a_part_its_values_are_the_priors(
    target: Target, made: Callable[..., Drive]
) -> None:
    """From the disc alone the fluid's values can not be known."""
    drives = [made(RIGHT, nodes=("disc",))]
    keys = (
        "thermal.disc_mass_correction_factor",
        "thermal.fluid_caliper_thermal_capacity_j_k",
    )

    fit = refine(target, drives, keys)
    of_disc, of_fluid = verdicts(fit)

    assert of_disc.settled
    assert not of_fluid.settled
    assert "prior" in of_fluid.reason
    assert fit.values[keys[1]] == pytest.approx(
        target.value(TUNABLES[keys[1]]), rel=0.02
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ratio_that_is_known_better_than_its_parts_is_named(
    sign: float,
) -> None:
    """Gauge freedom: a conductance over a capacity, neither by itself."""
    keys = (
        "thermal.fluid_static_convection_w_k",
        "thermal.fluid_caliper_thermal_capacity_j_k",
    )
    covariance = 0.01 * np.array([[1.0, 0.98 * sign], [0.98 * sign, 1.0]])
    prior = np.array([0.3, 0.15])
    fit = Refinement(
        keys, {}, dict.fromkeys(keys, 1.0), prior, covariance,
        np.linalg.inv(covariance), (), {}, {}, 100, 10,
    )  # fmt: skip

    (found,) = ratios(fit)

    assert found.sign == ("x" if sign < 0.0 else "/")
    assert found.deviation == pytest.approx(0.1 * np.sqrt(2.0 * 0.02))
    assert "only together with" in verdicts(fit)[1].reason


@pytest.mark.parametrize(
    ("information", "decides"), [(1.0, True), (1.7, False)]
)
def test_what_the_drives_say_less_of_than_the_prior_is_the_priors(
    information: float,
    decides: bool,  # noqa: FBT001
) -> None:
    """Alone they would know it to 1 or 0.77 of a deviation of 0.4."""
    values = {MASS: 1.0}
    fit = Refinement(
        (MASS,), values, values, np.array([0.4]), np.array([[0.15]]),
        np.array([[information]]), (), {}, {}, 100, 10,
    )  # fmt: skip

    (found,) = verdicts(fit)

    assert found.share == pytest.approx(0.15**0.5 / 0.4)
    assert found.reason.endswith("the prior decides") == decides
    assert not found.settled


def test_a_side_is_as_uncertain_as_both_and_their_ratio() -> None:
    """Logarithms add up: that of the right is the left's and the factor's."""
    keys = (MASS, FAST, *SIDES)
    covariance = np.diag([0.01, 0.04, 0.02, 0.03])
    covariance[0, 2] = covariance[2, 0] = -0.004
    prior = np.array([1.0, 0.3, 0.1, 0.1])
    values = dict(zip(keys, (0.5, 2.0, 1.1, 0.9), strict=True))
    fit = Refinement(
        keys, values, values, prior, covariance,
        np.linalg.inv(covariance), keys[2:], {}, {}, 100, 10,
    )  # fmt: skip

    left, right = (fit.of_side(one, {"disc": 3.0}) for one in ("FL", "FR"))

    assert left.values == {MASS: 0.5, FAST: 2.0}
    assert right.values == pytest.approx({MASS: 0.55, FAST: 1.8})
    assert np.diag(left.covariance) == pytest.approx([0.01, 0.04])
    assert np.diag(right.covariance) == pytest.approx([0.022, 0.07])
    assert right.prior == pytest.approx([1.01**0.5, 0.1**0.5])
    assert right.at_bound == ()
    assert right.rms_k == {"disc": 3.0}


@pytest.mark.slow
def test_what_was_left_out_shows_what_a_fit_does_not(
    target: Target, made: Callable[..., Drive]
) -> None:
    """Two drives that contradict each other fit together half-way."""
    discs = {"nodes": ("disc",)}
    drives = [
        made(RIGHT, "one", noise_k=0.3, **discs),
        made({**RIGHT, MASS: 1.2}, "two", **discs),
    ]

    (match,) = match_drives(target.config, [Reading(None, drives)])

    accuracy = match.accuracy
    assert accuracy.drives == 2
    assert accuracy.left_out == "one and two"
    assert accuracy.rms_k["disc"] > 1.3 * match.joint.rms_k["disc"]


@pytest.mark.slow
def test_the_other_form_of_cooling_is_named_where_it_fits(
    target: Target, made: Callable[..., Drive]
) -> None:
    """The car cools at a constant conductance, the configuration says rate."""
    right = target.with_cooling_form("conductance")
    drive = made(target=right)

    wrong, of_right = (
        match_drives(one.config, [Reading(None, [drive])], beside=False)[
            0
        ].remarks
        for one in (target, right)
    )

    assert any('form = "conductance" would leave' in one for one in wrong)
    assert not any("would leave" in one for one in of_right)


def test_of_a_single_drive_the_last_third_is_left_out(
    target: Target, made: Callable[..., Drive]
) -> None:
    drive = made(RIGHT)
    steps = len(drive)

    (((fitted_on,), left),) = folds_of([drive])

    assert fitted_on == (0, slice(0, round(steps * 2 / 3)))
    assert left == (0, slice(round(steps * 2 / 3), steps))
    assert not folds_of([drive.part(0, 300)])


def test_each_of_several_drives_is_left_out_once(
    made: Callable[..., Drive],
) -> None:
    drives = [made(profile=((10.0, 0.0, 60.0),)) for _ in range(3)]
    whole = slice(None)

    found = folds_of(drives)

    assert found == [
        ([(1, whole), (2, whole)], (0, whole)),
        ([(0, whole), (2, whole)], (1, whole)),
        ([(0, whole), (1, whole)], (2, whole)),
    ]


def test_the_largest_error_is_that_of_all_drives() -> None:
    parts = [
        (np.array(error), np.zeros(2)) for error in ([1.0, -4.0], [3.0, 2.0])
    ]

    assert peaks_of({"disc": parts, "fluid": parts[1:]}) == {
        "disc": 4.0,
        "fluid": 3.0,
    }


def test_noise_is_of_its_own_node_with_what_is_known_of_its_lag(
    target: Target, made: Callable[..., Drive]
) -> None:
    """White noise that is told apart by node, as the drive has it."""
    drive = made(RIGHT, nodes=("disc", "fluid"))
    rng = np.random.default_rng(2)
    noisy = {}
    for node, white_k in (("disc", 4.0), ("fluid", 0.5)):
        one = drive.measured["FL"][node]
        off_k = rng.normal(0.0, white_k, len(one.time_s))
        noisy[node] = replace(one, temperature_k=one.temperature_k + off_k)
    first = {node: replace(FIRST[node], lag_s=0.5) for node in noisy}

    fit = refine(
        *(target, [replace(drive, measured={"FL": noisy})], (MASS,)),
        start=RIGHT,
        noise=first,
        rounds=2,
    )

    assert fit.noise["disc"].white_k == pytest.approx(4.0, rel=0.2)
    assert fit.noise["fluid"].white_k == pytest.approx(0.5, rel=0.3)
    assert {one.lag_s for one in fit.noise.values()} == {0.5}
    assert all(one.share == 0.0 for one in FIRST.values())


def test_the_right_values_leave_nothing_of_a_part(
    target: Target, made: Callable[..., Drive]
) -> None:
    """It begins at what is measured there; other nodes settle beside that."""
    drive = made(RIGHT)
    part = drive.part(len(drive) // 2, len(drive))

    left_k = rms_of(errors_of(target.changed(RIGHT), part))

    assert left_k.keys() == {"disc", "pad_front", "pad_back", "fluid"}
    assert max(left_k.values()) < 0.5


def test_floor_and_share_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    rise = rng.uniform(0.0, 500.0, 40_000)
    error = rng.normal(0.0, np.hypot(2.0, 0.03 * rise))

    found = fitted([(error, rise, 0.0)])

    assert found.floor_k == pytest.approx(2.0, rel=0.35)
    assert found.share == pytest.approx(0.03, rel=0.05)
    assert found.deviation_k(np.array([100.0])) == pytest.approx(
        np.hypot(found.floor_k, 3.0), rel=0.1
    )


def test_white_noise_and_drift_are_learned_apart() -> None:
    """Residuals of the covariance that the noise claims."""
    noise = SensorNoise(1.0, 2.0, 0.0, 0.01, quick_s=0.0)
    still = np.zeros(len(TIME_S))
    lower = np.linalg.cholesky(noise.covariance(TIME_S, still))
    rng = np.random.default_rng(1)
    drawn = [lower @ rng.standard_normal(len(TIME_S)) for _ in range(12)]

    found = learned(FIRST["fluid"], [(one, TIME_S) for one in drawn])

    assert found.white_k == pytest.approx(1.0, rel=0.25)
    assert found.drift_k == pytest.approx(2.0, rel=0.25)


def test_a_node_that_the_model_misses_is_still_believed() -> None:
    """Else it would be missed the more from round to round."""
    wrong = [np.full(len(TIME_S), 80.0)]

    found = learned(FIRST["disc"], [(one, TIME_S) for one in wrong])

    assert found.drift_k <= 1.5 * FIRST["disc"].drift_k


class Minimiser:
    """Gives back each start, moved by *shift*, and remembers it."""

    def __init__(self, data: Any, shift: float = 0.0) -> None:
        self.data = np.asarray(data)
        self.shift = shift
        self.starts: list[Any] = []
        self.noises: list[Any] = []
        self.judged_by: Any = None

    def __call__(
        self, problem: Any, x: Any, lower: Any, upper: Any, show: Any
    ) -> Solution:
        self.starts.append(x.copy())
        self.noises.append(problem.noise)
        jacobian = np.vstack((self.data, np.diag(1.0 / problem.prior)))
        found = x + self.shift
        nothing = np.zeros(len(jacobian))
        return Solution(found, nothing, jacobian, found > 9e9, 0.0, 7)

    def rewhitened(self, white: Any, noise: Any) -> Any:
        """Stand in for the problem's: its data is of no problem."""
        self.judged_by = noise
        return white


KEYS = (
    "thermal.disc_mass_correction_factor",
    "thermal.fluid_caliper_thermal_capacity_j_k",
)


@pytest.fixture
def fitted_by(
    target: Target,
    made: Callable[..., Drive],
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., Refinement]:
    """Return what refines by a minimiser of the test's own."""
    drives = [made(RIGHT, noise_k=3.0)]

    def refined(minimiser: Minimiser, **given: Any) -> Refinement:
        monkeypatch.setattr(refine_module, "minimise", minimiser)
        monkeypatch.setattr(Problem, "rewhitened", minimiser.rewhitened)
        return refine(target, drives, KEYS, **given)

    return refined


def test_a_fit_begins_where_it_is_told(
    target: Target, fitted_by: Callable[..., Refinement]
) -> None:
    """Else at the target's values, which stay what is reported."""
    own = [target.value(TUNABLES[key]) for key in KEYS]
    minimiser = Minimiser(np.eye(2), 0.01)

    fit = fitted_by(minimiser, start={KEYS[1]: 1500.0}, rounds=1)

    assert np.exp(minimiser.starts) == pytest.approx(
        np.array([[own[0], 1500.0]])
    )
    assert fit.start == pytest.approx(dict(zip(KEYS, own, strict=True)))
    assert fit.values == pytest.approx(
        {KEYS[0]: own[0] * np.exp(0.01), KEYS[1]: 1500.0 * np.exp(0.01)}
    )
    plain = Minimiser(np.eye(2))
    fitted_by(plain, rounds=1)
    assert np.exp(plain.starts) == pytest.approx(np.array([own]))


def test_three_fits_each_from_the_one_before_with_the_noise_it_shows(
    fitted_by: Callable[..., Refinement],
) -> None:
    minimiser = Minimiser(np.eye(2), 0.01)
    shares: list[float] = []

    fit = fitted_by(minimiser, progress=shares.append)

    assert len(minimiser.starts) == 3
    assert fit.evaluations == 21
    steps = np.diff(minimiser.starts, axis=0)
    assert steps == pytest.approx(np.full((2, 2), 0.01))
    first, second, third = minimiser.noises
    assert first["disc"] == FIRST["disc"]
    assert second["disc"].white_k == pytest.approx(3.0, rel=0.15)
    assert second["disc"] != third["disc"]
    assert {
        node: one.scaled(0.5, 1.0) for node, one in fit.noise.items()
    } == third
    # values are known by the whole noise
    assert minimiser.judged_by == fit.noise
    again = Minimiser(np.eye(2))
    fitted_by(again, rounds=1, noise=fit.noise)
    assert again.noises == [third]
    assert again.judged_by == fit.noise


def test_derivatives_are_whitened_anew(
    target: Target, made: Callable[..., Drive]
) -> None:
    """As if the other noise had been there from the start."""
    drives = [made(RIGHT, noise_k=3.0)]
    runs, terms = whole_drives(target, drives, point_s=20.0, most_points=90)
    problem = Problem(target, drives, KEYS, runs, terms, {})
    other = {node: SensorNoise(0.7, 4.0, 0.0, 1.0) for node in FIRST}
    x = problem.start[None] + 0.1

    found = problem.rewhitened(problem(x).T[: -len(KEYS)], other)

    assert found == pytest.approx(problem(x).T[: -len(KEYS)], rel=1e-9)
    assert problem.noise == other


def test_covariance_has_the_priors_and_information_has_not(
    target: Target, fitted_by: Callable[..., Refinement]
) -> None:
    """The inverse of J'J and of the priors' precision together."""
    data = np.array([[3.0, 0.0], [4.0, 2.0], [0.0, 0.0]])
    prior = [TUNABLES[key].prior for key in KEYS]

    fit = fitted_by(Minimiser(data), rounds=1)

    information = np.array([[25.0, 8.0], [8.0, 4.0]])
    assert fit.information == pytest.approx(information)
    assert fit.prior == pytest.approx(np.array(prior))
    assert fit.covariance @ (
        information + np.diag(np.array(prior) ** -2.0)
    ) == (pytest.approx(np.eye(2), abs=1e-12))
    for i, key in enumerate(KEYS):
        assert fit.standard_deviation(key) == pytest.approx(
            target.value(TUNABLES[key]) * fit.covariance[i, i] ** 0.5
        )
    # without data a deviation is the prior's
    blind = fitted_by(Minimiser(np.zeros((3, 2))), rounds=1)
    assert blind.standard_deviation(KEYS[1]) == pytest.approx(
        prior[1] * target.value(TUNABLES[KEYS[1]])
    )


RISE_K = np.linspace(0.0, 500.0, 101)


@pytest.mark.parametrize(
    ("rise_k", "floor_k", "share", "white_k"),
    [
        (RISE_K, 2.0, 0.03, 0.0),
        # white noise of the thermocouple is not the estimate's
        (RISE_K, 2.0, 0.03, 3.0),
        (np.linspace(0.0, 1.0, 11), 2.0, 1.0, 0.0),
        # a rise that is always the same shows no share
        (np.full(10, 300.0), 5.0, 0.0, 0.0),
    ],
)
def test_errors_on_a_line_are_fitted_exactly(
    rise_k: np.ndarray, floor_k: float, share: float, white_k: float
) -> None:
    """Of two thermocouples together."""
    error_k = np.sqrt(floor_k**2 + (share * rise_k) ** 2 + white_k**2)
    half = len(rise_k) // 2
    parts = [
        (error_k[:half], rise_k[:half], white_k),
        (-error_k[half:], rise_k[half:], white_k),
    ]

    found = fitted(parts)

    assert found.floor_k == pytest.approx(floor_k)
    assert found.share == pytest.approx(share, abs=1e-6)


def test_an_error_that_falls_with_the_rise_has_no_share() -> None:
    error_k = np.sqrt(100.0 - 1e-4 * RISE_K**2)

    found = fitted([(error_k, RISE_K, 0.0)])

    assert found.share == 0.0
    assert found.floor_k == pytest.approx(np.mean(error_k**2) ** 0.5)


@pytest.mark.parametrize("rise_k", [RISE_K, np.linspace(0.0, 1.5, 11)])
def test_a_floor_below_half_a_kelvin_is_half_a_kelvin(
    rise_k: np.ndarray,
) -> None:
    """The share then takes the rest, of a rise of a kelvin at least."""
    error_k = 1.2 * rise_k

    found = fitted([(error_k, rise_k, 0.0)])

    mean_2 = float(np.mean(rise_k**2))
    rest = 1.2**2 * mean_2 - 0.25
    assert found.floor_k == 0.5
    assert found.share == pytest.approx((rest / max(mean_2, 1.0)) ** 0.5)
