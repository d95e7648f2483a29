"""Frames in a log with ids that the daemon would send.

A log may hold the frames of a daemon that was running beside the recorder.
Those carry its end-to-end protection, a foreign frame does not.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from bstm_daemon.analysis.quality.finding import Checks, Fault
from bstm_daemon.analysis.quality.recording import Recording
from bstm_daemon.bus.opening import id_text, open_log, resolve_interfaces
from bstm_daemon.bus.output.e2e import profile2_crc
from bstm_daemon.bus.output.layout import BLOCK_IDS, FRAME_BYTES, data_id_list
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config


def count_own_frames(
    paths: Sequence[Path],
    recording: Recording,
    config: Config,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
) -> dict[int, int]:
    """Return by id how many frames carry the daemon's own protection.

    Only frames in the block of ``[publish] id_base`` on the publishing bus
    count. The logs *paths*, which *recording* was read from, are read once
    more, and only where it has seen such ids; *overrides* is log interface
    to bus name. Raises :class:`~bstm_daemon.errors.LogError` and
    :class:`~bstm_daemon.errors.FileAccessError`.
    """
    taken = frozenset((can_id, False) for can_id in _taken(recording, config))
    if not taken:
        return {}
    bus, base = config.publishing_bus, config.publish.id_base

    def wanted(interface: str) -> Collection[tuple[int, bool]] | None:
        (number,) = resolve_interfaces(
            [interface], signal_map.buses, overrides or {}
        )
        return taken if number == bus else None

    found: Counter[int] = Counter()
    for path in paths:
        for chunk in open_log(path, wanted).chunks():
            for can_id, length, data in zip(
                chunk.can_id.tolist(),
                chunk.length.tolist(),
                chunk.data,
                strict=True,
            ):
                payload = data[:length].tobytes()
                found[can_id] += _is_own(payload, can_id - base)
    return dict(found)


def note_collisions(channels: Checks, own_frames: Mapping[int, int]) -> None:
    """Name the frames with an id that ``[publish] id_base`` would send.

    Where all frames of an id are among *own_frames*, by id, they are the
    daemon's own.
    """
    config = channels.config
    frames = _taken(channels.recording, config)
    if not frames:
        return
    own = {key: n for key, n in frames.items() if own_frames.get(key) == n}
    foreign = {key: frames[key] for key in frames if key not in own}
    bus = config.bus[config.publishing_bus].name
    block = f"[publish] id_base = 0x{config.publish.id_base:X}"
    words: dict[Fault, str] = {
        "id-collision": f"which {block} would send: choose another id_base",
        "own-frames": f"of the block of {block}: these are frames of this "
        "daemon, their protection is ours",
    }
    for (fault, what), held in zip(words.items(), (foreign, own), strict=True):
        if held:
            text = f"the log holds {_listed(held)} on {bus}, {what}"
            channels.fault(fault, (), text, wrong=False)


def _taken(recording: Recording, config: Config) -> dict[int, int]:
    """Return frames by id, of the block on the publishing bus."""
    bus, base = config.publishing_bus, config.publish.id_base
    return {
        can_id: count
        for can_id in range(base, base + BLOCK_IDS)
        if (count := recording.seen.get((bus, can_id, False)))
    }


def _is_own(data: bytes, id_offset: int) -> bool:
    if len(data) != FRAME_BYTES:
        return False
    data_id = data_id_list(id_offset)[data[1] & 0x0F]
    return data[0] == profile2_crc(data, data_id)


def _listed(frames: Mapping[int, int]) -> str:
    return ", ".join(
        f"{count} frame{'s' * (count != 1)} with id "
        f"0x{id_text(can_id, extended=False)}"
        for can_id, count in frames.items()
    )
