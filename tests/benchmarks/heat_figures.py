"""Tables and goals of the population: medians, 95th percentiles, coverage."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from heat_roads import TESTS
from side_by_side import Table

from bstm_daemon.channels import FLAGS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bstm_daemon.simulation.materials import Array

    Found = dict[str, Any]

COVERED: Final = 1.645
"""Standard deviations to each side of a 90 % interval."""

LEARNING: Final = tuple(f"learning {number + 1}" for number in range(3))
FIRST: Final = "first descent"


def of(found: Iterable[Found], kind: str, name: str) -> Array:
    """Return one figure of one kind of drive, for all cases."""
    return np.array([one["heat"][kind][name] for one in found])


def taught(found: Iterable[Found], drive: int, name: str) -> Array:
    """Return one figure of what was learned after *drive*, for all cases."""
    return np.array([one["learned"][drive][name] for one in found])


def middle(errors: Array) -> float:
    """Return the median of the sizes."""
    return float(np.nanmedian(np.abs(errors)))


def tail(errors: Array) -> float:
    """Return the 95th percentile of the sizes."""
    return float(np.nanpercentile(np.abs(errors), 95))


def both(errors: Array, factor: float = 100.0, digits: int = 1) -> str:
    """Return median / 95th percentile of the sizes as text."""
    return (
        f"{factor * middle(errors):.{digits}f} / "
        f"{factor * tail(errors):.{digits}f}"
    )


def share_within(errors: Array, spread: Array) -> float:
    """Return the share of errors within their 90 % interval."""
    return float(np.mean(np.abs(errors) < COVERED * spread))


def heat(found: list[Found]) -> Table:
    """Fused, Feed-Forward alone and Feed-Back alone on the same drives."""
    rows = []
    for kind in (*LEARNING, *TESTS, FIRST):
        alone = ["-", "-"]
        if "ff" in found[0]["heat"][kind]:
            alone = [both(of(found, kind, name)) for name in ("ff", "fb")]
        fused, spread = of(found, kind, "fused"), of(found, kind, "sd")
        rows.append(
            (
                kind,
                *(both(fused), both(of(found, kind, "relative"))),
                both(of(found, kind, "front")),
                *alone,
                f"{100 * COVERED * float(np.median(spread)):.1f}",
                f"{100 * share_within(fused, spread):.0f}",
            )
        )
    return Table(
        "Error of a drive's brake heat, %, median / 95th percentile; without "
        "the torque signal's own error; front axle; FF and FB alone as in the "
        "thesis; half of the median 90 % interval; share of errors within it",
        (
            *("drive", "fused", "less torque's", "front", "FF", "FB"),
            *("interval +-", "within"),
        ),
        tuple(rows),
    )


def between(found: Iterable[Found], pair: tuple[str, str], way: str) -> Array:
    """Return what is left between two kinds of drive by one right factor."""
    one, other = (1.0 + of(found, kind, way) for kind in pair)
    return one / other - 1.0


def kinds(found: list[Found]) -> Table:
    """How alike the errors of different drives of a car are."""
    road = [one for one in found if one["case"]["preset"] == "road"]
    rows = [
        (
            " to ".join(pair),
            both(between(found, pair, "fused")),
            *(both(between(road, pair, way)) for way in ("fused", "ff", "fb")),
        )
        for pair in combinations(TESTS, 2)
    ]
    return Table(
        "Between two drives of a car, %, median / 95th percentile: what one "
        "factor, right for the other drive, would leave",
        ("drives", "fused", "fused, road", "FF, road", "FB, road"),
        tuple(rows),
    )


def by_preset(found: list[Found]) -> Table:
    """The same for parts of the population."""
    rows = []
    for name in ("plain", "road", "n1", "n2", "n3"):
        own = [
            one
            for one in found
            if name in {one["case"]["preset"], one["case"]["sensors"]}
        ]
        rows.append(
            (
                name,
                str(len(own)),
                *(both(of(own, kind, "fused")) for kind in TESTS),
            )
        )
    return Table(
        "Error of fused heat by preset and sensors, %, "
        "median / 95th percentile",
        ("part", "cars", *TESTS),
        tuple(rows),
    )


def learned(found: list[Found]) -> Table:
    """What is learned after each of the three ordinary drives."""
    rows = []
    for name, words, factor, digits in (
        ("bias", "b - g f_r, m/s2", 1.0, 3),
        ("mass", "mass over torque scale, %", 100.0, 1),
        ("mass_true", "mass, %", 100.0, 1),
        ("friction", "friction over mass, %", 100.0, 1),
        ("friction_true", "friction, %", 100.0, 1),
        ("drag", "drag, %", 100.0, 0),
    ):
        rows.append(
            (
                words,
                *(
                    both(taught(found, drive, name), factor, digits)
                    for drive in range(len(LEARNING))
                ),
            )
        )
    return Table(
        "Error of what is learned, median / 95th percentile, after",
        ("", "15 min", "27 min", "39 min"),
        tuple(rows),
    )


def grades(found: list[Found]) -> Table:
    """The grade's error while the car moves."""
    rows = []
    for words, given in (("satellite height", True), ("without", False)):
        own = [one for one in found if one["case"]["satellites"] is given]
        rows += [
            (
                f"{kind}, {words}",
                both(of(own, kind, "grade_rms"), digits=2),
                both(of(own, kind, "grade_mean"), digits=2),
            )
            for kind in (LEARNING[-1], *TESTS)
        ]
    return Table(
        "Error of the road's grade, % of grade, median / 95th percentile",
        ("drive", "rms", "mean"),
        tuple(rows),
    )


