"""Runs over a plan on a scheduler in this process."""

from __future__ import annotations

from contextlib import closing
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from distributed import Client

from bstm_daemon.errors import BstmError, UsageError
from bstm_daemon.fleet import run as run_module
from bstm_daemon.fleet.lake import Options, program
from bstm_daemon.fleet.plan import Plan
from bstm_daemon.fleet.run import Outcome, Run, check_address, check_workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@pytest.mark.parametrize(
    "address",
    [
        "tls://10.0.0.1:8786",
        "tls://scheduler:8786",
        "tcp://127.0.0.1:8786",
        "tcp://127.8.0.1:8786",
        "tcp://localhost:8786",
        "tcp://[::1]:8786",
    ],
)
def test_tls_or_this_machine_may_schedule(address: str) -> None:
    check_address(address)


@pytest.mark.parametrize(
    "address",
    [
        "tcp://10.0.0.1:8786",
        "tcp://localhost.example.com:8786",
        "tcp://127.0.0.1.example.com:8786",
        "tcp://[::]:8786",
        "tcp://0.0.0.0:8786",
        "10.0.0.1:8786",
        "ws://127.0.0.1:8786",
        "ucx://127.0.0.1:8786",
        "tls://",
        "",
    ],
)
def test_any_other_scheduler_is_refused(address: str) -> None:
    with pytest.raises(UsageError, match="only tls://"):
        check_address(address)


def test_workers_run_the_program_of_the_client() -> None:
    own = program()
    check_workers({"tls://a:1": own, "tls://b:1": dict(own)})

    for name in ("bstm", "code", "kernel", "numpy"):
        other = own | {name: "other"}
        with pytest.raises(UsageError, match=f"tls://b:1 has {name} other"):
            check_workers({"tls://a:1": own, "tls://b:1": other})


OPTIONS = Options(100_000, forecast=False)


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    # one thread, as the workers of a fleet have
    with Client(
        processes=False,
        n_workers=1,
        threads_per_worker=1,
        dashboard_address="127.0.0.1:0",
        set_as_default=False,
    ) as found:
        yield found


def execute(
    fleet: Any, client: Any, options: Options = OPTIONS, *, hold: bool = False
) -> Outcome:
    with closing(Plan(fleet.lake)) as plan:
        replayed = Run(fleet.lake, plan, options, hold=hold)
        return replayed.execute(client, replayed.chains(), lambda: None)


def look(fleet: Any) -> Outcome:
    with closing(Plan(fleet.lake)) as plan:
        return Run(fleet.lake, plan, None).look()


def counts(outcome: Outcome) -> tuple[int, int, int, int]:
    failed = len(outcome.failures)
    return outcome.made, outcome.current, failed, outcome.waiting


def written(fleet: Any) -> dict[str, int]:
    """Return when each receipt was written."""
    root = fleet.lake.root / "receipts"
    return {
        f"{path.parent.name}/{path.stem}": path.stat().st_mtime_ns
        for path in root.rglob("*.json")
    }


@pytest.mark.slow
def test_a_run_equals_its_drives_one_by_one(
    make_fleet: Callable[..., Any], client: Any, tmp_path: Any
) -> None:
    fleet = make_fleet(3, [0, 1])
    fleet.plan()
    assert counts(look(fleet)) == (0, 0, 0, 6)

    assert counts(execute(fleet, client)) == (6, 0, 0, 0)
    by_run = fleet.files()
    fleet.lake.root.rename(tmp_path / "kept")
    fleet.plan()
    for car in ("car2", "car0", "car1"):
        fleet.replay(car)

    assert fleet.files() == by_run
    assert len(by_run) == 6 * 4
    assert counts(execute(fleet, client)) == (0, 6, 0, 0)
    assert counts(look(fleet)) == (0, 6, 0, 0)


@pytest.mark.slow
def test_a_late_log_makes_anew_what_follows_it(
    make_fleet: Callable[..., Any], client: Any
) -> None:
    fleet = make_fleet(2, [0, 1, 3, 4])
    fleet.plan()
    execute(fleet, client)
    before = written(fleet)
    make_fleet(1, [2])
    fleet.plan()
    assert counts(look(fleet)) == (0, 6, 0, 3)

    assert counts(execute(fleet, client)) == (3, 6, 0, 0)

    after = written(fleet)
    changed = {name for name, one in after.items() if before.get(name) != one}
    assert changed == {"car0/drive2", "car0/drive3", "car0/drive4"}


def test_a_corrupt_log_costs_only_itself(
    make_fleet: Callable[..., Any], client: Any
) -> None:
    fleet = make_fleet(2, [0, 1, 2])
    fleet.log("car1", 1).write_bytes(b"no log\n")
    fleet.plan()

    outcome = execute(fleet, client)

    assert counts(outcome) == (5, 0, 1, 0)
    assert outcome.failures[0].startswith("car1 drive1: ")
    assert "drive1.log" in outcome.failures[0]
    # it is listed again, and not tried
    assert counts(execute(fleet, client)) == (0, 5, 1, 0)
    assert look(fleet).failures == outcome.failures


