"""All advice and requests of one car, publication by publication."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.advice.conditions import HeldRoles, conditions_at
from bstm_daemon.advice.departure import Departure
from bstm_daemon.advice.descent import Descent
from bstm_daemon.advice.emergency import EmergencyAssist
from bstm_daemon.advice.hydraulics import FrontIsolation, PedalFeel
from bstm_daemon.estimate import Advice
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimate import CornerEstimate
    from bstm_daemon.estimator.blocks import Instant


class Advisor:
    """All state machines of :mod:`bstm_daemon.advice`.

    They use the time of the data only, so a replay gives the same advice.
    """

    def __init__(self, config: Config, timeouts_us: Mapping[int, int]) -> None:
        """Begin parked, with nothing to advise.

        Args:
            config: the vehicle.
            timeouts_us: role number to time-out [us] of each mapped role.
        """
        self._config = config
        self._timeouts_us = timeouts_us
        self.roles = HeldRoles(timeouts_us, ROLE_INDEX)
        """Holds the samples of the driver's roles."""
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
        """Return the whole memory as plain values."""
        return {
            "machines": {
                name: machine.export()
                for name, machine in self._machines.items()
            },
            "roles": self.roles.export(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from *saved*, of :meth:`export`, within the same drive.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind; this
                may be half restored.
        """
        for name, machine in self._machines.items():
            machine.restore(saved["machines"][name])
        self.roles.restore(saved["roles"])

    def resumed(self, saved: Any) -> Advisor:
        """Return one that continues from *saved*, of :meth:`export`.

        Within the same drive; one that begins parked where *saved* is
        nothing of that kind.
        """
        fresh = Advisor(self._config, self._timeouts_us)
        try:
            fresh.restore(saved)
        except (KeyError, TypeError, ValueError, AttributeError):
            return self
        return fresh

    def update(
        self, instant: Instant, corners: Mapping[str, CornerEstimate]
    ) -> Advice:
        """Return the advice at *instant*; to be called for every publication.

        Args:
            instant: the publication.
            corners: the corners with a thermal model then.
        """
        held = self.roles.at(instant.time_us)
        now = conditions_at(instant, corners, held)
        message, sound, waiting_s = self.departure.update(now)
        driver, gearbox = self.descent.update(now)
        assist, intervention, score = self.emergency.update(now)
        return Advice(
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
