"""Which schedulers and workers are refused."""

from __future__ import annotations

import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.fleet.cluster import check_address, check_workers
from bstm_daemon.fleet.lake import program


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
