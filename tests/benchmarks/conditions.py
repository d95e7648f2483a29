"""When, of which sources and on what kind of machine figures were taken."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("bstm_daemon", "config", "dbc", "tests/benchmarks")
"""What the figures depend on; a change of these not committed shows as +."""


def conditions() -> dict[str, str]:
    """Return date, commit and machine in general words."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "commit": _commit(),
        "machine": f"{os.cpu_count()} cores, {_processor()}, "
        f"{platform.system()}, Python {platform.python_version()}, "
        f"NumPy {version('numpy')}",
    }


def _commit() -> str:
    commit = _git("rev-parse", "--short", "HEAD").strip()
    changed = _git("status", "--porcelain", "--", *SOURCES).strip()
    return f"{commit}+" if changed else commit


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(ROOT), *arguments],
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def _processor() -> str:
    """Return the family of the processor, without its exact model."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return platform.machine()
    found = re.search(r"^model name\s*:\s*(.*)$", text, re.MULTILINE)
    if found is None:
        return platform.machine()
    name = re.sub(r"\((R|TM)\)|\bCPU\b|\bProcessor\b|@.*", "", found[1])
    return f"{' '.join(name.split()[:2])} ({platform.machine()})"
