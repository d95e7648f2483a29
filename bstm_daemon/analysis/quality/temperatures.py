"""Checks of measured brake temperatures for what is possible in a brake."""

from dataclasses import replace
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.braking import feed_forward_n
from bstm_daemon.analysis.quality.channels import Channels
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.finding import Checks, Fault
from bstm_daemon.analysis.quality.recording import constant_runs
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.roles import PRESSURES
from bstm_daemon.units import KELVIN_OFFSET

_START_S: Final = 10.0
_RATE_STEPS: Final = round(1.0 / limits.GRID_S)
_PEAKS: Final = 0.999


def check_temperatures(channels: Checks) -> None:
    """Check every measured temperature; wrong ones are left out."""
    roles = [role for role in channels.series if role.startswith("temp_")]
    ambient_k = _ambient_k(channels)
    for role in roles:
        if _miswired(channels, role) or _shifted(channels, role, ambient_k[0]):
            continue
        node = role.split("_", 2)[2]
        _range(channels, role, limits.TEMPERATURE_RANGE_K[node])
        _rate(channels, role, limits.TEMPERATURE_RATE_K_S[node])
        if role not in channels.dead:
            _start(channels, role, ambient_k)
        if node == "disc" and role not in channels.dead:
            _work(channels, role)
    _left_right(channels, roles)


def _ambient_k(channels: Channels) -> tuple[float, str]:
    series = channels.series.get("ambient_temperature")
    if series is None:
        return channels.config.vehicle.ambient_k, "ambient_c of [vehicle]"
    return float(np.median(series.value)), "the ambient temperature"


def _miswired(channels: Checks, role: str) -> bool:
    """Whether *role* is the line of a pressure."""
    temperature = channels.value(role)
    known = np.isfinite(temperature)
    if not known.any() or np.ptp(temperature[known]) == 0.0:
        return False
    found: list[tuple[str, Fit]] = []
    for other in channels.alive(PRESSURES):
        pressure = channels.value(other)
        both = known & np.isfinite(pressure)
        if not both.any() or np.ptp(pressure[both]) < limits.PRESSURE_SPAN_PA:
            continue
        if _presses(pressure[both]) < limits.MISWIRED_PRESSES:
            continue
        fit = fit_channels(pressure, temperature, limits.PRESSURE_SPAN_PA)
        if fit is not None and abs(fit.correlation) >= limits.MISWIRED:
            found.append((other, fit))
    if not found:
        return False
    other, fit = max(found, key=lambda pair: abs(pair[1].correlation))
    verdict = (
        f"mis-wired: follows {other} (r = {fit.correlation:.4f}, "
        f"{1e5 * fit.scale:.3g} K a bar), a brake part neither heats nor "
        "cools with the pedal"
    )
    channels.rule_out("mis-wired", role, verdict)
    _compare(channels, other, role, (verdict, False, fit))
    return True


def _presses(pressure: Column) -> int:
    """Count how often the pedal goes down."""
    low, high = np.percentile(pressure, (5, 99))
    level = max(0.5 * (low + high), limits.PRESSED_PA)
    return int(np.count_nonzero(np.diff((pressure > level).astype(int)) > 0))


def _shifted(channels: Checks, role: str, ambient_k: float) -> bool:
    """Whether *role* is off by the 273 K between kelvin and degC."""
    start_k = float(np.median(channels.series[role].value[:10]))
    for shift_k, words in (
        (KELVIN_OFFSET, "degC read as K"),
        (-KELVIN_OFFSET, "K read as degC"),
    ):
        if abs(start_k + shift_k - ambient_k) < limits.COLDER_K:
            channels.rule_out(
                "unit",
                role,
                f"wrong unit: starts at {start_k - KELVIN_OFFSET:.0f} degC, "
                f"it is {words}",
            )
            return True
    return False


def _range(channels: Checks, role: str, bounds: tuple[float, float]) -> None:
    value = channels.series[role].value
    outside = (value < bounds[0]) | (value > bounds[1])
    if outside.any():
        low_c, high_c = (limit - KELVIN_OFFSET for limit in bounds)
        channels.rule_out(
            "implausible",
            role,
            f"implausible: {value.min() - KELVIN_OFFSET:.0f} to "
            f"{value.max() - KELVIN_OFFSET:.0f} degC, possible are "
            f"{low_c:.0f} to {high_c:.0f}",
        )


