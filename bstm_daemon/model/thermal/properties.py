"""Material properties over temperature, as tables in kelvin."""

from collections.abc import Sequence
from typing import Final

from bstm_daemon.config.section import Curve
from bstm_daemon.config.sections import DiscConfig
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

REFERENCE_K: Final = 293.15
"""Temperature at which a cooling form with constant h A takes cp, and that a
curve keeps whatever its exponent."""

DISC_LIMIT_C: Final = 650.0
"""Up to here the model is checked: above, a disc's cheeks are far from one
lump, and its iron absorbs more heat than any formula of it says."""


def _celsius_table(
    temperature_c: Sequence[float], value: Sequence[float]
) -> Table:
    return Table.from_points([t + KELVIN_OFFSET for t in temperature_c], value)


PURE_IRON_HEAT_CAPACITY_J_KGK: Final = _celsius_table(
    (20, 650), (449.0, 449.0 + (685.0 - 449.0) / 480.0 * 630.0)
)
"""The thesis's disc (Fig 2.4 and section 2.4.1): pure iron, linear over the
disc's range, through 449 at 20 degC and 685 at 500 degC."""

GREY_IRON_HEAT_CAPACITY_J_KGK: Final = _celsius_table(
    (20, 100, 200, 300, 400, 500, 600, 700, 750, 800, 900),
    (460, 490, 525, 560, 600, 650, 710, 820, 1100, 680, 660),
)
"""Grey cast iron GJL-250, typical handbook curve; the peak near 750 degC is
the Curie point (770 degC in pure iron) with the eutectoid."""


GREY_IRON_SMOOTH_HEAT_CAPACITY_J_KGK: Final = _celsius_table(
    (20, 100, 200, 300, 400, 500, 600, 700, 800, 900),
    (460, 490, 525, 560, 600, 650, 710, 790, 880, 970),
)
"""The same without the peak, which effect ``disc_capacity_hot`` adds."""


def disc_heat_capacity(disc: DiscConfig) -> Table:
    """Specific heat [J/kgK] over temperature [K] of the configured disc."""
    if disc.heat_capacity_j_kgk is not None:
        table = curve_table(disc.heat_capacity_j_kgk)
    elif disc.material == "pure-iron":
        table = PURE_IRON_HEAT_CAPACITY_J_KGK
    elif disc.material == "grey-iron-smooth":
        table = GREY_IRON_SMOOTH_HEAT_CAPACITY_J_KGK
    else:
        table = GREY_IRON_HEAT_CAPACITY_J_KGK
    if disc.heat_capacity_exponent == 1.0:
        return table
    first = table(REFERENCE_K)
    return Table(
        table.x0,
        table.dx,
        tuple(
            first * (one / first) ** disc.heat_capacity_exponent
            for one in table.values
        ),
    )


def curve_table(curve: Curve) -> Table:
    """Return a configured *curve* as a table over kelvin."""
    return _celsius_table(curve.temperature_c, curve.value)
