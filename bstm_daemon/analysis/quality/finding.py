"""Findings of the checks of a log, as data."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from bstm_daemon.analysis.quality.comparison import Fit
from bstm_daemon.analysis.quality.recording import ChannelStatistics
from bstm_daemon.analysis.statistics.series import Column

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
    what was compared, in SI; for people both are divided by ``unit_si`` to
    ``unit``, a reference of another quantity by ``reference_si``.
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
    unit_si: float = 1.0
    reference_unit: str | None = None
    reference_si: float = 1.0

    @property
    def reference_scale(self) -> tuple[str, float]:
        """Unit of the reference for people, and its factor to SI."""
        if self.reference_unit is None:
            return self.unit, self.unit_si
        return self.reference_unit, self.reference_si


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


@dataclass
class Notes:
    """Where the checks write what they find."""

    findings: list[Finding] = field(default_factory=list)
    comparisons: list[Comparison] = field(default_factory=list)
    not_judged: list[str] = field(default_factory=list)

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

    def compare(
        self,
        title: str,
        pair: tuple[str, str],
        columns: tuple[Column, Column, Column],
        named: Named,
        unit: str,
        **units: Any,
    ) -> None:
        """Keep a :class:`Comparison`.

        *pair* names reference and channel, *columns* are time, reference and
        channel, *named* is verdict, whether it agrees, and the fit.
        """
        reference, channel = pair
        verdict, agrees, fit = named
        self.comparisons.append(
            Comparison(
                title, reference, channel, verdict, agrees, fit, *columns,
                unit, **units,
            )
        )  # fmt: skip

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
