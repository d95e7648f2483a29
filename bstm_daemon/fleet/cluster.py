"""Connects to the workers: a cluster here, or a scheduler elsewhere."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from hashlib import blake2b
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar
from urllib.parse import urlsplit

from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.fleet.lake import program

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

WAIT_S: Final = 30.0
"""How long scheduler and first worker are waited for."""

ITEMS_A_THREAD: Final = 3
"""Cars under way for each thread of the workers: none waits for a task."""

FOREIGN: Final = 3
LOST: Final = 4
"""Of a task: its worker runs another program, or each worker was lost."""


class Item(Protocol):
    """What has one job after the other, such as a car."""

    @property
    def job(self) -> object:
        """The job that is next, or under way."""


ItemT = TypeVar("ItemT", bound=Item)


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
    from distributed import (  # noqa: PLC0415  (an extra)
        Client,
        LocalCluster,
        Security,
    )

    if address is None:
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


def run_tasks(
    client: Any,
    function: Callable[[Any], int],
    items: Iterable[ItemT],
    finish: Callable[[ItemT, int], bool],
) -> None:
    """Run *function* on the job of each of *items*, some at a time.

    Args:
        client: a ``distributed.Client``.
        function: makes of a job a number.
        items: each with its ``job``.
        finish: called with the item and the number, or :data:`LOST`;
            returns whether the item has a further job.

    Raises:
        UsageError: a worker runs another program than the client.
        BstmError: the scheduler is gone.
    """
    from distributed import as_completed  # noqa: PLC0415  (an extra)

    under_way: dict[str, ItemT] = {}
    completed = as_completed(loop=client.loop)
    most = ITEMS_A_THREAD * max(sum(client.nthreads().values()), 1)

    def submit(item: ItemT) -> None:
        key = _name(function.__name__, item.job)
        future = client.submit(function, item.job, key=key, pure=False)
        under_way[key] = item
        completed.add(future)

    def take() -> None:
        future = next(completed)
        item = under_way.pop(future.key)
        code = _result(future)
        future.release()
        if finish(item, code):
            submit(item)

    for item in items:
        submit(item)
        while len(under_way) >= most:
            take()
    while under_way:
        take()


def _result(future: Any) -> int:
    from distributed import KilledWorker  # noqa: PLC0415  (an extra)

    try:
        code: int = future.result()
    except KilledWorker:
        return LOST
    except Exception as error:
        msg = (
            f"the scheduler is gone, or refuses the work: {error!r}; what "
            "is finished stays: start it again"
        )
        raise BstmError(msg) from error
    if code == FOREIGN:
        msg = "a worker has come that runs another program than this one"
        raise UsageError(msg)
    return code


def _name(what: str, job: object) -> str:
    """Return the name of the task of *job*, another one for another job."""
    return f"{what}-{blake2b(repr(job).encode(), digest_size=12).hexdigest()}"


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
