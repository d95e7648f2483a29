"""Columns of risk, forecast and advice from the records of publications."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from bstm_daemon.estimate import CarRisk

    Column = npt.NDArray[np.float64]

CORNER_COLUMNS: Final = {
    "fluid_std_k": "fluid_deviation_k",
    "risk_now": "probability_now",
    "risk": "probability",
    "risk_level": "level",
    "fade_level": "fade",
    "peak_c": "peak_k",
    "peak_in_s": "peak_in_s",
    "safe_in_s": "safe_in_s",
    "duty_peak_c": "duty_peak_k",
    "duty_in_s": "duty_in_s",
}
"""Attribute of a :class:`~bstm_daemon.estimate.CornerRisk` by column."""

CAR_COLUMNS: Final = {
    "risk_now": "probability_now",
    "risk": "probability",
    "risk_level": "level",
    "boiling_low_c": "boiling_low_k",
    "boiling_c": "boiling_k",
    "water_percent": "water_percent",
}
"""Attribute of a :class:`~bstm_daemon.estimate.CarRisk` by column."""

ADVICE_COLUMNS: Final = {
    "advice_message": "message",
    "advice_waiting_s": "waiting_s",
    "advice_shift": "shift_advice",
    "advice_gearbox": "gearbox_request",
    "advice_pedal_feel": "pedal_feel",
    "advice_isolation": "front_isolation",
    "advice_assist": "emergency_assist",
    "advice_intervention": "intervention",
}
"""Attribute of an :class:`~bstm_daemon.estimate.Advice` by column."""

ADVICE_CODES: Final = (
    *("advice_message", "advice_shift", "advice_gearbox"),
    *("advice_isolation", "advice_assist", "advice_intervention"),
)
"""Those of them that are codes."""


def record_columns(
    attributes: Mapping[str, str], records: Sequence[object]
) -> dict[str, Column]:
    """Return columns [n] of *records* [n].

    Args:
        attributes: attribute of a record by column; codes stay numbers, of a
            temperature in kelvin a column ``..._c`` is in degC.
        records: one a row.
    """
    rows = [*map(attrgetter(*attributes.values()), records)]
    table = np.array(rows, np.float64).T
    return {
        column: values - KELVIN_OFFSET if column.endswith("_c") else values
        for column, values in zip(attributes, table, strict=True)
    }


def risk_columns(
    records: npt.NDArray[np.object_],
    times_us: npt.NDArray[np.int64],
    corners: Sequence[str],
) -> tuple[dict[str, Column], dict[str, dict[str, Column]]]:
    """Return the columns of the car and those of each of *corners*.

    *records* holds a :class:`~bstm_daemon.estimate.CarRisk` per row. One
    stays the same object for some rows, so that few are unpacked.
    """
    starts = np.flatnonzero(
        [i == 0 or one is not records[i - 1] for i, one in enumerate(records)]
    )
    runs = np.diff(starts, append=len(records))
    distinct: list[CarRisk] = [records[i] for i in starts]

    def repeated(
        attributes: Mapping[str, str], found: Sequence[object]
    ) -> dict[str, Column]:
        columns = record_columns(attributes, found)
        return {key: np.repeat(one, runs) for key, one in columns.items()}

    car = repeated(CAR_COLUMNS, distinct)
    begun = np.array(
        [np.nan if r.forecast_us is None else r.forecast_us for r in distinct],
        np.float64,
    )
    age_us: Column = times_us.astype(np.float64) - np.repeat(begun, runs)
    car["forecast_age_s"] = age_us * 1e-6
    return car, {
        name: repeated(CORNER_COLUMNS, [one.corners[name] for one in distinct])
        for name in corners
    }
