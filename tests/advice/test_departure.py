"""P1 and P2: parked, about to leave, driving, at a light."""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.advice.conditions import Conditions
from bstm_daemon.advice.departure import Departure, Phase
from bstm_daemon.config.estimates import AdviceConfig
from bstm_daemon.estimate import (
    CornerEstimate,
    CornerRisk,
    Message,
    RiskLevel,
    Sound,
    Validity,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

WAIT, NONE = Message.WAIT_BEFORE_DEPARTURE, Message.NONE


def waiting(
    level: RiskLevel, safe_in_s: float, validity: Validity = Validity.VALID
) -> CornerEstimate:
    """Return a corner that is safe *safe_in_s* from now."""
    return CornerEstimate(
        sure_level=level,
        risk=CornerRisk(safe_in_s=safe_in_s + 30.0),
        forecast_age_s=30.0,
        validity=validity,
    )


class Story:
    """A car told second by second."""

    def __init__(self, **config: Any) -> None:
        self.machine = Departure(AdviceConfig(**config))
        self.time_us = 0
        self.sounds = 0

    def tell(
        self,
        seconds: float,
        speed_ms: float,
        level: RiskLevel,
        *,
        ignition: bool | None = True,
        wait_s: float = 600.0,
        validity: Validity = Validity.VALID,
    ) -> tuple[Message, float]:
        """Return message and waiting time after *seconds*."""
        driver = {} if ignition is None else {"ignition": float(ignition)}
        found = NONE, Sound.NONE, 0.0
        for _ in range(round(seconds * 10)):
            self.time_us += 100_000
            corners = {
                "FL": waiting(level, wait_s, validity),
                "RL": waiting(RiskLevel.NORMAL, nan),
            }
            found = self.machine.update(
                Conditions(self.time_us, corners, speed_ms, driver=driver)
            )
            self.sounds += found[1] is Sound.CHIME
        return found[0], found[2]


def test_a_hot_car_that_is_started_asks_to_wait() -> None:
    """The monitor's first sight of a parked car is a departure."""
    story = Story()

    assert story.tell(10.0, 0.0, RiskLevel.HIGH) == (WAIT, 600.0)
    assert story.sounds == 30
    message, waiting_s = story.tell(1.0, 0.0, RiskLevel.ELEVATED)
    assert message is NONE
    assert isnan(waiting_s)


def test_descent_parking_and_departure() -> None:
    """Nothing while driving, at the light, engine off; then the message."""
    story = Story()
    hot = RiskLevel.CRITICAL

    assert story.tell(60.0, 10.0, hot)[0] is NONE
    assert story.machine.phase is Phase.DRIVING
    assert story.tell(50.0, 0.0, hot)[0] is NONE
    assert story.machine.phase is Phase.STOPPED
    assert story.tell(5.0, 10.0, hot)[0] is NONE
    assert story.tell(5.0, 0.0, hot)[0] is NONE
    assert story.tell(600.0, 0.0, hot, ignition=False)[0] is NONE
    assert story.machine.phase is Phase.PARKED
    assert story.sounds == 0
    assert story.tell(5.0, 0.0, hot)[0] is WAIT
    assert story.sounds == 30
    assert story.tell(1.0, 5.0, hot)[0] is NONE


def test_long_standing_is_parked_without_an_ignition_signal() -> None:
    story = Story()
    story.tell(5.0, 10.0, RiskLevel.HIGH, ignition=None)

    assert story.tell(59.0, 0.0, RiskLevel.HIGH, ignition=None)[0] is NONE
    assert story.tell(2.0, 0.0, RiskLevel.HIGH, ignition=None)[0] is WAIT


def test_long_standing_between_two_publications_is_parked() -> None:
    """No publication need be at the minute itself."""
    story = Story(parked_after_s=0.25 + 1.0)
    story.tell(5.0, 10.0, RiskLevel.HIGH, ignition=None)

    assert story.tell(1.3, 0.0, RiskLevel.HIGH, ignition=None)[0] is NONE
    assert story.tell(0.1, 0.0, RiskLevel.HIGH, ignition=None)[0] is WAIT


def test_creeping_is_neither_standing_nor_driving() -> None:
    story = Story()
    story.tell(5.0, 1.0, RiskLevel.NORMAL)
    assert story.machine.phase is Phase.PARKED
    story.tell(1.0, 2.0, RiskLevel.NORMAL)
    story.tell(5.0, 1.0, RiskLevel.NORMAL)
    assert story.machine.phase is Phase.DRIVING


def test_an_unknown_level_says_nothing_new() -> None:
    """No message comes of it, and none goes."""
    story = Story()
    assert story.tell(1.0, 0.0, RiskLevel.UNKNOWN)[0] is NONE
    story.tell(1.0, 0.0, RiskLevel.HIGH)

    assert story.tell(1.0, 0.0, RiskLevel.UNKNOWN)[0] is WAIT


def test_an_invalid_estimate_asks_for_nothing() -> None:
    """Its level does not count; a message that was shown stays."""
    story = Story()
    found = story.tell(1.0, 0.0, RiskLevel.CRITICAL, validity=Validity.INVALID)
    assert found[0] is NONE


def test_an_unknown_speed_changes_no_phase() -> None:
    story = Story()
    story.tell(1.0, 10.0, RiskLevel.HIGH)
    story.tell(1.0, 0.0, RiskLevel.HIGH)

    story.tell(70.0, float("nan"), RiskLevel.HIGH)

    assert story.machine.phase is Phase.PARKED


def test_lamp_while_driving_only_if_asked_for() -> None:
    story = Story(while_driving=True)

    assert story.tell(1.0, 10.0, RiskLevel.HIGH)[0] is NONE
    assert story.tell(1.0, 10.0, RiskLevel.CRITICAL)[0] is Message.BRAKES_HOT
    assert story.sounds == 0


def test_without_sound() -> None:
    story = Story(sound=False)
    story.tell(5.0, 0.0, RiskLevel.HIGH)

    assert story.sounds == 0


@pytest.mark.parametrize(
    ("times", "expected"),
    [((60.0, 600.0), 600.0), ((60.0, float("nan")), float("nan"))],
)
def test_waiting_is_for_the_slowest_and_never_guessed(
    times: Iterable[float], expected: float
) -> None:
    corners = {
        name: waiting(RiskLevel.HIGH, seconds)
        for name, seconds in zip(("FL", "FR"), times, strict=True)
    }
    corners["RL"] = waiting(RiskLevel.NORMAL, nan)

    waiting_s = Conditions(0, corners).waiting_s

    assert waiting_s == pytest.approx(expected, nan_ok=True)
