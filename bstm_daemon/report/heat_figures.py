"""The figures of ``bstm heat``, one function a figure of the thesis."""

from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.identify.heat_comparison import (
    SOURCES,
    HeatComparison,
    HeatStop,
    StopFriction,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.report.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILION,
    Plot,
    cloud,
    curve,
    plot,
    right_axis,
    time_plot,
    wide_range,
)
from bstm_daemon.report.timescale import clock

SOURCE_COLOURS: Final = {
    "ff": BLUE,
    "fb": VERMILION,
    "fused": GREEN,
    "can": PURPLE,
}

SHORT: Final = {"ff": "FF", "fb": "FB", "fused": "fused", "can": "bus"}
"""Names in the small figures of the stops."""

RATIO_TOP: Final = 3.0
MEDIAN_ROWS: Final = 11

STOPS_NAMED: Final = 14
"""More stops than these have no legend."""

_COLD: Final = (0, 114, 178)
_HOT: Final = (213, 94, 0)

LEAST_SPAN: Final = 0.15
"""Least half width of a friction axis, as a share of the median."""


def _by_source(
    x: Column,
    values: dict[str, Column],
    names: dict[str, str],
    width: float = 1.6,
) -> list[dict[str, Any]]:
    return [
        curve(x, values[key], name, SOURCE_COLOURS[key], width=width)
        for key, name in names.items()
        if key in values
    ]


def energy_plot(heat: HeatComparison, span: tuple[float, float]) -> Plot:
    """Return the running energies of all sources (Fig 6.1)."""
    energy_mj = {key: one / 1e6 for key, one in heat.energy_j.items()}
    curves = _by_source(heat.time_s, energy_mj, SOURCES, 2)
    return time_plot(curves, "brake energy [MJ]", span)


def power_plot(heat: HeatComparison, span: tuple[float, float]) -> Plot:
    """Return the powers of all sources, with the speed."""
    x, speed_kmh = heat.time_s, 3.6 * heat.speed_ms
    power_kw = {key: one / 1e3 for key, one in heat.power_w.items()}
    curves = _by_source(x, power_kw, SOURCES)
    curves.append(curve(x, speed_kmh, "speed", GREY, width=1, second=True))
    return time_plot(
        curves, "brake power [kW]", span, yaxis2=right_axis("speed [km/h]")
    )


def momentary_plot(heat: HeatComparison, span: tuple[float, float]) -> Plot:
    """Return Feed-Forward over Feed-Back while braking (Fig 6.2)."""
    ratio = heat.momentary_ratio()
    top = min(float(np.nanpercentile(ratio, 99)) * 1.2, RATIO_TOP)
    data = [cloud(heat.time_s, ratio, "", BLUE, size=3)]
    return time_plot(data, "FF / FB", span, yaxis={"range": [0.0, top]})


def integrated_plot(heat: HeatComparison, span: tuple[float, float]) -> Plot:
    """Return the ratio of the energies so far (Fig 6.3)."""
    ratio = heat.integrated_ratio()
    known = ratio[np.isfinite(ratio)]
    top = min(float(known.max(initial=1.0)) * 1.2, RATIO_TOP)
    data = [curve(heat.time_s, ratio, "", BLUE, width=2, legend=False)]
    return time_plot(data, "FF / FB", span, yaxis={"range": [0.0, top]})


def smooth(values: Any) -> Any:
    """Return the running median of *values* over a second, NaN kept."""
    result = np.full(len(values), np.nan)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < MEDIAN_ROWS:
        return result
    windows = np.lib.stride_tricks.sliding_window_view(
        values[known], MEDIAN_ROWS
    )
    half = MEDIAN_ROWS // 2
    result[known[half:-half]] = np.median(windows, axis=1)
    return result


def per_force_plot(heat: HeatComparison, span: tuple[float, float]) -> Plot:
    """Return pressure over brake force (Fig 4.9, 4.10)."""
    ratio = heat.pressure_per_force()
    top = 1.3 * float(np.nanpercentile(ratio, 97))
    data = [
        cloud(heat.time_s, ratio, "", GREY, size=3),
        curve(heat.time_s, smooth(ratio), "", BLUE, width=2, legend=False),
    ]
    return time_plot(
        data, "pressure / force [Pa/N]", span, yaxis={"range": [0.0, top]}
    )


