"""Findings of the checks of a log, as data."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from bstm_daemon.analysis.quality.channels import Channels
from bstm_daemon.analysis.quality.comparison import Fit
from bstm_daemon.analysis.quality.recording import ChannelStatistics, Recording
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config
from bstm_daemon.units import UNITS

Fault = Literal[
    "missing",
    "dead",
    "frozen",
    "dropouts",
    "sign",
    "unit",
    "scale",
    "offset",
    "lag",
    "unrelated",
    "swapped",
    "mis-wired",
    "implausible",
    "axles-disagree",
    "ambiguous",
    "id-collision",
    "own-frames",
]

Named = tuple[str, bool | None, "Fit | None"]
"""Verdict of a comparison, whether both agree, and the fit."""

_VALUES: Final = {"unit", "scale", "offset", "unrelated"}


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault with a name.

    ``roles`` are the channels it concerns; ``wrong`` means that their values
    must not be used, otherwise it is worth knowing only.
    """

    fault: Fault
    roles: tuple[str, ...]
    text: str
    wrong: bool = True


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two readings of one quantity side by side.

    ``agrees`` is None where the log does not allow a verdict; ``verdict``
    has the words. ``time_s``, ``reference`` and ``channel``, (n,), are
    what was compared, in SI; people read ``unit``, and of a reference of
    another quantity ``reference_unit``.
    """

    title: str
    reference_name: str
    channel_name: str
    verdict: str
    agrees: bool | None
    fit: Fit | None
    time_s: Column
    reference: Column
    channel: Column
    unit: str
    reference_unit: str = ""

    @property
    def unit_si(self) -> float:
        """Factor of the unit to SI."""
        return _factor(self.unit)

    @property
    def reference_scale(self) -> tuple[str, float]:
        """Unit of the reference for people, and its factor to SI."""
        unit = self.reference_unit or self.unit
        return unit, _factor(unit)


def _factor(unit: str) -> float:
    # what is a flag, or of two quantities, is shown as it is
    return UNITS[unit].factor if unit in UNITS else 1.0


@dataclass(frozen=True, slots=True)
class RoleQuality:
    """A configured role in the log; ``statistics`` is None if not found."""

    role: str
    source: str
    unit: str
    timeout_s: float
    statistics: ChannelStatistics | None
    why_missing: str = ""


@dataclass(frozen=True, slots=True)
class ModeVerdict:
    """Whether a heat mode can run on this log.

    ``problems`` are the faults of channels it reads, ``missing`` what it
    would need besides, ``remarks`` what limits it.
    """

    mode: str
    usable: bool
    problems: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


class Checks(Channels):
    """The channels of a recording, and what the checks find of them."""

    def __init__(
        self, recording: Recording, config: Config, timeouts_us: Iterable[int]
    ) -> None:
        """Put every role of *recording* on one grid; nothing is found yet."""
        super().__init__(recording, config, timeouts_us)
        self.findings: list[Finding] = []
        self.comparisons: list[Comparison] = []
        self.not_judged: list[str] = []

    def fault(
        self,
        fault: Fault,
        role: str | tuple[str, ...],
        text: str,
        *,
        wrong: bool = True,
    ) -> None:
        """Name *fault* of the channel *role*, or of several.

        Of wrong values (unit, scale, offset, unrelated) of one channel the
        first that is found stays: those after it follow from it.
        """
        roles = (role,) if isinstance(role, str) else role
        known = {f.fault for f in self.findings if f.roles == roles}
        if len(roles) == 1 and fault in _VALUES and known & _VALUES:
            return
        self.findings.append(Finding(fault, roles, text, wrong))

    def rule_out(self, fault: Fault, role: str, text: str) -> None:
        """Name *fault* of the channel *role* and leave it out from here on."""
        self.fault(fault, role, text)
        self.dead.add(role)

    def compare(
        self,
        title: str,
        pair: tuple[str, str],
        columns: tuple[Column, Column],
        named: Named,
        unit: str,
        reference_unit: str = "",
    ) -> None:
        """Keep a :class:`Comparison`.

        *pair* names reference and channel, whose values are *columns*;
        *named* is verdict, whether both agree, and the fit.
        A reference of another quantity has a unit of its own.
        """
        values = title, *pair, *named, self.time_s, *columns, unit
        self.comparisons.append(Comparison(*values, reference_unit))

    def skip(self, text: str) -> None:
        """Note a check that this log does not allow, and why."""
        self.not_judged.append(text)


@dataclass(frozen=True)
class Quality:
    """The whole judgement of a recording."""

    duration_s: float
    roles: tuple[RoleQuality, ...]
    comparisons: tuple[Comparison, ...]
    findings: tuple[Finding, ...]
    not_judged: tuple[str, ...]
    modes: tuple[ModeVerdict, ...]
    configured_mode: str
    refused: Mapping[str, int]

    @property
    def usable(self) -> bool:
        """Whether the configured heat mode can run."""
        return next(
            mode.usable
            for mode in self.modes
            if mode.mode == self.configured_mode
        )
