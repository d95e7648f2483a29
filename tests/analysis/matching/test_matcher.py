"""What is done around the fits of a match, with fits of known results."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.analysis.matching import matcher, workflow
from bstm_daemon.analysis.matching.structure import (
    FIRST_W_M2K,
    with_contact,
)
from bstm_daemon.analysis.matching.tunables import (
    CONDUCTANCE,
    CONTACT,
    DRAG,
    LINING,
    MASS,
    refined_keys,
)

from ...made_matches import match_of  # noqa: TID252  (tests are no package)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.analysis.matching.tunables import Target

SHORT = ((20.0, 20e3, 20.0), (20.0, 0.0, 60.0))


def test_contact_is_tried_beside_what_the_car_has(
    target: Target, made: Callable[..., Drive]
) -> None:
    """Where no drive sees both sides, or it is there already, it is not."""
    fade = [one.model_copy() for one in target.config.effect]
    drive = made(profile=SHORT)

    trial = with_contact(target, [drive])

    assert trial is not None
    assert {*LINING} == {*refined_keys(trial)} - {
        *refined_keys(target),
        CONDUCTANCE,
    }
    assert trial.config.effect[:-1] == fade
    added = trial.config.effect[-1]
    assert (added.name, added.parameters) == (
        CONTACT,
        {"conductance_w_m2k": FIRST_W_M2K},
    )
    assert with_contact(trial, [drive]) is None
    assert with_contact(target, [made(profile=SHORT, nodes=("disc",))]) is None


@pytest.mark.parametrize(
    ("more_k", "doubt", "added"),
    [(1.7, "doubt", True), (1.9, "doubt", False), (1.7, "", None)],
)
def test_contact_is_kept_where_it_leaves_less(
    more_k: float,
    doubt: str,
    added: bool | None,  # noqa: FBT001
    target: Target,
    made: Callable[..., Drive],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The match that goes out says what was tried; without doubt nothing."""
    shown: list[float] = []
    drives = [made(profile=SHORT)]

    def fitted(
        one: Target, _: Any, only: str, show: Any, *, beside: bool
    ) -> list[Match]:
        assert only == ""
        show(1.0)
        if one is target:
            assert beside
            plain = match_of(
                one,
                {MASS: 1.0},
                rms_k={"disc": 2.0},
                verdict=(doubt,) if doubt else (),
            )
            plain.drives.extend(drives)  # type: ignore[attr-defined]
            return [plain]
        assert {*LINING} < {*refined_keys(one)}
        assert not beside
        return [match_of(one, {MASS: 1.3}, rms_k={"disc": more_k})]

    monkeypatch.setattr(matcher, "_match", fitted)

    (found,) = matcher._with_additions(
        target, [], "", shown.append, beside=True
    )

    assert found.before is target
    assert found.joint.values == {MASS: 1.3 if added else 1.0}
    if added is None:
        assert (found.remarks, shown) == ((), [0.5])
        return
    (remark,) = found.remarks
    assert f"leaves {more_k / 2.0:.2f} times the error" in remark
    assert remark.endswith(": added" if added else ": not added")
    assert shown == [0.5, 1.0]


@pytest.mark.parametrize(("after_k", "said"), [(7.9, True), (8.1, False)])
def test_the_other_form_is_named_where_it_leaves_much_less(
    after_k: float,
    said: bool,  # noqa: FBT001
    target: Target,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    joint: Any = SimpleNamespace(
        rms_k={"disc": 10.0}, keys=(MASS,), values={MASS: 1.1}, noise={}
    )

    def refined(other: Target, *_: Any, **given: Any) -> Any:
        assert other.config.cooling_of(other.corner).form == "conductance"
        assert given == {"start": {MASS: 1.1}, "noise": {}, "rounds": 1}
        return SimpleNamespace(rms_k={"disc": after_k})

    monkeypatch.setattr(matcher, "refine", refined)

    wanted = (
        'cooling.form = "conductance" would leave 7.9 K of the disc instead '
        "of 10.0 K: set it and match again"
    )
    assert matcher._other_form(target, [], joint) == (wanted if said else "")
    joint.rms_k = {"fluid": 3.0}
    assert matcher._other_form(target, [], joint) == ""


@pytest.mark.parametrize(
    ("again", "only"), [(False, ""), (True, ""), (True, "cooling")]
)
def test_logs_are_read_anew_where_friction_follows_temperature(
    again: bool,  # noqa: FBT001
    only: str,
    target: Target,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And around the drag area that was found; Table 4.1 comes last.

    Also without fade, but for what another rim changes.
    """
    config, signal_map, overrides = target.config, object(), {"can0": "main"}
    reads: list[tuple[Any, ...]] = []
    fits: list[dict[str, Any]] = []
    near: list[tuple[float, ...]] = []

    def match(of: Any, readings: Any, **given: Any) -> list[Match]:
        fits.append({"readings": readings, **given})
        assert of == config
        return [match_of(target, {DRAG: 0.9})]

    def read(of: Any, guessed: Any, one: Any, near_m2: Any) -> list[Any]:
        near.append(tuple(near_m2))
        assert guessed == (frozenset({DRAG}) if len(near) < 3 else set())
        return [one(of)]

    def fading(reading: Any, of: Any, linings: Any, read: Any) -> Any:
        assert (linings, of) == ([target.linings], reads[2][1])
        return [*reading, *read(config)]

    monkeypatch.setattr(
        workflow, "read_drives", lambda *of: reads.append(of) or [len(reads)]
    )
    monkeypatch.setattr(workflow, "match_drives", match)
    monkeypatch.setattr(workflow, "read_as_guessed", read)
    monkeypatch.setattr(workflow, "read_with_fade", fading)
    monkeypatch.setattr(
        workflow, "identified_guesses", lambda *_: ([], ["no stop"])
    )
    monkeypatch.setattr(workflow, "_follows_temperature", lambda _: again)

    found = workflow.match_logs(
        *([tmp_path], config, signal_map),  # type: ignore[arg-type]
        frozenset({DRAG}),
        overrides=overrides,
        each=True,
        only=only,
    )

    assert found.why_not == ["no stop"]
    assert near == [(), (0.9,), *([()] if again else [])]
    assert [one["beside"] for one in fits] == [not again, True, True][
        : len(near)
    ]
    last = [3] if only else [3, 4]
    assert [one["readings"] for one in fits] == [[[1]], [[2]], [last]][
        : len(near)
    ]
    assert all(one["each"] and one["only"] == only for one in fits)
    for logs, of, *rest in reads:
        assert (logs, rest) == ([tmp_path], [signal_map, overrides, None])
        assert of.vehicle.drag_area_m2 in {0.9, config.vehicle.drag_area_m2}
    assert reads[0][1] == config
    if again:
        assert reads[2][1].vehicle.drag_area_m2 == 0.9
