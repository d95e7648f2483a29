"""Connects to the workers: a cluster here, or a scheduler elsewhere."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.fleet.lake import program

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

WAIT_S: Final = 30.0
"""How long scheduler and first worker are waited for."""


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
