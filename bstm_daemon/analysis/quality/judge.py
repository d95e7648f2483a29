"""The judgement of a recording: every check, in the order they build on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.analysis.quality.accelerations import (
    LONGITUDINAL,
    compare_accelerations,
)
from bstm_daemon.analysis.quality.bends import compare_axles, compare_sides
from bstm_daemon.analysis.quality.braking import (
    compare_braking,
    compare_switch,
)
from bstm_daemon.analysis.quality.channels import PRESSURES, Channels
from bstm_daemon.analysis.quality.collisions import note_collisions
from bstm_daemon.analysis.quality.finding import Notes, Quality, RoleQuality
from bstm_daemon.analysis.quality.frozen import find_frozen, find_frozen_speeds
from bstm_daemon.analysis.quality.limits import MISSING_FAILS, MISSING_SHARE
from bstm_daemon.analysis.quality.modes import mode_verdicts
from bstm_daemon.analysis.quality.pressures import (
    check_resting,
    compare_pressures,
)
from bstm_daemon.analysis.quality.speeds import compare_speeds, note_unjudged
from bstm_daemon.analysis.quality.statistics import (
    bus_pauses,
    channel_statistics,
)
from bstm_daemon.analysis.quality.temperatures import check_temperatures
from bstm_daemon.bus.opening import id_text
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.analysis.quality.recording import Recording
    from bstm_daemon.bus.signals.extraction import FrameKey, MessagePlan
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config


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
    notes = Notes()
    roles = _roles(recording, config, signal_map, notes)
    channels = Channels(recording, config, signal_map.timeouts_us)
    # absurd values overflow: the fits are then unusable
    with np.errstate(over="ignore", invalid="ignore"):
        _compare(channels, notes)
    note_collisions(recording, config, own_frames or {}, notes)
    findings = tuple(dict.fromkeys(notes.findings))
    return Quality(
        recording.duration_s,
        roles,
        tuple(notes.comparisons),
        findings,
        tuple(dict.fromkeys(notes.not_judged)),
        mode_verdicts(config, roles, findings),
        config.heat.mode,
        recording.refused,
    )


def _compare(channels: Channels, notes: Notes) -> None:
    """Run the checks; each leaves out what those before found wrong."""
    find_frozen_speeds(channels, notes)
    compare_speeds(channels, notes)
    note_unjudged(channels, notes)
    if not channels.on_stand:
        find_frozen(channels, notes, (LONGITUDINAL,), channels.speed_rate())
    compare_accelerations(channels, notes)
    compare_sides(channels, notes)
    compare_axles(channels, notes)
    for role in channels.alive(PRESSURES):
        others = [o for o in channels.alive(PRESSURES) if o != role]
        if others:
            find_frozen(channels, notes, (role,), channels.value(others[0]))
    check_resting(channels, notes)
    says = compare_braking(channels, notes)
    compare_pressures(channels, notes, says)
    compare_switch(channels, notes)
    check_temperatures(channels, notes)


def _roles(
    recording: Recording,
    config: Config,
    signal_map: SignalMap,
    notes: Notes,
) -> tuple[RoleQuality, ...]:
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
        timeout_s = signal_map.timeouts_us[number] * 1e-6
        source = signal.column or (
            f"{signal.message}.{signal.signal or signal.expression}"
        )
        series = recording.series.get(role)
        if series is not None:
            statistics = channel_statistics(
                series, recording.duration_s, timeout_s, pauses
            )
            if statistics.missing_share > MISSING_SHARE:
                notes.fault(
                    "dropouts",
                    role,
                    f"absent {100 * statistics.missing_share:.0f} % of the "
                    f"time, {statistics.gaps_over_timeout} gaps over "
                    f"{timeout_s:g} s, the longest "
                    f"{statistics.longest_gap_s:.1f} s",
                    wrong=statistics.missing_share > MISSING_FAILS,
                )
            found.append(
                RoleQuality(role, source, signal.unit, timeout_s, statistics)
            )
            continue
        why = "no row with a value"
        if number in keys:
            why = _why_missing(*keys[number], recording, signal_map)
        notes.fault("missing", role, why, wrong=False)
        found.append(
            RoleQuality(role, source, signal.unit, timeout_s, None, why)
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
