"""``bstm heat`` computes what it shows, and says how far it is."""

from __future__ import annotations

from collections import Counter
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.progress import Progress
from bstm_daemon.estimator import estimator
from bstm_daemon.forecast import monitor
from bstm_daemon.replay import columns

if TYPE_CHECKING:
    from collections.abc import Callable

GOLDEN = Path(__file__).parents[1] / "golden"
DRIVE = str(GOLDEN / "logs" / "stops.log.gz")
CAR = ["-c", str(GOLDEN / "stops.toml")]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count forecasts, pieces of advice and judgements."""
    found: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any, **named: Any) -> Any:
            found[name] += 1
            return function(*args, **named)

        return call

    for place, name in (
        (monitor.RiskMonitor, "add"),
        (columns.AdviceSeries, "add"),
        (estimator, "judge"),
    ):
        kind = f"{place.__name__}.{name}"
        changed = counted(kind, getattr(place, name))
        monkeypatch.setattr(place, name, changed)
    return found


def test_heat_computes_no_forecast_and_no_validity(
    calls: Counter[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its two replays, in the mode of the car and fused, show neither."""
    assert main(["heat", DRIVE, *CAR]) == 0

    assert not calls
    shown = capsys.readouterr().out
    assert "Feed-Back" in shown
    assert "fused" in shown


@pytest.mark.parametrize(
    ("options", "forecast"),
    [
        ([], False),
        (["--report", "page.html"], True),
        (["-o", ".", "--format", "csv"], True),
        (["-o", ".", "--format", "csv", "--no-forecast"], False),
    ],
)
def test_a_replay_forecasts_where_it_shows_it(
    options: list[str],
    *,
    forecast: bool,
    calls: Counter[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The summary has the validity and no forecast; table and page have."""
    monkeypatch.chdir(tmp_path)

    assert main(["replay", DRIVE, *CAR, *options]) == 0

    blocks = calls["bstm_daemon.estimator.estimator.judge"]
    assert blocks > 0
    made = [calls["RiskMonitor.add"], calls["AdviceSeries.add"]]
    assert made == [blocks * forecast] * 2


def test_heat_shows_its_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first chunk to the end of the last replay, never back."""
    shares: list[float] = []
    monkeypatch.setattr(
        Progress, "show", lambda _, share: shares.append(share)
    )

    assert main(["heat", DRIVE, *CAR]) == 0

    assert shares == sorted(shares)
    assert len(shares) >= 3
    assert shares[0] <= 0.1
    assert 0.5 < shares[-2] < shares[-1] == pytest.approx(1.0)
