"""Drives heated anew: only what decides the heat is computed."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.analysis.gap import recording as module
from bstm_daemon.analysis.gap.comparison import heats, with_effects
from bstm_daemon.analysis.gap.recording import (
    Packed,
    Recording,
    inputs_of,
    recorded,
)
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.channels import CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.estimator.coupling import COUPLING_US, Coupling
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import load_drive, simulate

from ...made_drives import effect_entries  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config


@pytest.fixture(scope="module")
def short(config: Config) -> Recording:
    """Return a short drive as it was recorded, at 10 Hz."""
    drive = simulate(load_drive("idiada-step"))
    present = present_roles(
        load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    )
    parts = [
        (drive.time_s[::10], ROLE_INDEX[name], np.asarray(values)[::10])
        for name, values in drive.roles.items()
    ] + [
        (drive.slow_time_s, ROLE_INDEX[name], values)
        for name, values in drive.temperatures.items()
    ]
    parts = [part for part in parts if part[1] in present]
    time_us = np.concatenate([np.rint(t * 1e6) for t, _, _ in parts])
    order = np.argsort(time_us, kind="stable")
    events = Events(
        time_us.astype(np.int64)[order],
        np.concatenate([np.full(len(t), r, np.int32) for t, r, _ in parts])[
            order
        ],
        np.concatenate([values for _, _, values in parts])[order],
        Counter(),
    )
    return recorded("short", [events], config, present)


@pytest.mark.parametrize(
    "name", ["friction_speed", "brake_share", "hydraulic_lag"]
)
def test_heat_does_not_need_the_temperatures(
    name: str,
    config: Config,
    short: Recording,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    on = with_effects(config, effect_entries({name: 1.0}))
    alone, _ = inputs_of(on, short.present, short.thin)
    monkeypatch.setattr(module._Heating, "__init__", Estimator.__init__)

    whole, _ = inputs_of(on, short.present, short.thin)

    assert np.array_equal(alone, whole, equal_nan=True)
    assert not np.array_equal(alone, short.drive.inputs, equal_nan=True)


@pytest.mark.parametrize(("room", "passes"), [(1 << 25, 2), (-1, 4)])
def test_a_trial_that_is_asked_for_again_is_not_passed_again(
    room: int,
    passes: int,
    config: Config,
    short: Recording,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Unless there is no room; what a match learned is no other trial."""
    mass, share = (
        with_effects(config, effect_entries({name: 1.0}))
        for name in ("mass_error", "brake_share")
    )
    wanted = [
        inputs_of(one, short.present, short.thin)[0] for one in (mass, share)
    ]
    asked: list[Config] = []

    def counted(config: Config, *of: Any) -> Any:
        asked.append(config)
        return inputs_of(config, *of)

    monkeypatch.setattr(module, "inputs_of", counted)
    monkeypatch.setattr(module, "MOST_BYTES", room)
    fresh = replace(short, _tried={})
    own = MatchedConfig(corners=["FL"], names=[], values=[], factor=[])
    learned = mass.model_copy(update={"matched": [own]})

    found = [
        fresh.thin_inputs_of(one) for one in (mass, share, learned, share)
    ]

    assert len(asked) == passes
    for one, whole in zip(found, [*wanted, *wanted], strict=True):
        assert np.array_equal(one, whole, equal_nan=True)
    assert not np.array_equal(*wanted, equal_nan=True)


def test_only_effects_on_the_inputs_need_another_pass(config: Config) -> None:
    acts = {
        name: heats(effect_entries({name: 1.0})[0], config)
        for name in (
            *("friction_fade", "brake_share", "mass_error"),
            *("friction_history", "residual_drag", "gap_conduction"),
        )
    }

    assert acts == {
        "friction_fade": True,
        "brake_share": True,
        "mass_error": True,
        "friction_history": False,
        "residual_drag": False,
        "gap_conduction": False,
    }


def test_temperatures_of_no_brake_begin_anew(config: Config) -> None:
    """A disc far too light gets absurdly hot, and worn pads follow it."""
    fading = with_effects(config, effect_entries({"friction_fade": 1.0}))
    corners = [
        corner.model_copy(
            update={"disc": corner.disc.model_copy(update={"mass_kg": 1e-4})}
        )
        for corner in fading.corner
        if corner.disc is not None
    ]
    followed = {"pad_wear_m3_j": 3e-11, "model_follows": True}
    wear = fading.wear.model_copy(update=followed)
    light = fading.model_copy(update={"corner": corners, "wear": wear})
    held = {
        "vehicle_speed": 60.0,
        "primary_pressure": 2e7,
        "ambient_temperature": 300.0,
    }
    numbers = [ROLE_INDEX[role] for role in held]
    count = 650
    events = Events(
        np.repeat(np.arange(count, dtype=np.int64) * 100_000, len(held)),
        np.tile(np.array(numbers, np.int32), count),
        np.tile(list(held.values()), count),
        Counter(),
    )

    rows, _ = inputs_of(light, dict.fromkeys(numbers, 500_000), Packed(events))

    power_w = rows[..., CHANNELS.index("brake_power_w")]
    assert np.isfinite(power_w).all()
    assert power_w.max() > 5e5


