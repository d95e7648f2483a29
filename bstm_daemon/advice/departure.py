"""P1 and P2: a message before departure, with a sound.

Fluid boils minutes after the car has parked, so the driver is asked to wait
when about to leave, by a text with a time; a lamp while driving would only
alarm (thesis, 7.2.1). A stop at a light is no departure.
"""

from __future__ import annotations

from enum import Enum, auto
from math import isfinite, nan
from typing import TYPE_CHECKING, ClassVar, Final

from bstm_daemon.estimate import Message, RiskLevel, Sound
from bstm_daemon.estimator.memory import Int64, Machine

if TYPE_CHECKING:
    from bstm_daemon.advice.conditions import Conditions
    from bstm_daemon.config.estimates import AdviceConfig

STANDING_MS: Final = 0.5
DRIVING_MS: Final = 1.5
"""The car stands below the first speed and drives above the second; between
them nothing changes."""

CHIME_US: Final = 3_000_000


class Phase(Enum):
    """What the car is doing."""

    DRIVING = auto()
    STOPPED = auto()
    """Standing, engine on, not for long: a light, a junction."""
    PARKED = auto()


class Departure(Machine):
    """The state machine of the message; begins parked.

    A monitor starts with the car, so what it sees first is a departure.
    """

    MEMORY: ClassVar = {
        "phase": Phase,
        "message": Message,
        "_stopped_us": Int64 | None,
        "_chime_until_us": Int64 | None,
    }

    def __init__(self, config: AdviceConfig) -> None:
        """Begin parked."""
        self._config = config
        self.phase = Phase.PARKED
        self.message = Message.NONE
        self._stopped_us: int | None = None
        self._chime_until_us: int | None = None

    def update(self, now: Conditions) -> tuple[Message, Sound, float]:
        """Return message, sound and waiting time [s] at *now*."""
        self._move(now)
        before = self.message
        self.message = self._message(now)
        shown = self.message is Message.WAIT_BEFORE_DEPARTURE
        if shown and before is not Message.WAIT_BEFORE_DEPARTURE:
            self._chime_until_us = now.time_us + CHIME_US
        sounds = (
            shown
            and self._config.sound
            and self._chime_until_us is not None
            and now.time_us < self._chime_until_us
        )
        return (
            self.message,
            Sound.CHIME if sounds else Sound.NONE,
            now.waiting_s if shown else nan,
        )

    def _move(self, now: Conditions) -> None:
        if isfinite(now.speed_ms):
            if now.speed_ms > DRIVING_MS:
                self.phase, self._stopped_us = Phase.DRIVING, None
            elif now.speed_ms < STANDING_MS and self.phase is Phase.DRIVING:
                self.phase, self._stopped_us = Phase.STOPPED, now.time_us
        if self.phase is Phase.STOPPED and self._stopped_us is not None:
            stood_s = (now.time_us - self._stopped_us) * 1e-6
            off = now.flag("ignition") is False
            if off or stood_s >= self._config.parked_after_s:
                self.phase = Phase.PARKED

    def _message(self, now: Conditions) -> Message:
        if self.phase is Phase.DRIVING:
            hot = self._config.while_driving and (
                now.level is RiskLevel.CRITICAL
            )
            return Message.BRAKES_HOT if hot else Message.NONE
        if self.phase is Phase.STOPPED or now.flag("ignition") is False:
            return Message.NONE
        if now.level in (RiskLevel.HIGH, RiskLevel.CRITICAL):
            return Message.WAIT_BEFORE_DEPARTURE
        waiting = self.message is Message.WAIT_BEFORE_DEPARTURE
        # a level that is now unknown has not become safe
        return self.message if waiting and now.is_unsure else Message.NONE
