"""Columns of risk and forecast from the records of publications."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.forecast.records import CarRisk, CornerRisk

    Column = npt.NDArray[np.float64]

CORNER_COLUMNS: Final = (
    "fluid_std_k",
    "risk_now",
    "risk",
    "risk_level",
    "fade_level",
    "peak_c",
    "peak_in_s",
    "safe_in_s",
    "duty_peak_c",
    "duty_in_s",
)
CAR_COLUMNS: Final = (
    "risk_now",
    "risk",
    "risk_level",
    "boiling_low_c",
    "boiling_c",
    "water_percent",
)


def risk_columns(
    records: npt.NDArray[np.object_],
    times_us: npt.NDArray[np.int64],
    corners: Sequence[str],
) -> tuple[dict[str, Column], dict[str, dict[str, Column]]]:
    """Return the columns of the car and those of each of *corners*.

    *records* holds a :class:`~bstm_daemon.forecast.records.CarRisk` per row.
    One stays the same object for some rows, so that few are unpacked.
    """
    starts = np.flatnonzero(
        [
            i == 0 or record is not records[i - 1]
            for i, record in enumerate(records)
        ]
    )
    runs = np.diff(starts, append=len(records))
    distinct: list[CarRisk] = [records[i] for i in starts]
    car = _table(CAR_COLUMNS, [_of_car(record) for record in distinct], runs)
    begun = np.array(
        [np.nan if r.forecast_us is None else r.forecast_us for r in distinct],
        np.float64,
    )
    age_us: Column = times_us.astype(np.float64) - np.repeat(begun, runs)
    car["forecast_age_s"] = age_us * 1e-6
    return car, {
        name: _table(
            CORNER_COLUMNS,
            [_of_corner(record.corners[name]) for record in distinct],
            runs,
        )
        for name in corners
    }


def _table(
    names: Sequence[str],
    rows: list[tuple[float, ...]],
    runs: npt.NDArray[np.intp],
) -> dict[str, Column]:
    table = np.repeat(np.array(rows, np.float64), runs, axis=0)
    return dict(zip(names, table.T, strict=True))


def _of_car(record: CarRisk) -> tuple[float, ...]:
    return (
        record.probability_now,
        record.probability,
        record.level,
        record.boiling_low_k - KELVIN_OFFSET,
        record.boiling_k - KELVIN_OFFSET,
        record.water_percent,
    )


def _of_corner(corner: CornerRisk) -> tuple[float, ...]:
    return (
        corner.deviation_k,
        corner.probability_now,
        corner.probability,
        corner.level,
        corner.fade,
        corner.peak_k - KELVIN_OFFSET,
        corner.peak_in_s,
        corner.safe_in_s,
        corner.duty_peak_k - KELVIN_OFFSET,
        corner.duty_in_s,
    )
