"""``bstm check --log``: how far the signals of a recording can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle

if TYPE_CHECKING:
    import argparse
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Checked:
    """The judgement of the logs: as text, as plain data, and in short."""

    text: str
    data: dict[str, Any]
    usable: bool


def check_logs(args: argparse.Namespace, path: Path) -> Checked:
    """Judge ``args.log`` for the configuration *path*.

    Writes ``args.report`` where it is given.

    Raises:
        LogError: a log cannot be used, or holds none of the wanted ids.
        FileAccessError: a log cannot be read, the report not be written.
        MissingExtraError: a report without plotly or jinja2.
    """
    from bstm_daemon.analysis.quality.collisions import (  # noqa: PLC0415
        count_own_frames,
    )
    from bstm_daemon.analysis.quality.judge import judge  # noqa: PLC0415
    from bstm_daemon.analysis.quality.recording import read_recording  # noqa: PLC0415
    from bstm_daemon.report.check import (  # noqa: PLC0415
        quality_json,
        quality_page,
    )
    from bstm_daemon.report.quality_screen import (  # noqa: PLC0415
        quality_table,
    )
    from bstm_daemon.report.shell import write_page  # noqa: PLC0415

    config, signal_map = load_vehicle(path, quiet=True)
    with Progress("check") as progress:
        recording = read_recording(
            args.log, signal_map, dict(args.map), progress.show_lines
        )
    own_frames = count_own_frames(
        args.log, recording, config, signal_map, dict(args.map)
    )
    quality = judge(recording, config, signal_map, own_frames)
    names = ", ".join(log.name for log in args.log)
    if args.report:
        page = quality_page(
            quality,
            title=f"Signal quality: {names}",
            subtitle=f"{config.vehicle.id} · {path.name}",
        )
        write_page(args.report, page)
    lines = [f"{names}  ({config.vehicle.id}, {path})", quality_table(quality)]
    lines += [
        f"{log}: cut short, its end is missing" for log in recording.truncated
    ]
    if args.report:
        lines.append(str(args.report))
    data = {"files": [str(log) for log in args.log], **quality_json(quality)}
    return Checked("\n".join(lines), data, quality.usable)
