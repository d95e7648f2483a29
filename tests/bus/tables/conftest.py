"""Plans of tables and the samples that they give."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import structlog

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.tables.table_plan import TableMap, compile_sources
from bstm_daemon.config.sections import SignalConfig, TableConfig
from bstm_daemon.roles import ROLES

Samples = list[tuple[float, str, float]]


@pytest.fixture(autouse=True)
def every_level() -> None:
    """Log all, whatever level a command before set."""
    structlog.reset_defaults()


@pytest.fixture
def samples_of() -> Callable[..., Samples]:
    """Return a reader: time [s], role and value of each sample."""

    def read(
        path: Path, roles: dict[str, dict[str, Any]], **table: Any
    ) -> Samples:
        made = compile_sources(
            [],
            {role: SignalConfig(**one) for role, one in roles.items()},
            TableConfig(**({"time": "time"} | table)),
            Path(),
            0.3,
        )
        assert isinstance(made, TableMap)
        return [
            (time_us * 1e-6, ROLES[role].name, value)
            for events in EventLog(path, made).events()
            for time_us, role, value in zip(
                events.time_us.tolist(),
                events.role.tolist(),
                events.value.tolist(),
                strict=True,
            )
        ]

    return read
