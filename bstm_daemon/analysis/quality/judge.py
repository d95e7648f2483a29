"""The judgement of a recording: every check, in the order they build on.

What they find decides which heat modes the log allows.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from bstm_daemon.analysis.quality import braking
from bstm_daemon.analysis.quality.accelerations import compare_accelerations
from bstm_daemon.analysis.quality.bends import compare_axles, compare_sides
from bstm_daemon.analysis.quality.collisions import note_collisions
from bstm_daemon.analysis.quality.finding import (
    Checks,
    Finding,
    ModeVerdict,
    Quality,
    RoleQuality,
)
from bstm_daemon.analysis.quality.frozen import find_frozen, find_frozen_speeds
from bstm_daemon.analysis.quality.limits import MISSING_FAILS, MISSING_SHARE
from bstm_daemon.analysis.quality.recording import (
    Recording,
    bus_pauses,
    channel_statistics,
)
from bstm_daemon.analysis.quality.speeds import compare_speeds, note_unjudged
from bstm_daemon.analysis.quality.temperatures import check_temperatures
from bstm_daemon.bus.opening import id_text
from bstm_daemon.bus.signals.extraction import FrameKey, MessagePlan
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.roles import (
    LONGITUDINAL,
    PRESSURES,
    ROLE_INDEX,
    WHEELS,
    pressure_roles,
)

Inputs = tuple[list[str], list[str], list[str]]
"""The roles that a mode reads, what it misses, and remarks."""


def mode_verdicts(
    config: Config, roles: Sequence[RoleQuality], findings: Sequence[Finding]
) -> tuple[ModeVerdict, ...]:
    """Judge ff, fb, fused and measured, in this order."""
    judge = _Judge(config, roles, findings)
    forward, back = judge.feed_forward(), judge.feed_back()
    read, missing, remarks = (
        one + other for one, other in zip(forward, back, strict=True)
    )
    if not judge.found(LONGITUDINAL):
        missing.append(f"{LONGITUDINAL} to learn from")
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

    def found(self, role: str) -> bool:
        """Return whether the recording has *role*."""
        return role in self._found

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
        if heat.slope == "accelerometer" and LONGITUDINAL in self._found:
            read.append(LONGITUDINAL)
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
        choice = pressure_roles(corner.name, corner.circuit)
        return next((role for role in choice if role in self._found), None)


def judge(
    recording: Recording,
    config: Config,
    signal_map: SignalMap,
    own_frames: Mapping[int, int] | None = None,
) -> Quality:
    """Judge *recording* for *config*, whose plan *signal_map* is.

    *own_frames* is what
    :func:`~bstm_daemon.analysis.quality.collisions.count_own_frames` found;
    without it no frame of the recording counts as the daemon's own.

    A channel that is found wrong takes no part in the checks after it, so
    that one fault is named once.
    """
    channels = Checks(recording, config, signal_map.timeouts_us)
    roles = _roles(channels, signal_map)
    # absurd values overflow: the fits are then unusable
    with np.errstate(over="ignore", invalid="ignore"):
        _compare(channels)
    note_collisions(channels, own_frames or {})
    findings = tuple(dict.fromkeys(channels.findings))
    return Quality(
        recording.duration_s,
        roles,
        tuple(channels.comparisons),
        findings,
        tuple(dict.fromkeys(channels.not_judged)),
        mode_verdicts(config, roles, findings),
        config.heat.mode,
        recording.refused,
    )


def _compare(channels: Checks) -> None:
    """Run the checks; each leaves out what those before found wrong."""
    find_frozen_speeds(channels)
    compare_speeds(channels)
    note_unjudged(channels)
    if not channels.on_stand:
        find_frozen(channels, LONGITUDINAL, channels.speed_rate())
    compare_accelerations(channels)
    compare_sides(channels)
    compare_axles(channels)
    for role in channels.alive(PRESSURES):
        others = [o for o in channels.alive(PRESSURES) if o != role]
        if others:
            find_frozen(channels, role, channels.value(others[0]))
    braking.check_resting(channels)
    says = braking.compare_braking(channels)
    braking.compare_pressures(channels, says)
    braking.compare_switch(channels)
    check_temperatures(channels)


def _roles(channels: Checks, signal_map: SignalMap) -> tuple[RoleQuality, ...]:
    recording, config = channels.recording, channels.config
    keys = {
        output.role: (key, plan)
        for key, plan in signal_map.messages.items()
        for output in plan.outputs
    }
    sources = {
        keys[number][0] if number in keys else role: series
        for role, series in recording.series.items()
        for number in (ROLE_INDEX[role],)
    }
    pauses = bus_pauses(sources.values(), recording.duration_s)
    found = []
    for role, signal in config.signals.items():
        number = ROLE_INDEX[role]
        timeout_s = channels.timeout_s(role)
        source = signal.column or (
            f"{signal.message}.{signal.signal or signal.expression}"
        )
        statistics, why = None, ""
        if role in recording.series:
            series = recording.series[role]
            statistics = channel_statistics(
                series, recording.duration_s, timeout_s, pauses
            )
            if statistics.missing_share > MISSING_SHARE:
                channels.fault(
                    "dropouts",
                    role,
                    f"absent {100 * statistics.missing_share:.0f} % of the "
                    f"time, {statistics.gaps_over_timeout} gaps over "
                    f"{timeout_s:g} s, the longest "
                    f"{statistics.longest_gap_s:.1f} s",
                    wrong=statistics.missing_share > MISSING_FAILS,
                )
        else:
            why = "no row with a value"
            if number in keys:
                why = _why_missing(*keys[number], recording, signal_map)
            channels.fault("missing", role, why, wrong=False)
        found.append(
            RoleQuality(role, source, signal.unit, timeout_s, statistics, why)
        )
    return tuple(found)


def _why_missing(
    key: FrameKey,
    plan: MessagePlan,
    recording: Recording,
    signal_map: SignalMap,
) -> str:
    where = id_text(key.can_id, extended=key.extended)
    frames = recording.seen.get((key.bus, key.can_id, key.extended), 0)
    if not frames:
        bus = signal_map.buses[key.bus].name
        return f"no frame {where} ({plan.name}) on {bus}"
    refused = ", ".join(
        f"{count} {reason.replace('_', ' ')}"
        for reason, count in recording.refused.items()
        if reason not in ("unknown_id", "unknown_interface")
    )
    return (
        f"{frames} frames {where} ({plan.name}), none with a value (in this "
        f"log: {refused or 'none refused'}; the DBC has {plan.length} bytes)"
    )
