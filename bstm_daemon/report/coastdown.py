"""``bstm identify coastdown``: its result in words, as page and as JSON."""

from typing import Any, Final

from bstm_daemon.analysis.identify.coastdown import CoastDown
from bstm_daemon.analysis.identify.coasting import Run
from bstm_daemon.analysis.identify.value import Value
from bstm_daemon.report.json_file import own_fields, picked
from bstm_daemon.report.plots import BLUE, GREY, ORANGE, Plot, curve, plot
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import Columns, number, wrapped
from bstm_daemon.report.timescale import clock

UNITS: Final = {
    "drag_area_m2": "m2",
    "friction_ns_m": "N s/m",
    "rolling_resistance": "-",
}
WORDS: Final = {
    "drag_area_m2": "the drag area is",
    "friction_ns_m": "the friction that grows with speed",
    "rolling_resistance": "the rolling resistance",
}
BALANCE: Final = ("from_ms", "to_ms", "kinetic_j", "climb_j", "drive_j")
_DIRECTIONS: Final = {1: "up", -1: "down", 0: "-"}


VALUES: Final[Columns[tuple[str, Value]]] = Columns(
    ("value", lambda row: row[0]),
    ("found", lambda row: f"{number(row[1].value)} {UNITS[row[0]]}"),
    ("+-", lambda row: number(row[1].standard_error, 2)),
    ("configured", lambda row: number(row[1].configured)),
    ("verdict", lambda row: row[1].caveat or "identified"),
)


def _speeds(run: Run) -> str:
    return f"{3.6 * run.speed_ms[0]:.0f} to {3.6 * run.speed_ms[-1]:.0f}"


RUNS: Final[Columns[Run]] = Columns(
    ("run", None),
    ("from", lambda run: clock(run.stretch.start_s)),
    ("km/h", _speeds),
    ("direction", lambda run: _DIRECTIONS[run.direction]),
    ("grade", lambda run: f"{100 * run.grade:+.2f} %"),
    ("kinetic", lambda run: f"{run.balance.kinetic_j / 1e3:.1f} kJ"),
    ("resistance", lambda run: f"{run.balance.drag_j / 1e3:.1f} kJ"),
    ("climb", lambda run: f"{run.balance.climb_j / 1e3:.1f} kJ"),
    ("left over", lambda run: f"{100 * run.miss:+.2f} %"),
    ("v rms", lambda run: f"{3.6 * run.residual_rms_ms:.2f} km/h"),
)


def coast_down_text(result: CoastDown) -> str:
    """Return the result as text for the screen."""
    lines = [*VALUES.lines(result.values.items()), ""]
    lines += [*RUNS.lines(result.runs), ""]
    lines.append(
        f"{result.windows} windows, residual {result.residual_ms2:.4f} m/s2; "
        f"correlation drag/C_fric {number(result.correlation[0, 1], 2)}, "
        f"drag/f_r {number(result.correlation[0, 2], 2)}, "
        f"C_fric/f_r {number(result.correlation[1, 2], 2)}"
    )
    if result.bias_ms2 is not None:
        lines.append(
            f"accelerometer bias {result.bias_ms2:+.3f} m/s2, if the grades "
            "cancel"
        )
    return "\n".join([*lines, *wrapped(result.remarks)])


def coast_down_json(result: CoastDown) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return own_fields(result, "bias_ms2") | {
        "values": {
            name: picked(
                one,
                *("value", "standard_error", "configured", "identified"),
                why_not="caveat",
            )
            for name, one in result.values.items()
        },
        "accelerometer_bias_ms2": result.bias_ms2,
        "runs": [
            picked(
                run,
                *("direction", "grade"),
                **{key: f"balance.{key}" for key in BALANCE},
                resistance_j="balance.drag_j",
                log="stretch.driving.name",
                start_s="stretch.start_s",
                duration_s="stretch.duration_s",
                energy_left_over="miss",
                speed_rms_ms="residual_rms_ms",
            )
            for run in result.runs
        ],
    }


def coast_down_page(result: CoastDown, subtitle: str) -> Page:
    """Return the page of the coast-down: values, runs, energies."""
    worst = max((abs(run.miss) for run in result.runs), default=0.0)
    found = [
        f"{WORDS[name]} {number(one.value)} {UNITS[name]}".removesuffix(" -")
        for name, one in result.values.items()
        if one.identified
    ]
    lead = (
        f"From {len(result.runs)} runs in neutral: "
        f"{', '.join(found) or 'no resistance is identified'}; in the worst "
        f"run {100 * worst:.2f} % of the energy is left over."
    )
    sections = [
        Section(
            "Speed over time, measured and in theory (thesis figure 4.4)",
            plots=[
                pair
                for i, run in enumerate(result.runs)
                for pair in _run_plots(i, run)
            ],
            note="Theory: Eq 4.2 from the run's first speed on, with the "
            "grade as three numbers a run. Grey: with the configured values.",
        ),
        Section(
            "Resistances (Eq 4.2)",
            Table.of(VALUES, result.values.items()),
            lines=result.remarks,
        ),
        Section(
            "Energy (Eq 4.5 and 4.6)",
            Table.of(RUNS, result.runs),
            note="The lost kinetic energy, 1/2 m v2 + 1/2 J w2, is the work "
            "of the resistances and of the climb minus that of the drive "
            "line; left over is the remainder as a share of the kinetic "
            "energy.",
            folded=True,
        ),
    ]
    tiles = [
        (number(one.value), f"{name} +- {number(one.standard_error, 2)}")
        for name, one in result.values.items()
    ]
    tiles.append((f"{100 * worst:.2f} %", "energy left over, worst run"))
    return Page("Coast-down", sections, tiles, lead, subtitle=subtitle)


def _run_plots(i: int, run: Run) -> list[tuple[str, Plot]]:
    measured = 3.6 * run.speed_ms
    theory, before = 3.6 * run.theory_ms, 3.6 * run.configured_ms
    x, dash = run.time_s, "5px,3px"
    speeds = [
        curve(x, before, "configured", GREY, dash=dash),
        curve(x, measured, "measured", BLUE, width=3.2),
        curve(x, theory, "theory", ORANGE, width=1.4),
    ]
    residuals = [
        curve(x, before - measured, "configured", GREY, dash=dash),
        curve(x, theory - measured, "theory", ORANGE),
    ]
    return [
        (
            f"run {i + 1}, grade {100 * run.grade:+.2f} %",
            plot(speeds, "time [s]", "speed [km/h]"),
        ),
        (
            f"run {i + 1}: theory minus measurement",
            plot(residuals, "time [s]", "residual [km/h]"),
        ),
    ]
