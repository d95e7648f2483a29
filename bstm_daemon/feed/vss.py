"""Names of COVESA VSS, the standard's and those of ``config/vss/bstm.vspec``.

A wheel's brake is one branch, the brakes of the car another; their leaves are
the fields of one message. A leaf is null where the value is unknown or its
validity forbids to use it.
"""

from typing import Any, Final

from bstm_daemon.feed.reader import Record

WHEELS: Final = {
    f"{row}{side[0]}": f"Vehicle.Chassis.Axle.{axle}.Wheel.{side}.Brake"
    for row, axle in (("F", "Row1"), ("R", "Row2"))
    for side in ("Left", "Right")
}
"""Branch by corner."""

CAR: Final = "Vehicle.Chassis.Brake"

TEMPERATURES: Final = {
    "DiscTemperature": "disc_c",
    "PadTemperature": "pad_front_c",
    "FluidTemperature": "fluid_c",
    "BoilingMargin": "margin_k",
}
"""Leaf of a wheel to field of the feed."""

UNITS: Final = {
    **dict.fromkeys(TEMPERATURES, "°C"),
    **dict.fromkeys(("VapourProbability", "PadWear"), "%"),
    "BoilingMargin": "K",
}
"""Leaves that are numbers, with their units."""

Values = dict[str, Any]

USABLE: Final = ("valid", "degraded")


def branches(record: Record) -> dict[str, Values]:
    """Return the leaves of each branch of *record*, time and validity too."""
    time_s = record["time_s"]
    found = {
        WHEELS[name]: {"time_s": time_s, **wheel_values(corner)}
        for name, corner in record["corners"].items()
    }
    usable = record["validity"] in USABLE
    found[CAR] = {
        "time_s": time_s,
        "Validity": record["validity"].upper(),
        "RiskLevel": record["level"].upper() if usable else "UNKNOWN",
        "VapourProbability": _percent(record["probability"], usable=usable),
        "DriverMessage": record["advice"]["message"].upper(),
    }
    return found


def wheel_values(corner: Values) -> Values:
    """Return the leaves of one wheel's brake."""
    usable = corner["validity"] in USABLE
    worn = corner["pad_wear_percent"]
    has_wear = corner["wear_validity"] in USABLE
    return {
        "Validity": corner["validity"].upper(),
        "Reasons": corner["reasons"],
        **{
            leaf: corner[field] if usable else None
            for leaf, field in TEMPERATURES.items()
        },
        "VapourProbability": _percent(corner["probability"], usable=usable),
        "RiskLevel": corner["level"].upper() if usable else "UNKNOWN",
        # whole percent, as the standard has it
        "PadWear": round(worn) if has_wear and worn is not None else None,
        "IsBrakesWorn": corner["wear_level"] == "worn" if has_wear else None,
        "WearValidity": corner["wear_validity"].upper(),
    }


def _percent(probability: float | None, *, usable: bool) -> float | None:
    if probability is None or not usable:
        return None
    return round(100.0 * probability, 2)