def stop_plots(
    heat: HeatComparison, stop: HeatStop, number: int
) -> list[tuple[str, Plot]]:
    """Return power, energy and force of *stop* (Fig 4.5, 4.6, 4.8)."""
    rows = np.flatnonzero(
        (heat.time_s >= stop.begin_s - 1.0) & (heat.time_s <= stop.end_s + 0.5)
    )
    since = heat.time_s[rows] - heat.time_s[stop.first]
    begin = int(np.searchsorted(heat.time_s, stop.begin_s))
    speed_ms = np.maximum(heat.speed_ms[rows], 1.0)
    moving = heat.speed_ms[rows] > 1.0
    power_kw = {k: one[rows] / 1e3 for k, one in heat.power_w.items()}
    energy_kj = {
        k: (one[rows] - one[begin]) / 1e3 for k, one in heat.energy_j.items()
    }
    force_kn = {
        k: np.where(moving, one / speed_ms, np.nan)
        for k, one in power_kw.items()
    }
    end_kj = np.full(2, stop.balance.brake_j / 1e3)
    balance = curve(since[[0, -1]], end_kj, "Eq 4.5", BLACK, dash="2px,3px")
    title = (
        f"stop {number}, {clock(stop.begin_s)}, "
        f"{3.6 * heat.speed_ms[stop.first]:.0f} to "
        f"{3.6 * heat.speed_ms[stop.last]:.0f} km/h, "
        f"{stop.pressure_pa / 1e5:.0f} bar"
    )
    powers = _by_source(since, power_kw, SHORT)
    energies = [*_by_source(since, energy_kj, SHORT, 2), balance]
    forces = _by_source(since, force_kn, SHORT)
    return [
        (name, plot(data, "time since the press [s]", y_title))
        for name, data, y_title in (
            (title, powers, "power [kW]"),
            ("energy", energies, "energy [kJ]"),
            ("brake force", forces, "brake force [kN]"),
        )
    ]


def friction_plots(friction: StopFriction) -> tuple[tuple[str, Plot], ...]:
    """Return friction within and from stop to stop (Fig 4.7)."""
    figures = []
    if friction.within:
        means = "mean of the stop over the hottest disc before it"
        figures.append(("within the stops", _within(friction)))
        figures.append((means, _means(friction)))
    if friction.axles:
        over_disc = "front and rear over the disc before the stop"
        figures.append((over_disc, _axles(friction)))
    return tuple(figures)


def _within(friction: StopFriction) -> Plot:
    stops = friction.within
    hottest = _hottest(friction)
    return plot(
        [
            curve(
                one.since_s,
                one.friction,
                _labelled(one.start_s, one.initial_c),
                _warmth(value, hottest),
                legend=len(stops) <= STOPS_NAMED,
            )
            for one, value in zip(stops, hottest.tolist(), strict=True)
        ],
        "time since the press [s]",
        "friction coefficient",
        yaxis=_friction_axis(np.concatenate([o.friction for o in stops])),
        legend={"orientation": "v", "x": 1.02, "y": 1.0, "yanchor": "top"},
    )


def _means(friction: StopFriction) -> Plot:
    means = np.array([float(np.mean(o.friction)) for o in friction.within])
    data = [cloud(_hottest(friction), means, "", BLUE, size=8)]
    return _over_disc(data, _friction_axis(means))


def _axles(friction: StopFriction) -> Plot:
    clouds = []
    for axle, colour in (("front", VERMILION), ("rear", BLUE)):
        own = [one for one in friction.axles if one.axle == axle]
        if not own:
            continue
        by = "by its discs" if own[0].by_discs else "rest of the balance"
        disc_c = np.array([one.initial_c for one in own])
        values = np.array([one.friction for one in own])
        clouds.append(cloud(disc_c, values, f"{axle}, {by}", colour, size=8))
    return _over_disc(clouds, {"rangemode": "tozero"})


def _over_disc(data: list[dict[str, Any]], yaxis: dict[str, Any]) -> Plot:
    title = "disc before the stop [°C]"
    return plot(data, title, "friction coefficient", yaxis=yaxis)


def _hottest(friction: StopFriction) -> Column:
    """Return the hottest disc before each stop, nan where none is known."""
    return np.array(
        [
            max(one.initial_c.values(), default=np.nan)
            for one in friction.within
        ]
    )


def _warmth(value: float, all_values: Column) -> str:
    """Return a colour from blue for the coldest to red for the hottest."""
    known = all_values[np.isfinite(all_values)]
    if not np.isfinite(value) or np.ptp(known) <= 0.0:
        return BLUE
    share = (value - known.min()) / np.ptp(known)
    mixed = (
        round(cold + share * (hot - cold))
        for cold, hot in zip(_COLD, _HOT, strict=True)
    )
    return "#" + "".join(f"{part:02x}" for part in mixed)


def _friction_axis(values: Any) -> dict[str, Any]:
    return {"range": wide_range(values, LEAST_SPAN)}


def _labelled(start_s: float, initial_c: dict[str, float]) -> str:
    text = clock(start_s)
    for side in "FR":
        own = [value for name, value in initial_c.items() if name[0] == side]
        if own:
            text += f" {side} {np.mean(own):.0f}"
    return text + " °C" * bool(initial_c)
