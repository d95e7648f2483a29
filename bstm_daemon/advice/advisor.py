"""All advice and requests of one car, publication by publication."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.advice.departure import Departure
from bstm_daemon.advice.descent import Descent
from bstm_daemon.advice.emergency import EmergencyAssist
from bstm_daemon.advice.hydraulics import FrontIsolation, PedalFeel
from bstm_daemon.bus.publication_slow import AdviceSnapshot

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.advice.conditions import Conditions
    from bstm_daemon.config import Config


class Advisor:
    """The machines of :mod:`bstm_daemon.advice`, side by side.

    They know the time of the data only, so a replay gives the same advice.
    """

    def __init__(self, config: Config) -> None:
        """Begin parked, with nothing to say."""
        self.departure = Departure(config.advice)
        self.descent = Descent(config)
        self.pedal = PedalFeel(config.advice)
        self.isolation = FrontIsolation(config.advice)
        self.emergency = EmergencyAssist(config)
        self._machines = {
            "departure": self.departure,
            "descent": self.descent,
            "pedal": self.pedal,
            "isolation": self.isolation,
            "emergency": self.emergency,
        }

    def export(self) -> dict[str, Any]:
        """Return the memory of all machines as plain values."""
        return {
            name: machine.export() for name, machine in self._machines.items()
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on where :meth:`export` was called, within the same drive.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind.
        """
        for name, machine in self._machines.items():
            machine.restore(saved[name])

    def update(self, now: Conditions) -> AdviceSnapshot:
        """Return the advice at *now*; to be called for every publication."""
        message, sound, waiting_s = self.departure.update(now)
        driver, gearbox = self.descent.update(now)
        assist, intervention, score = self.emergency.update(now)
        return AdviceSnapshot(
            message=message,
            sound=sound,
            waiting_s=waiting_s,
            shift_advice=driver,
            gearbox_request=gearbox,
            front_isolation=self.isolation.update(now),
            emergency_assist=assist,
            intervention=intervention,
            pedal_feel=self.pedal.update(now),
            detector_score=score,
            validity=now.validity,
        )
