"""Which heat modes a log allows, and what is missing for the others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.analysis.quality.channels import WHEELS
from bstm_daemon.analysis.quality.finding import ModeVerdict
from bstm_daemon.analysis.quality.limits import MISSING_SHARE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.quality.finding import Finding, RoleQuality
    from bstm_daemon.config.sections import Config, CornerConfig

_ACCELEROMETER: Final = "acceleration_longitudinal"


Inputs = tuple[list[str], list[str], list[str]]
"""The roles that a mode reads, what it misses, and remarks."""


def mode_verdicts(
    config: Config,
    roles: Sequence[RoleQuality],
    findings: Sequence[Finding],
) -> tuple[ModeVerdict, ...]:
    """Judge ff, fb, fused and measured, in this order."""
    judge = _Judge(config, roles, findings)
    forward, back = judge.feed_forward(), judge.feed_back()
    read, missing, remarks = (
        one + other for one, other in zip(forward, back, strict=True)
    )
    return (
        judge.verdict("ff", forward),
        judge.verdict("fb", back),
        judge.verdict("fused", (read, missing, remarks)),
        judge.verdict("measured", judge.measured()),
    )


class _Judge:
    def __init__(
        self,
        config: Config,
        roles: Sequence[RoleQuality],
        findings: Sequence[Finding],
    ) -> None:
        self._config = config
        self._found = {r.role for r in roles if r.statistics is not None}
        self._wrong: dict[str, list[str]] = {}
        for finding in findings:
            if finding.wrong and finding.fault != "missing":
                for role in finding.roles:
                    words = f"{role} {finding.fault}"
                    self._wrong.setdefault(role, []).append(words)
        self._standing = any(f.fault == "axles-disagree" for f in findings)
        self._absent = {
            r.role: f"{r.role}: absent {100 * r.statistics.missing_share:.0f} "
            "% of the time"
            for r in roles
            if r.statistics is not None
            and r.statistics.missing_share > MISSING_SHARE
        }

    def feed_forward(self) -> Inputs:
        read = self._speeds()
        missing = [] if read else ["a speed"]
        unfed = []
        for corner in self._config.disc_corners():
            pressure = self._pressure(corner)
            if pressure is None:
                unfed.append(corner.name)
            else:
                read.append(pressure)
        if unfed:
            missing.append(f"a pressure for {' '.join(unfed)}")
        return read, missing, []

    def feed_back(self) -> Inputs:
        read = self._speeds()
        heat = self._config.heat
        missing = [] if read else ["a speed"]
        remarks = []
        if "powertrain_torque" in self._found:
            read.append("powertrain_torque")
        elif heat.assume_powertrain_torque_nm is None:
            missing.append(
                "powertrain_torque (at the wheels), or "
                "assume_powertrain_torque_nm"
            )
        else:
            remarks.append(
                "powertrain torque assumed as "
                f"{heat.assume_powertrain_torque_nm:g} Nm"
            )
        if heat.slope == "accelerometer" and _ACCELEROMETER in self._found:
            read.append(_ACCELEROMETER)
        else:
            remarks.append("the road is assumed flat")
        return read, missing, remarks

    def measured(self) -> Inputs:
        discs = [
            f"temp_{corner.name.lower()}_disc"
            for corner in self._config.disc_corners()
        ]
        read = [role for role in discs if role in self._found]
        return read, [] if read else [f"one of {', '.join(discs)}"], []

    def verdict(self, mode: str, inputs: Inputs) -> ModeVerdict:
        """Return whether *mode* can run on *inputs*."""
        read, missing, remarks = map(dict.fromkeys, inputs)
        problems = [
            text for role in read for text in self._wrong.get(role, ())
        ]
        if self._standing and mode in ("fb", "fused"):
            problems.append(
                "axles disagree: the wheels do not show the car's motion"
            )
        absent = [text for role, text in self._absent.items() if role in read]
        return ModeVerdict(
            mode,
            usable=not (problems or missing),
            problems=tuple(dict.fromkeys(problems)),
            missing=tuple(missing),
            remarks=(*remarks, *absent),
        )

    def _speeds(self) -> list[str]:
        """Return the speeds that the estimator reads.

        A corner without a wheel speed takes the vehicle's, the vehicle
        without its own the mean of the wheels: all of them count.
        """
        return [
            role for role in ("vehicle_speed", *WHEELS) if role in self._found
        ]

    def _pressure(self, corner: CornerConfig) -> str | None:
        choice = [f"wheel_pressure_{corner.name.lower()}"]
        if corner.circuit == "secondary":
            choice.append("secondary_pressure")
        choice.append("primary_pressure")
        return next((role for role in choice if role in self._found), None)
