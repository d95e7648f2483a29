"""Heat losses of a disc besides S: the terms of the estimator's disc model.

A cool-down is followed with the configured disc (mass, heat capacity,
emissivity, standstill blend), so that the S found is the S the estimator
uses: radiation at standstill is subtracted, not fitted a second time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Indices
from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.model.thermal import brake_corner, properties
from bstm_daemon.model.thermal.partition import pad_share
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

LOWEST_K: Final = 200.0
HIGHEST_K: Final = 2000.0


@dataclass(frozen=True, slots=True)
class DiscLoss:
    """One disc: capacity, radiation and blend as configured.

    ``radiation_w_k4`` is sigma eps A of the free area and ``pads_w_k4`` that
    of the exchange with both pads (Eq 2.9 to 2.11).
    """

    capacity: Table
    mass_kg: float
    rate_form: bool
    radiation_w_k4: float
    pads_w_k4: float
    blend_end_ms: float
    still: float
    speeds_ms: tuple[float, ...]
    s_per_s: tuple[float, ...]

    @property
    def form(self) -> str:
        """The ``[cooling] form`` that S is given in."""
        return "rate" if self.rate_form else "conductance"

    def configured(self, speed_ms: Column | float) -> Column:
        """Return S of the configuration at *speed_ms*, (n,)."""
        x, y = self.speeds_ms, self.s_per_s
        speed = np.asarray(speed_ms, np.float64)
        end, twice = (
            brake_corner.cooling_beyond(x, y, n * x[-1]) for n in (1.0, 2.0)
        )
        power = np.log2(twice / end) if end > 0.0 else 0.0
        ratio = np.maximum(speed / x[-1], 1.0)
        return np.asarray(np.interp(speed, x, y) * ratio**power)

    def shape(self, speed_ms: Column, mean_ms: float) -> Column:
        """Return the factor on S at *mean_ms* at each speed, (n,).

        The blend of the standstill model, and the configured slope of S over
        the small changes of speed. 1 at standstill, where the factor on S
        and the blend can not be separated.
        """
        if mean_ms <= 0.0:
            return np.ones(len(speed_ms))
        there = max(float(self.configured(mean_ms)), 1e-9)
        blend = self.still + (1.0 - self.still) * np.clip(
            speed_ms / self.blend_end_ms, 0.0, 1.0
        )
        return np.asarray(self.configured(speed_ms) / there * blend)

    def radiating(self, speed_ms: Column) -> Column:
        """Return the share of net radiation beside S, (n,)."""
        return np.clip(1.0 - speed_ms / self.blend_end_ms, 0.0, 1.0)

    def heat_capacity_j_k(self, disc_k: Column) -> Column:
        """Return the disc's capacity at *disc_k*, (n,)."""
        table = self.capacity
        grid = table.x0 + table.dx * np.arange(len(table.values))
        return self.mass_kg * np.interp(disc_k, grid, table.values)


def beyond_words(axle: str, share: float, end_ms: float) -> str:
    """Say which *share* of the time is faster than a table that ends there."""
    return (
        f"{axle}: {100.0 * share:.0f} % of the time is faster than the table, "
        f"which ends at {3.6 * end_ms:.0f} km/h: beyond it a power law"
    )


def disc_loss(config: Config, corner_name: str) -> DiscLoss | None:
    """Return the disc of the corner of that name, None without one."""
    corner = next((c for c in config.corner if c.name == corner_name), None)
    if corner is None or corner.disc is None or corner.pad is None:
        return None
    spec = brake_corner.corner_spec(config, corner)
    thermal, cooling = spec.thermal, spec.cooling
    eps_d, eps_p = thermal.disc_emissivity, thermal.pad_emissivity
    effective = 1.0 / (1.0 / eps_d + 1.0 / eps_p - 1.0)
    if thermal.disc_pad_radiation == "product":
        effective = eps_d * eps_p
    return DiscLoss(
        properties.disc_heat_capacity(spec.disc),
        spec.disc_mass_kg,
        cooling.form == "rate",
        STEFAN_BOLTZMANN_W_M2K4 * eps_d * spec.disc_radiating_m2,
        STEFAN_BOLTZMANN_W_M2K4 * effective * spec.pads_area_m2,
        cooling.blend_end_ms,
        cooling.standstill_convection_fraction,
        tuple(cooling.speed_ms),
        tuple(cooling.s_per_s),
    )


def disc_part(spec: brake_corner.CornerSpec) -> float:
    """Return the part of a brake's work that heats its disc."""
    thermal = spec.thermal
    pads = pad_share(spec.disc_share, thermal.heat_partition_correction_factor)
    return (1.0 - thermal.direct_air_fraction) * (1.0 - pads)


def share_of_work(config: Config, corner: CornerConfig) -> float:
    """Return the disc's share of the car's brake work, as configured."""
    front = config.vehicle.front_share
    of_axle = front if corner.name[0] == "F" else 1.0 - front
    return 0.5 * of_axle * disc_part(brake_corner.corner_spec(config, corner))


class HeatCapacities:
    """Heat capacities of discs that are marched side by side."""

    def __init__(
        self, losses: Sequence[DiscLoss], rate_forms: Sequence[bool]
    ) -> None:
        """Take the discs, and of each the form that S is given in."""
        kelvins = np.arange(LOWEST_K, HIGHEST_K + 1.0)
        self._inverse = np.array(
            [1.0 / loss.heat_capacity_j_k(kelvins) for loss in losses]
        )
        at = np.full(1, properties.REFERENCE_K)
        self._reference = np.array(
            [
                0.0 if rate else loss.heat_capacity_j_k(at)[0]
                for loss, rate in zip(losses, rate_forms, strict=True)
            ]
        )

    def inverse(self, discs: Indices, now_k: Column) -> Column:
        """Return 1 / (m c_p) [K/J] of *discs*, by number, at *now_k*.

        Both of one shape, or broadcast to it.
        """
        place = np.clip(now_k - LOWEST_K, 0.0, HIGHEST_K - LOWEST_K - 1.0)
        index = place.astype(np.int64)
        low, high = (
            self._inverse[discs, index],
            self._inverse[discs, index + 1],
        )
        return np.asarray(low + (place - index) * (high - low))

    def factor(self, discs: Indices, inverse: Column) -> Column:
        """Return the factor on S at that :meth:`inverse` (Eq 4.12).

        1 where S is a rate; a conductance is S times the capacity at 20 degC.
        """
        reference = self._reference[discs]
        return np.where(reference > 0.0, reference * inverse, 1.0)