@pytest.mark.slow
def test_on_error_hold_keeps_what_follows_waiting(
    make_fleet: Callable[..., Any], client: Any
) -> None:
    fleet = make_fleet(2, [0, 1, 2, 3])
    fleet.log("car1", 1).write_bytes(b"no log\n")
    fleet.plan()

    assert counts(execute(fleet, client, hold=True)) == (5, 0, 1, 2)
    assert counts(execute(fleet, client, hold=True)) == (0, 5, 1, 2)
    assert counts(execute(fleet, client)) == (2, 5, 1, 0)


@pytest.mark.slow
def test_other_options_or_another_configuration_make_all_anew(
    make_fleet: Callable[..., Any], client: Any
) -> None:
    fleet = make_fleet(1, [0, 1])
    fleet.plan()
    execute(fleet, client)

    every_second = Options(1_000_000, forecast=False)
    assert counts(execute(fleet, client, every_second)) == (2, 0, 0, 0)
    for name in ("car.toml", "car.dbc"):
        path = fleet.folder / name
        path.write_text(path.read_text("utf-8") + "\n", "utf-8")
        assert counts(execute(fleet, client, every_second)) == (2, 0, 0, 0)
    assert counts(execute(fleet, client, every_second)) == (0, 2, 0, 0)


def test_a_configuration_that_is_gone_costs_its_cars(
    make_fleet: Callable[..., Any], client: Any
) -> None:
    fleet = make_fleet(2, [0, 1])
    (fleet.folder / "fleet.toml").write_text(
        '[[vehicle]]\nid = "car0"\nlogs = "car0/*.log"\nconfig = "own.toml"\n'
        '[[vehicle]]\nid = "car1"\nlogs = "car1/*.log"\nconfig = "car.toml"\n'
    )
    own = fleet.folder / "own.toml"
    own.write_bytes((fleet.folder / "car.toml").read_bytes())
    fleet.plan()
    own.unlink()

    outcome = execute(fleet, client)

    assert counts(outcome) == (2, 0, 1, 1)
    assert "own.toml" in outcome.failures[0]


@pytest.mark.slow
def test_some_cars_are_under_way_and_no_more(
    make_fleet: Callable[..., Any],
) -> None:
    """The others are not even looked at: memory does not grow with a plan."""
    fleet = make_fleet(12, [0, 1])
    fleet.plan()
    most = 0

    class Future:
        def __init__(self, key: str) -> None:
            self.key = key

        def result(self) -> int:
            return run_module.replay_drive(jobs.pop(self.key))

        def release(self) -> None:
            pass

    jobs: dict[str, Any] = {}

    class Cluster:
        loop = None

        def nthreads(self) -> dict[str, int]:
            return {"tcp://a": 1}

        def submit(self, task: Any, job: Any, key: str, *, pure: bool) -> Any:
            nonlocal most
            assert not pure
            jobs[key] = job
            most = max(most, len(jobs))
            return Future(key)

    waiting: list[Future] = []

    class Completed:
        def __init__(self, loop: Any) -> None:
            pass

        def add(self, future: Future) -> None:
            waiting.append(future)

        def __next__(self) -> Future:
            return waiting.pop(0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("distributed.as_completed", Completed)
        outcome = execute(fleet, Cluster())

    assert counts(outcome) == (24, 0, 0, 0)
    assert most == run_module.CHAINS_A_THREAD


def test_a_worker_of_another_program_ends_the_run(
    make_fleet: Callable[..., Any],
    client: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()
    monkeypatch.setattr(run_module, "program", lambda: {"bstm": "9"})

    with pytest.raises(UsageError, match="another program"):
        execute(fleet, client)

    assert fleet.files() == {}


def test_a_drive_that_takes_its_workers_down_costs_itself(
    make_fleet: Callable[..., Any],
    client: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from distributed import KilledWorker  # noqa: PLC0415

    fleet = make_fleet(1, [0, 1])
    fleet.plan()
    replay = run_module.replay_drive

    def deadly(job: Any) -> int:
        if job.drive.name == "drive0":
            raise KilledWorker(job.drive.name, SimpleNamespace(address="a"), 3)
        return replay(job)

    monkeypatch.setattr(run_module, "replay_drive", deadly)

    outcome = execute(fleet, client)

    assert counts(outcome) == (1, 0, 1, 0)
    assert run_module.LOST in outcome.failures[0]
    monkeypatch.undo()
    # tried again, and then what follows it
    assert counts(execute(fleet, client)) == (2, 0, 0, 0)


def test_without_the_scheduler_the_run_ends(
    make_fleet: Callable[..., Any],
    client: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()

    def lost(job: Any) -> int:
        raise ConnectionError(job.drive.name)

    monkeypatch.setattr(run_module, "replay_drive", lost)

    with pytest.raises(BstmError, match="start it again"):
        execute(fleet, client)
