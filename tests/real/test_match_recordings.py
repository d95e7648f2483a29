"""From ``bstm init`` to a matched car on the Formula 1 sessions.

Nothing is edited in between: nothing of this car is known but its log. What
is left out of a fit is a whole session, or the second half of one.
docs/real-data.md has the figures.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

import pytest

from bstm_daemon.analysis.matching.baseline import baselines
from bstm_daemon.analysis.matching.drives import read_drive
from bstm_daemon.analysis.matching.refine import errors_of, rms_of
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle

DATA = os.environ.get("BSTM_REAL_DATA")
F1 = Path(DATA or ".", "f1-five-channel")
SPAIN, HUNGARY = "Spain.converted.csv", "Hungary.converted.csv"

MOST_HELD_K: Final = {(SPAIN, HUNGARY): 42.0, (HUNGARY, SPAIN): 31.0}
"""On the other session: what a disc of one node was known to reach."""

pytestmark = [
    pytest.mark.real,
    pytest.mark.slow,
    pytest.mark.skipif(
        DATA is None or not F1.exists(),
        reason="BSTM_REAL_DATA does not name the folder of the recordings",
    ),
]


def halves(session: str, folder: Path) -> tuple[Path, Path]:
    """Write both halves of a session as tables of their own."""
    head, *rows = (F1 / session).read_text("utf-8").splitlines()
    middle = len(rows) // 2
    parts = folder / "first.csv", folder / "second.csv"
    for path, part in zip(parts, (rows[:middle], rows[middle:]), strict=True):
        path.write_text("\n".join([head, *part]) + "\n", "utf-8")
    return parts


@pytest.mark.full
@pytest.mark.parametrize(
    ("fitted", "other"),
    [(SPAIN, HUNGARY), (HUNGARY, SPAIN), (SPAIN, ""), (HUNGARY, "")],
)
def test_no_worse_than_a_disc_of_one_node(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    fitted: str,
    other: str,
) -> None:
    """No disc is worse, in the fit or on what was left out.

    Nothing is named on either.
    """
    seen, unseen = F1 / fitted, F1 / other
    if not other:
        seen, unseen = halves(fitted, tmp_path)
    car, matched = tmp_path / "car.toml", tmp_path / "matched.toml"
    assert main(["init", "--log", f"{seen}", "-o", f"{car}"]) == 0

    code = main(["match", f"{seen}", "-c", f"{car}", "-o", f"{matched}"])

    # of a third of half a session one node may know as much
    assert code == 0 or not other

    for log in (seen, unseen):
        capsys.readouterr()
        assert main(["gap", "run", f"{log}", "-c", f"{matched}"]) == 0
        assert "no missing effect visible" in capsys.readouterr().out

    cold = ["--start", "cold", "--no-forecast"]
    assert main(["replay", f"{unseen}", "-c", f"{matched}", *cold]) == 0
    told = capsys.readouterr().out
    assert "unverified: nothing checks the fluid" in told
    assert re.search("(?m)^FL FR.*: 100 % degraded$", told)

    config, signal_map = load_vehicle(matched)
    drives = [read_drive(log, config, signal_map) for log in (seen, unseen)]
    simple = baselines(drives[:1])
    for corner in ("FL", "FR"):
        target = Target(config, (corner,))
        fit_k, held_k = (
            rms_of(errors_of(target, drive))["disc"] for drive in drives
        )
        of_one_node = simple[corner][0]
        one_node_k = of_one_node.rms_on(drives[1:])
        print(  # noqa: T201  (the figures of docs/real-data.md)
            f"{fitted} {other} {corner}: fit {fit_k:.1f} K, left out "
            f"{held_k:.1f} K; one node {of_one_node.rms_k:.1f}, "
            f"{one_node_k:.1f} K"
        )
        assert fit_k < of_one_node.rms_k
        assert held_k < one_node_k
        if other:
            assert held_k < MOST_HELD_K[fitted, other]
