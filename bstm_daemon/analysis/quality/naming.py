"""Verdict on a fit: a named fault, or agreement."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import Channels, unit_ratio
from bstm_daemon.analysis.quality.comparison import Fit
from bstm_daemon.analysis.quality.finding import Checks, Fault, Named
from bstm_daemon.units import UNITS


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerated differences of two readings; offsets in SI."""

    scale: float
    offset: float
    lag_s: float = limits.LAG_S
    unit: float = limits.UNIT_TOLERANCE


@dataclass(frozen=True, slots=True)
class Naming:
    """Faults that a fit shows, with their texts."""

    faults: tuple[tuple[Fault, str], ...] = ()
    why_not_judged: str = ""
    fit: Fit | None = None

    @property
    def agrees(self) -> bool | None:
        """True or False, None where nothing can be said."""
        if self.why_not_judged:
            return None
        return all(fault == "lag" for fault, _ in self.faults)

    @property
    def verdict(self) -> str:
        """The verdict in plain words."""
        if self.why_not_judged:
            return f"not judged: {self.why_not_judged}"
        return "; ".join(text for _, text in self.faults) or "agrees"

    @property
    def named(self) -> Named:
        """What :meth:`Checks.compare` keeps of it."""
        return self.verdict, self.agrees, self.fit


def name_faults(
    channels: Channels,
    role: str,
    fit: Fit | None,
    tolerance: Tolerance,
    why_not: str = "",
) -> Naming:
    """Name what *fit* shows of *role*, the channel, against a reference.

    *why_not* gives a reason of the caller's why nothing can be judged. A
    scale is only named where the whole interval of the fit is wrong, scale and
    offset where the medians show them too; a sign and a scale may be wrong at
    once.
    """
    if why_not or fit is None or fit.seconds < limits.ENOUGH_S:
        return Naming((), why_not or "too little in common", fit)
    if abs(fit.correlation) < limits.UNRELATED:
        text = f"does not follow (r = {fit.correlation:.2f})"
        return Naming((("unrelated", text),), fit=fit)
    found: list[tuple[Fault, str]] = []
    if fit.scale < 0.0:
        found.append(("sign", "wrong sign"))
    if fit.beyond(tolerance.scale):
        found.append(_scale(channels, role, fit, tolerance))
    elif fit.offset_beyond(tolerance.offset):
        unit, factor = channels.unit(role)
        found.append(("offset", f"offset {fit.offset / factor:+.3g} {unit}"))
    lag_s = fit.lag_s
    if lag_s is not None and abs(lag_s) > tolerance.lag_s:
        late = "late" if lag_s > 0.0 else "early"
        found.append(("lag", f"{abs(lag_s):.2f} s {late}"))
    return Naming(tuple(found), fit=fit)


def _scale(
    channels: Channels, role: str, fit: Fit, tolerance: Tolerance
) -> tuple[Fault, str]:
    unit = channels.unit_for_scale(role, fit.scale, tolerance.unit)
    configured, _ = channels.unit(role)
    text = f"reads {abs(fit.scale):.3g} times as much"
    if unit is not None:
        text += f", configured as {configured}, the values are {unit}"
        return "unit", f"wrong unit: {text}"
    pair = unit_ratio(UNITS[configured].quantity, fit.scale, tolerance.unit)
    if pair is not None:
        text += f", which is {pair[0]} to {pair[1]}"
        text += ": converted twice, or by the wrong one"
        return "unit", f"wrong unit: {text}"
    return "scale", f"wrong scale: {text}"


def write_faults(
    channels: Checks, role: str, naming: Naming, against: str
) -> None:
    """Write each fault of *naming* as one of *role*; leave a wrong one out."""
    for fault, text in naming.faults:
        channels.fault(
            fault, role, f"{text}, against {against}", wrong=fault != "lag"
        )
    if naming.agrees is False:
        channels.dead.add(role)


def components(
    roles: Sequence[str], agrees: Callable[[str, str], bool | None]
) -> list[tuple[str, ...]]:
    """Return groups of *roles* that agree with one another, largest first.

    A role joins a group by agreeing with any member; None from *agrees*
    (nothing can be said) joins nothing.
    """
    group_of = {role: {role} for role in roles}
    for one, other in combinations(roles, 2):
        if group_of[one] is not group_of[other] and agrees(one, other):
            merged = group_of[one] | group_of[other]
            for role in merged:
                group_of[role] = merged
    found: list[tuple[str, ...]] = []
    for role in roles:
        group = tuple(name for name in roles if name in group_of[role])
        if group not in found:
            found.append(group)
    return sorted(found, key=len, reverse=True)
