"""Replays the chains of a plan on Dask distributed, here or elsewhere.

A car's drives are submitted one behind the other, some cars at a time, so
that client and scheduler hold the drives under way and no others.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.fleet.drive import (
    FAILED,
    FOREIGN,
    Job,
    fail_drive,
    replay_drive,
)
from bstm_daemon.fleet.lake import (
    Drive,
    Lake,
    Options,
    Receipt,
    hash_of_config,
    program,
)
from bstm_daemon.fleet.plan import Plan

WAIT_S: Final = 30.0
"""How long scheduler and first worker are waited for."""

FORKED: Final = "forkserver"
PRELOADED: Final = (
    *("distributed", "pyarrow.parquet", "bstm_daemon.fleet.drive"),
)
"""Workers here are forked from one process that has imported what they need:
imports are a third of a short run."""


@contextmanager
def connect(
    address: str | None,
    jobs: int | None,
    tls: tuple[Path | None, Path | None, Path | None],
) -> Iterator[Any]:
    """Give a ``distributed.Client``.

    Args:
        address: of a scheduler, ``tls://HOST:PORT`` or ``tcp://`` on this
            machine; None starts workers here.
        jobs: processes here, None for one a core.
        tls: certificate of the authority, own certificate and key; without
            them those of Dask's configuration.

    Raises:
        UsageError: the address is refused, or workers run another program.
        BstmError: no scheduler or no worker answers.
    """
    from dask import config  # noqa: PLC0415  (an extra)
    from distributed import Client, LocalCluster, Security  # noqa: PLC0415
    from distributed.utils import get_mp_context  # noqa: PLC0415

    if address is None:
        with config.set({"distributed.worker.multiprocessing-method": FORKED}):
            # after Dask, which has a list of its own
            get_mp_context().set_forkserver_preload(PRELOADED)
            with (
                LocalCluster(
                    n_workers=jobs,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                ) as cluster,
                Client(cluster, set_as_default=False) as client,
            ):
                yield client
        return
    check_address(address)
    names = "tls_ca_file", "tls_client_cert", "tls_client_key"
    files = {n: str(file) for n, file in zip(names, tls, strict=True) if file}
    is_tls = address.startswith("tls://")
    try:
        client = Client(
            address,
            security=Security(require_encryption=is_tls, **files),
            timeout=WAIT_S,
            set_as_default=False,
        )
    except (OSError, TypeError, ValueError) as error:
        msg = f"--scheduler {address}: no answer: {error}"
        raise BstmError(msg) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WAIT_S)
        except TimeoutError as error:
            msg = f"--scheduler {address}: it has no worker"
            raise BstmError(msg) from error
        check_workers(client.run(program))
        yield client


def require_fleet() -> None:
    """Refuse a replay before any work.

    Raises:
        MissingExtraError: the extra ``fleet`` or ``parquet`` is missing.
    """
    purpose = "bstm fleet replay"
    require_packages("distributed", extra="fleet", purpose=purpose)
    require_packages("pyarrow", extra="parquet", purpose=purpose)


def check_address(address: str) -> None:
    """Refuse a scheduler that anyone on the network may give orders.

    Raises:
        UsageError: it does.
    """
    parts = urlsplit(address)
    host = parts.hostname or ""
    if parts.scheme == "tls" and host:
        return
    if parts.scheme == "tcp" and _is_loopback(host):
        return
    msg = (
        f"--scheduler {address}: only tls://HOST:PORT, or tcp:// on this "
        "machine: a plain scheduler runs the code of anyone who reaches it"
    )
    raise UsageError(msg)


def check_workers(programs: dict[str, dict[str, str]]) -> None:
    """Refuse workers whose numbers may be others; *programs* by address.

    Raises:
        UsageError: one runs another program than this one.
    """
    own = program()
    wrong = [
        f"{worker} has {name} {theirs.get(name)}, here {ours}"
        for worker, theirs in sorted(programs.items())
        for name, ours in own.items()
        if theirs.get(name) != ours
    ]
    if wrong:
        msg = f"workers run another program: {'; '.join(wrong)}"
        raise UsageError(msg)


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        # another name may lead anywhere
        return host == "localhost"


CHAINS_A_THREAD: Final = 3
"""Cars under way for each thread of the workers: none waits for a task."""

LOST: Final = "each worker that replayed it was lost"


@dataclass
class Outcome:
    """What became of the drives of a plan.

    ``made`` in this run, ``current`` before it; ``waiting`` were not tried.
    ``failures`` has a line for each log that could not be replayed, also
    where a former run had found that.
    """

    made: int = 0
    current: int = 0
    waiting: int = 0
    failures: list[str] = field(default_factory=list)

    @property
    def seen(self) -> int:
        """All drives that were looked at."""
        lost = len(self.failures)
        return self.made + self.current + self.waiting + lost


@dataclass
class Chain:
    """What is left of the drives of a car, and where it stands.

    ``job`` is the next drive; ``before`` the one in front of it and ``key``
    the key of that one.
    """

    drives: Iterator[Drive]
    before: Drive | None = None
    key: str = ""
    job: Job | None = None


class Run:
    """One run over a plan."""

    def __init__(
        self,
        lake: Lake,
        plan: Plan,
        options: Options | None,
        *,
        hold: bool = False,
    ) -> None:
        """Prepare a run.

        Args:
            lake: the results.
            plan: of the lake.
            options: of the replay; None takes what is there as it is.
            hold: whether the drives behind one that fails wait.
        """
        self._lake, self._plan, self._options = lake, plan, options
        self._hold = hold
        self._config_hash = lru_cache(maxsize=4096)(hash_of_config)
        self.outcome = Outcome()

    def chains(self) -> Iterator[Chain]:
        """Give each car's chain at the first drive that is to be made."""
        for vehicle in self._plan.vehicles():
            chain = Chain(self._plan.chain(vehicle))
            if self._advance(chain):
                yield chain

    def look(self) -> Outcome:
        """Return the state of the lake, without any replay."""
        for chain in self.chains():
            self.outcome.waiting += 1 + sum(1 for _ in chain.drives)
        return self.outcome

    def execute(
        self,
        client: Any,
        chains: Iterator[Chain],
        progress: Callable[[], None],
    ) -> Outcome:
        """Replay what is to be made on the workers of *client*.

        Args:
            client: a ``distributed.Client``.
            chains: of :meth:`chains`.
            progress: called after every drive.

        Raises:
            UsageError: a worker runs another program than the client.
            BstmError: the scheduler is gone.
        """
        from distributed import as_completed  # noqa: PLC0415  (an extra)

        under_way: dict[str, Chain] = {}
        completed = as_completed(loop=client.loop)
        most = CHAINS_A_THREAD * max(sum(client.nthreads().values()), 1)

        def submit(chain: Chain) -> None:
            future = client.submit(
                replay_drive, chain.job, key=_name(chain.job), pure=False
            )
            under_way[future.key] = chain
            completed.add(future)

        for chain in chains:
            submit(chain)
            while len(under_way) >= most:
                self._take(next(completed), under_way, submit, progress)
        while under_way:
            self._take(next(completed), under_way, submit, progress)
        return self.outcome

    def _take(
        self,
        future: Any,
        under_way: dict[str, Chain],
        submit: Callable[[Chain], None],
        progress: Callable[[], None],
    ) -> None:
        """Take the drive that is finished, and go on in its chain."""
        chain = under_way.pop(future.key)
        self._finish(chain, future)
        future.release()
        progress()
        if self._advance(chain):
            submit(chain)

    def _finish(self, chain: Chain, future: Any) -> None:
        from distributed import KilledWorker  # noqa: PLC0415  (an extra)

        job = chain.job
        assert job is not None  # noqa: S101  (it was submitted)
        try:
            code = future.result()
        except KilledWorker:
            fail_drive(job, LOST)
            code = FAILED
        except Exception as error:
            msg = (
                f"the scheduler is gone, or refuses the work: {error!r}; what "
                "is finished stays: start it again"
            )
            raise BstmError(msg) from error
        if code == FOREIGN:
            msg = "a worker has come that runs another program than this one"
            raise UsageError(msg)
        receipt = self._lake.receipt(job.drive)
        self.outcome.made += receipt is not None and receipt.message is None
        self._pass(chain, job.drive, receipt)

    def _advance(self, chain: Chain) -> bool:
        """Move on to the first drive that is to be made, if there is one."""
        for drive in chain.drives:
            try:
                config_hash = self._config_hash(Path(drive.config))
            except BstmError as error:
                self.outcome.failures.append(f"{drive.vehicle}: {error}")
                self.outcome.waiting += sum(1 for _ in chain.drives)
                return False
            receipt = self._lake.current(
                drive, chain.key, config_hash, self._options
            )
            if receipt is None:
                if self._options is not None:
                    chain.job = Job(
                        str(self._lake.root.resolve()),
                        drive,
                        chain.before,
                        chain.key,
                        self._options,
                        config_hash,
                        program(),
                    )
                return True
            self.outcome.current += receipt.message is None
            self._pass(chain, drive, receipt)
        return False

    def _pass(
        self, chain: Chain, drive: Drive, receipt: Receipt | None
    ) -> None:
        """Take *drive*, whose receipt is *receipt*, as the one before."""
        if receipt is None or receipt.message is not None:
            message = receipt.message if receipt else "its receipt is gone"
            line = f"{drive.vehicle} {drive.name}: {message}"
            self.outcome.failures.append(line)
            if self._hold:
                self.outcome.waiting += sum(1 for _ in chain.drives)
        chain.before = drive
        chain.key = receipt.key if receipt else ""


def _name(job: Job | None) -> str:
    """Return the name of the task of *job*, another one for another job."""
    return f"replay-{blake2b(repr(job).encode(), digest_size=12).hexdigest()}"
