"""Heat partition at the interface and the flux into the pad."""

from math import sqrt


def effusivity(
    conductivity_w_mk: float, density_kg_m3: float, heat_capacity_j_kgk: float
) -> float:
    """Thermal effusivity, Eq 2.4: sqrt(k rho cp) [W s^0.5 / (m2 K)]."""
    return sqrt(conductivity_w_mk * density_kg_m3 * heat_capacity_j_kgk)


def disc_share(
    disc_effusivity: float,
    disc_area_m2: float,
    pad_effusivity: float,
    pad_area_m2: float,
) -> float:
    """Share of the friction heat that enters the disc, Eq 2.3.

    The disc's area is the swept ring, not the pad's shadow on it: the ring
    passes under the pad once a turn and each part of it takes its share.
    Holds for half-spaces of equal surface temperature.
    """
    disc = disc_effusivity * disc_area_m2
    return disc / (disc + pad_effusivity * pad_area_m2)


def pad_share(share_of_disc: float, correction_factor: float) -> float:
    """Share that enters both pads: (1 - sigma) times the tuned factor.

    Section 4.3: the factor multiplies 1 - sigma; the disc takes the rest, so
    no heat is lost whatever the factor.

    Raises:
        ValueError: the factor asks for more heat than there is.
    """
    share = (1.0 - share_of_disc) * correction_factor
    if share > 1.0:
        msg = (
            f"heat_partition_correction_factor = {correction_factor} gives "
            f"the pads {share:.2f} of the heat; at most "
            f"{1.0 / (1.0 - share_of_disc):.1f} is possible"
        )
        raise ValueError(msg)
    return share


def pad_flux_w_m2(  # noqa: PLR0913, PLR0917  (what Eq 4.13 has)
    pressure_pa: float,
    slide_speed_ms: float,
    piston_area_m2: float,
    piston_count: int,
    friction_coefficient: float,
    pad_area_m2: float,
    share_of_pads: float,
    efficiency: float = 1.0,
) -> float:
    """Mean heat flux into one pad, Eq 4.13 in the right form [W/m2].

    ``q = share * eta mu p A n v / A_pad`` with the share of both pads: each
    face makes half of the corner's friction heat and each pad takes half of
    their share. The printed equation leaves out mu, n, eta and the share.
    """
    face_power_w = (
        efficiency
        * friction_coefficient
        * pressure_pa
        * piston_area_m2
        * piston_count
        * slide_speed_ms
    )
    return share_of_pads * face_power_w / pad_area_m2


def flux_ratio_at_radius(
    radius_m: float, inner_m: float, outer_m: float, pressure_distribution: str
) -> float:
    """Flux at *radius_m* over the pad's mean flux (sections 2.5.1, 4.5.1).

    Uniform wear makes the flux constant; uniform pressure makes it grow with
    the sliding speed, q = mu p omega r, so proportional to r. (Section 2.5.1
    prints 1/r for the latter; section 4.5.1 has it right.)
    """
    if pressure_distribution == "uniform-wear":
        return 1.0
    mean_radius = (
        2.0 / 3.0 * (outer_m**3 - inner_m**3) / (outer_m**2 - inner_m**2)
    )
    return radius_m / mean_radius
