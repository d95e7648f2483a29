"""Log events of the live service: one name per fact, with its fields.

:mod:`bstm_daemon.cli.main` formats them, as text on a terminal and as JSON
lines elsewhere. Here are the names that log searches may rely on, and the
limit on repeated events.
"""

from collections.abc import Hashable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Literal

import structlog
from structlog.typing import FilteringBoundLogger

Level = Literal["debug", "info", "warning", "error"]

REPEAT_INTERVAL_S: Final = 10.0
"""A fault at frame rate is logged every 10 s, not 100 times a second."""


@dataclass(frozen=True, slots=True)
class Event:
    """A fact: its name, its level and the fields it always has."""

    name: str
    level: Level
    fields: tuple[str, ...] = ()


STARTED: Final = Event(
    "service_started", "info", ("version", "config", "kernel")
)
STOPPING: Final = Event("service_stopping", "info", ("reason",))

BUS_UP: Final = Event("bus_up", "info", ("bus", "channel"))
BUS_DOWN: Final = Event("bus_down", "warning", ("bus", "channel"))
BUS_MISSING: Final = Event(
    "bus_missing", "warning", ("bus", "channel", "error")
)
RECEIVE_BUFFER: Final = Event(
    "receive_buffer", "info", ("bus", "asked_bytes", "given_bytes")
)
BUS_OFF: Final = Event("bus_off", "error", ("bus", "channel"))
BUS_RESTARTED: Final = Event("bus_restarted", "info", ("bus", "channel"))
FRAMES_DROPPED: Final = Event("frames_dropped", "warning", ("bus", "count"))
FRAMES_REFUSED: Final = Event("frames_refused", "warning", ("reason", "count"))

PUBLISHING_STARTED: Final = Event(
    "publishing_started", "info", ("bus", "id_base")
)
FOREIGN_FRAME: Final = Event("foreign_frame", "error", ("bus", "can_id"))
"""Another node sent one of our ids: publishing ends."""
SEND_FAILED: Final = Event("send_failed", "warning", ("bus", "error"))

INPUT_FAULT: Final = Event("input_fault", "warning", ("fault",))
INPUT_FAULT_OVER: Final = Event("input_fault_over", "info", ("fault",))
MODEL_DISAGREES: Final = Event("model_disagrees", "warning", ("what",))
MODEL_AGREES: Final = Event("model_agrees", "info", ("what",))
CLOCK_STEPPED: Final = Event("clock_stepped", "warning", ("step_s",))
VALIDITY_CHANGED: Final = Event(
    "validity_changed", "info", ("corner", "validity", "reasons")
)
INPUTS_UNVERIFIED: Final = Event("inputs_unverified", "warning", ("inputs",))
"""Nothing can check these inputs: what goes by them is degraded."""
RISK_ROSE: Final = Event(
    "risk_rose", "warning", ("corner", "level", "margin_k")
)
RISK_FELL: Final = Event("risk_fell", "info", ("corner", "level", "margin_k"))

STATE_LOADED: Final = Event(
    "state_loaded", "info", ("file", "age_s", "exact", "new_nodes")
)
PARKED_TIME_CORRECTED: Final = Event(
    "parked_time_corrected", "warning", ("assumed_s", "parked_s")
)
SLEPT: Final = Event("computer_slept", "warning", ("asleep_s",))
ESTIMATE_RESET: Final = Event("estimate_reset", "error", ("count",))
RECORD_KEPT: Final = Event("record_kept", "info", ("reason",))
RECORD_FAILED: Final = Event("record_failed", "warning", ("error",))
STATE_DISCARDED: Final = Event(
    "state_discarded", "warning", ("file", "reason")
)
STATE_SAVE_FAILED: Final = Event(
    "state_save_failed", "error", ("file", "error")
)
CONFIG_RELOADED: Final = Event("config_reloaded", "info", ("config",))
CONFIG_REFUSED: Final = Event(
    "config_refused", "error", ("config", "problems")
)
FEED_FAILED: Final = Event("feed_failed", "warning", ("error",))
METRICS_FAILED: Final = Event("metrics_failed", "warning", ("error",))
LATE_US: Final = 100_000
"""A cycle that takes longer misses a publication."""

LOOP_LATE: Final = Event("loop_late", "warning", ("lag_s",))


class ServiceLog:
    """Logs events with their fields, repeats at most once per interval."""

    def __init__(
        self,
        logger: FilteringBoundLogger | None = None,
        interval_s: float = REPEAT_INTERVAL_S,
    ) -> None:
        """Log to *logger*, by default structlog as it is configured."""
        self._logger = structlog.get_logger() if logger is None else logger
        self._interval_us = round(interval_s * 1e6)
        self._logged: dict[tuple[str, Hashable], tuple[int, int]] = {}
        """When a line was last logged, and how many were held back since."""

    def emit(self, event: Event, **fields: Any) -> None:
        """Log *event*.

        Raises :class:`TypeError` unless *fields* are those of the event.
        """
        if fields.keys() != set(event.fields):
            msg = (
                f"{event.name} has the fields {', '.join(event.fields)}; "
                f"given: {', '.join(fields)}"
            )
            raise TypeError(msg)
        # a log that nobody reads must not end the service
        with suppress(OSError):
            getattr(self._logger, event.level)(event.name, **fields)

    def repeat(
        self, event: Event, key: Hashable, now_us: int, **fields: Any
    ) -> None:
        """Log *event* unless it was logged for *key* within the interval.

        *now_us* is on any axis that runs forward; a time before the last one
        begins a new interval. The next line after held-back ones has
        ``suppressed``, their number. Raises :class:`TypeError` unless
        *fields* are those of the event.
        """
        place = event.name, key
        last_us, held = self._logged.get(place, (None, 0))
        if last_us is not None and 0 <= now_us - last_us < self._interval_us:
            self._logged[place] = last_us, held + 1
            return
        self._logged[place] = now_us, 0
        more = {"suppressed": held} if held else {}
        self.emit(
            Event(event.name, event.level, (*event.fields, *more)),
            **fields,
            **more,
        )