def test_pieces_of_a_log_are_one_recording(config: Config) -> None:
    """Few samples are kept of each piece; which ones is all the same."""
    rng = np.random.default_rng(2)
    time_us = np.sort(rng.integers(0, 60_000_000, 4000))
    roles = rng.choice(
        [ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]], 4000
    ).astype(np.int32)
    events = Events(time_us, roles, rng.random(4000), Counter())
    present = {int(role): 500_000 for role in np.unique(roles)}
    whole = recorded("a", [events], config, present)

    cut = recorded("a", Packed(events).pieces(333), config, present)

    (kept,), (wanted,) = (one.thin.pieces(4000) for one in (cut, whole))
    assert np.array_equal(kept.time_us, wanted.time_us)
    assert np.array_equal(kept.value, wanted.value)
    assert np.array_equal(cut.drive.inputs, whole.drive.inputs, equal_nan=True)
    assert len(cut.thin) < 0.5 * len(events)


SAMPLES = st.lists(
    st.tuples(
        st.integers(-(2**33), 2**33),
        st.sampled_from(sorted(ROLE_INDEX.values())),
        st.floats() | st.sampled_from([0.0, -0.0, 1.5]),
    )
)


@given(SAMPLES, st.integers(1, 9))
def test_packed_samples_are_the_same_bit_for_bit(
    samples: list[tuple[int, int, float]], every: int
) -> None:
    """Clocks that jump, values that are none and two zeros, by pieces."""
    stamps, roles, values = zip(*samples, strict=True) if samples else [()] * 3
    events = Events(
        np.array(stamps, np.int64),
        np.array(roles, np.int32),
        np.array(values, float),
    )
    packed = Packed(events)

    parts = list(packed.pieces(every))

    assert [len(one) for one in parts[:-1]] == [every] * len(parts[:-1])
    for name in ("time_us", "role", "value"):
        kept = [getattr(one, name) for one in parts]
        wanted = getattr(events, name)
        assert b"".join(map(np.ndarray.tobytes, kept)) == wanted.tobytes()
    for role in (0, *roles):
        own = events.role == role
        time_us, value = packed.of_role(role)
        assert time_us.tolist() == events.time_us[own].tolist()
        assert value.tobytes() == events.value[own].tobytes()


def test_samples_of_a_bus_take_a_third(short: Recording) -> None:
    """Its values have 16 bits at most: 7 bytes of 20."""
    (whole,) = short.thin.pieces(len(short.thin))
    kept = vars(short.thin).values()

    taken = sum(one.nbytes for one in kept if isinstance(one, np.ndarray))

    assert len(short.thin._values) < 2**16
    table = short.thin._values.nbytes
    assert taken - table == 7 * len(whole)


def test_a_trial_of_a_law_takes_its_temperature_less_often(
    config: Config, short: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    heat = config.heat.model_copy(update={"mode": "ff"})
    config = config.model_copy(update={"heat": heat})
    early = {"onset_c": 100.0, "span_k": 100.0}
    on = with_effects(
        config, effect_entries({"friction_fade": 1.0}, form=early)
    )
    plain, _ = inputs_of(config, short.present, short.thin)
    seldom, _ = inputs_of(on, short.present, short.thin)
    monkeypatch.setattr(module, "THIN_COUPLING_US", COUPLING_US)
    monkeypatch.setattr(module._Coarse, "_march", Coupling._march)

    often, _ = inputs_of(on, short.present, short.thin)

    power = CHANNELS.index("brake_power_w")
    off = (seldom - often)[:, :, power]
    change = (often - plain)[:, :, power]
    # of the heat so far, which is what temperatures show
    worst = np.abs(np.cumsum(off, axis=0)).max()
    assert 0.0 < worst < 0.1 * np.abs(np.cumsum(change, axis=0)).max()


def test_a_shorter_row_of_inputs_goes_on_as_it_ends() -> None:
    drive: Any = range(5)
    short: Any = range(2)
    rows = np.arange(6.0).reshape(3, 2)

    longer = module._like(drive, rows)

    assert longer.tolist() == [[0, 1], [2, 3], [4, 5], [4, 5], [4, 5]]
    assert module._like(short, rows).tolist() == rows[:2].tolist()


def test_no_step_is_marched_of_no_row() -> None:
    coarse: Any = SimpleNamespace(rows=array("d"), _width=3)
    one: Any = ("a batch", ("FL",))

    assert module._Coarse._march(coarse, [one], 0, 0) == (array("d"),)


def test_nothing_is_marched_where_no_friction_fades(config: Config) -> None:
    """A drive that is heated anew needs its temperatures for friction only."""
    present = present_roles(
        load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    )
    fading = with_effects(config, effect_entries({"friction_fade": 1.0}))

    plain, hot = (module._Heating(one, present) for one in (config, fading))

    assert (plain.batches, plain._coupling.coupled) == ([], False)
    assert len(hot.batches) > 0
    assert hot._coupling.coupled