def _rate(channels: Checks, role: str, limit_k_s: float) -> None:
    value = channels.value(role)
    rate = np.abs(value[_RATE_STEPS:] - value[:-_RATE_STEPS])
    known = rate[np.isfinite(rate)]
    peak = np.quantile(known, _PEAKS) if len(known) else 0.0
    if peak > limit_k_s:
        text = f"implausible: changes by {peak:.0f} K in a second, possible"
        channels.rule_out("implausible", role, f"{text} are {limit_k_s:.0f}")


def _start(channels: Checks, role: str, ambient: tuple[float, str]) -> None:
    series = channels.series[role]
    first = series.value[series.time_s <= series.time_s[0] + _START_S]
    ambient_k, name = ambient
    start_k = float(np.median(first))
    if start_k < ambient_k - limits.COLDER_K:
        channels.fault(
            "implausible",
            role,
            f"implausible: starts at {start_k - KELVIN_OFFSET:.0f} degC, "
            f"{ambient_k - start_k:.0f} K colder than {name}",
            wrong="ambient_temperature" in channels.series,
        )


def _work(channels: Checks, role: str) -> None:
    """Name a disc temperature that stands still while the brakes work."""
    corner = role.split("_")[1]
    near = [f"wheel_pressure_{corner}", *PRESSURES[:2]]
    pressures = channels.alive(near)
    series = channels.series[role]
    if not pressures or not channels.speed_roles or channels.on_stand:
        channels.skip(f"{role}: no pressure and speed to compare it with")
        return
    braking = channels.value(pressures[0]) > limits.PRESSED_PA
    braking &= channels.speed > limits.MOVING_MS
    power = feed_forward_n(channels, pressures[0]) * channels.speed
    work = np.where(braking, power, 0.0) / channels.config.vehicle.mass_kg
    work = np.nan_to_num(work) * limits.GRID_S
    if work.sum() < limits.DISC_WORK_MS2S:
        channels.skip(f"{role}: hardly any braking, heating is not seen")
        return
    for run in constant_runs(series, 5.0):
        here = (channels.time_s > run.start_s) & (channels.time_s < run.end_s)
        if work[here].sum() < limits.DISC_WORK_MS2S:
            continue
        value = f"{run.value - KELVIN_OFFSET:.1f} degC"
        fault: Fault = "frozen"
        text = f"at {value} from {run.start_s:.1f} to {run.end_s:.1f} s"
        if len(np.unique(series.value)) == 1:
            fault, text = "dead", f"reads {value} throughout"
        text = f"{fault}: {text}, while the brakes work"
        channels.rule_out(fault, role, text)


def _left_right(channels: Checks, roles: list[str]) -> None:
    """Show left beside right, without a verdict, as brakes differ."""
    for left in roles:
        right = left.replace("l_", "r_", 1)
        if left.split("_")[1][1] != "l" or right not in roles:
            continue
        fit = fit_channels(
            channels.value(left), channels.value(right), 20.0, lagged=False
        )
        if fit is not None:
            verdict = (
                f"left and right, r = {fit.correlation:.3f} (no verdict: "
                "brakes may differ)"
            )
            _compare(channels, left, right, (verdict, None, fit))


def _compare(
    channels: Checks,
    reference: str,
    role: str,
    named: tuple[str, bool | None, Fit],
) -> None:
    """Keep the comparison in degC; the fit is in kelvin."""
    is_pressure = reference in PRESSURES
    offset = 0.0 if is_pressure else KELVIN_OFFSET
    verdict, agrees, fit = named
    in_c = replace(fit, offset=fit.offset + fit.scale * offset - KELVIN_OFFSET)
    columns = channels.value(reference), channels.value(role)
    channels.compare(
        f"{role} against {reference}",
        (reference, role),
        (columns[0] - offset, columns[1] - KELVIN_OFFSET),
        (verdict, agrees, in_c),
        "degC",
        reference_unit="bar" if is_pressure else "",
    )