def pooled(found: list[Found]) -> tuple[Array, Array]:
    """Return errors of the heat of all drives and their deviations."""
    kinds = (*LEARNING, *TESTS, FIRST)
    return (
        np.concatenate([of(found, kind, "fused") for kind in kinds]),
        np.concatenate([of(found, kind, "sd") for kind in kinds]),
    )


def coverage(found: list[Found]) -> Table:
    """How many errors are within their 90 % intervals."""
    rows = [("heat, all drives", f"{100 * share_within(*pooled(found)):.0f}")]
    for name, words in (
        ("bias", "b - g f_r"),
        ("mass", "mass over torque scale"),
        ("friction_alone", "friction over torque scale"),
    ):
        spread = name.removesuffix("_alone") + "_sd"
        each = [
            share_within(
                taught(found, drive, name), taught(found, drive, spread)
            )
            for drive in range(len(LEARNING))
        ]
        rows.append((words, " / ".join(f"{100 * one:.0f}" for one in each)))
    for kind in TESTS:
        mean, spread = (
            of(found, kind, name) for name in ("grade_mean", "grade_sd")
        )
        inside = f"{100 * share_within(mean, spread):.0f}"
        rows.append((f"mean grade, {kind}", inside))
    return Table(
        "Errors within their 90 % interval, %; what is learned: after each of "
        "the learning drives",
        ("", "within"),
        tuple(rows),
    )


def flags(found: list[Found]) -> Table:
    """What was said of these cars, of which all inputs are sound."""
    rows = []
    for name, bit in FLAGS.items():
        told = sum(
            bool(one["heat"][kind]["flags"] & bit)
            for one in found
            for kind in (*LEARNING, *TESTS, FIRST)
        )
        if told:
            rows.append((name, str(told)))
    drives = len(found) * len((*LEARNING, *TESTS, FIRST))
    return Table(
        f"False alarms: runs with a flag, of {drives}",
        ("flag", "runs"),
        tuple(rows) or (("none", "0"),),
    )


def goals(
    found: list[Found], *, full: bool
) -> Iterable[tuple[str, str, str, float]]:
    """Yield name, what was found, what should be, and how well it fits.

    A fit of 1 and more reaches the goal. Few cars have no 95th percentile.
    """

    def limits(
        name: str, errors: Array, median: float, most: float | None, unit: str
    ) -> Iterable[tuple[str, str, str, float]]:
        factor, digits = (100.0, 1) if unit == "%" else (1.0, 3)
        for words, value, limit in (
            ("median", middle(errors), median),
            ("95th percentile", tail(errors), most),
        ):
            if limit is None or (words != "median" and not full):
                continue
            yield (
                f"{name}, {words}",
                f"{factor * value:.{digits}f} {unit}",
                f"{factor * limit:g} {unit}",
                limit / max(value, 1e-9),
            )

    for kind in TESTS:
        errors = of(found, kind, "fused")
        yield from limits(f"heat of {kind}", errors, 0.04, 0.08, "%")
    for pair in combinations(TESTS, 2):
        errors = between(found, pair, "fused")
        yield from limits(f"{' to '.join(pair)}", errors, 0.04, 0.08, "%")
    last = len(LEARNING) - 1
    bias = taught(found, last, "bias")
    yield from limits("b - g f_r after three drives", bias, 0.03, 0.03, "m/s2")
    mass = taught(found, 0, "mass")
    yield from limits(
        "mass over torque scale after 15 min", mass, 0.03, 0.06, "%"
    )
    friction = taught(found, last, "friction")
    yield from limits("friction over mass", friction, 0.04, None, "%")
    given = [one for one in found if one["case"]["satellites"]]
    for kind in (LEARNING[-1], *TESTS):
        grade = of(given, kind, "grade_rms")
        yield from limits(f"grade rms, {kind}", grade, 0.003, None, "%")
    if full:
        inside = share_within(*pooled(found))
        yield (
            "heat within 90 % intervals",
            f"{100 * inside:.0f} %",
            "85 to 95 %",
            min(inside / 0.85, (1.0 - inside) / 0.05),
        )


def verdicts(reached: list[tuple[str, str, str, float]]) -> Table:
    """The goals as a table."""
    return Table(
        "Goals",
        ("figure", "found", "goal", "reached"),
        tuple(
            (name, value, limit, "yes" if fit >= 1.0 else "no")
            for name, value, limit, fit in reached
        ),
    )
