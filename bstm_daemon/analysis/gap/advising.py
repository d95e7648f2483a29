"""Which drive would separate what the drives so far do not.

Before it is driven: each candidate that is left is simulated on each drive
of a menu. Worlds are drawn from what the data leave open (which candidate is
true, how strong, what the tunables are), each world's thermocouples are
predicted with their noise, and the answer is formed from old and new data
together as it would be. Counted is how often the true candidate is named.

The driver and the car of each menu drive are the simulated ones: speed,
pressure and torque of every sample. What thermocouples would then show is
the model's own prediction, never the simulated brake's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import either_sign, is_change
from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.evidence import NOTHING, strength_prior
from bstm_daemon.analysis.gap.naming import SURE, Naming
from bstm_daemon.analysis.gap.recording import (
    Packed,
    Recording,
    inputs_of,
    thinned,
)
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    sensitivities,
    signature_of,
)
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import march, model_of
from bstm_daemon.analysis.matching.thermocouples import Thermocouple, lagged
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.simulate import SimulatedDrive

WORLDS: Final = 400
"""Worlds drawn for each drive: odds are good to 2 %."""

SEED: Final = 3

MOST_MEMBERS: Final = 8
LEAST_ODDS: Final = 0.005
"""Candidates that are less probable than this are not asked about."""

LEAST_NAMED: Final = 0.02
"""A drive that names the right candidate less often than the odds are good to
is behind the others, however short it is."""


@dataclass(frozen=True, slots=True)
class Advice:
    """What one drive would show.

    ``named`` is the probability that the true candidate is named with it,
    ``wrong`` that another one is; ``log_bayes_factor`` the expected advantage
    of the true one over its best rival, ``now`` that of the data so far.
    """

    drive: str
    description: str
    duration_s: float
    named: float
    wrong: float
    log_bayes_factor: float
    now: float

    @property
    def named_per_min(self) -> float:
        """``named`` for each minute that is driven."""
        return 60.0 * self.named / self.duration_s


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """Sensitivities of one drive that is yet to be driven, whitened.

    ``jacobian`` (n, p); ``signatures`` by name, without those that change
    nothing.
    """

    drive: str
    description: str
    duration_s: float
    jacobian: Column
    signatures: dict[str, Signature]


def members_of(naming: Naming, silent: Sequence[str]) -> tuple[str, ...]:
    """Return the candidates that are left, the likeliest first.

    Below the gate that is what the data could not have shown.
    """
    if naming.answer in {"class", "undecided"}:
        likely = [n for n, p in _ordered(naming.odds) if p >= LEAST_ODDS]
        return tuple(dict.fromkeys((*naming.names, *likely)))[:MOST_MEMBERS]
    likely = [name for name, _ in _ordered(naming.odds)]
    return (*likely[:MOST_MEMBERS], *silent)


def prospect(
    comparison: Comparison, names: Sequence[str], description: str
) -> Prospect:
    """Return what *names* would do on the one drive of *comparison*."""
    drive = comparison.recordings[0].drive
    base, jacobian = sensitivities(comparison, comparison.start)
    found = {
        name: signature
        for name in names
        if (signature := signature_of(comparison, name, base)) is not None
    }
    return Prospect(drive.name, description, drive.duration_s, jacobian, found)


def advise(
    known: Linearised,
    prior: Column,
    members: Sequence[str],
    prospects: Sequence[Prospect],
) -> tuple[Advice, ...]:
    """Return what each drive would show, the best first.

    The best names the right candidate most often for each minute driven.

    Args:
        known: the data so far.
        prior: standard deviations of the tunables' logarithms, (p,).
        members: candidates, one of which is taken to be true.
        prospects: the drives.
    """
    judge = _Judge(known, prior, members)
    found = [judge.advice(one) for one in prospects]

    def rank(one: Advice) -> tuple[bool, float, float]:
        poor = one.named < LEAST_NAMED
        worth = one.named if poor else one.named_per_min
        return poor, -worth, -one.log_bayes_factor

    return tuple(sorted(found, key=rank))


class _Judge:
    """Draws worlds from the data so far and judges them with more."""

    def __init__(
        self, known: Linearised, prior: Column, members: Sequence[str]
    ) -> None:
        """Draw the worlds: who is true, its strength, the tunables."""
        self._residual = known.residual
        self._jacobian = known.jacobian
        self._precision = prior**-2.0
        self._members = tuple(members)
        by_name = {one.name: one for one in known.signatures}
        size = len(known.residual)
        self._old = [_columns(by_name.get(n), size) for n in self._members]
        self._share = (1.0 - NOTHING) / max(len(by_name), len(members), 1)
        priors = [
            strength_prior(either_sign=either_sign(name), even=is_change(name))
            for name in self._members
        ]
        self._grids = [grid for grid, _ in priors]
        self._weights = [weights for _, weights in priors]
        self._draw()

    def advice(self, drive: Prospect) -> Advice:
        """Return what *drive* would show."""
        size = len(drive.jacobian)
        new = [_columns(drive.signatures.get(n), size) for n in self._members]
        noise = np.random.default_rng(SEED).normal(0.0, 1.0, (size, WORLDS))
        there = noise - drive.jacobian @ self._x
        for member, columns in enumerate(new):
            own = self._which == member
            there[:, own] -= columns @ _powers(self._strengths[own])
        before = np.repeat(self._residual[:, None], WORLDS, axis=1)
        logs, _ = self._weighed(
            np.vstack((self._jacobian, drive.jacobian)),
            [np.vstack(pair) for pair in zip(self._old, new, strict=True)],
            np.vstack((before, there)),
        )
        odds = self._odds(logs)
        world = np.arange(WORLDS)
        is_true = odds[self._which, world] >= SURE
        is_any = odds[:-1].max(axis=0) >= SURE
        return Advice(
            drive.drive,
            drive.description,
            drive.duration_s,
            float(np.mean(is_true)),
            float(np.mean(is_any & ~is_true)),
            self._advantage(logs),
            self._advantage(np.repeat(self._logs_now, WORLDS, axis=1)),
        )

    def _draw(self) -> None:
        """Draw from what the data leave open."""
        rng = np.random.default_rng(SEED)
        now = self._residual[:, None]
        self._logs_now, gains = self._weighed(self._jacobian, self._old, now)
        odds = self._odds(self._logs_now)[:-1, 0]
        odds /= odds.sum()
        self._which = rng.choice(len(odds), WORLDS, p=odds)
        self._strengths = np.zeros(WORLDS)
        for member in range(len(odds)):
            own = self._which == member
            logs = np.log(self._weights[member]) + gains[member][:, 0]
            chances = np.exp(logs - logs.max())
            self._strengths[own] = rng.choice(
                self._grids[member], own.sum(), p=chances / chances.sum()
            )
        normal = self._jacobian.T @ self._jacobian + np.diag(self._precision)
        apart = np.repeat(now, WORLDS, axis=1)
        for member, columns in enumerate(self._old):
            own = self._which == member
            apart[:, own] += columns @ _powers(self._strengths[own])
        middle = -np.linalg.solve(normal, self._jacobian.T @ apart)
        lower = np.linalg.cholesky(np.linalg.inv(normal))
        self._x = middle + lower @ rng.normal(0.0, 1.0, middle.shape)

    def _weighed(
        self, jacobian: Column, columns: Sequence[Column], residual: Column
    ) -> tuple[Column, list[Column]]:
        """Return the log Bayes factor of each member, (members, worlds).

        And the gain on each one's grid, (strengths, worlds).
        """
        project = Projector(jacobian, self._precision**-0.5)
        logs, gains = [], []
        for own, grid, weights in zip(
            columns, self._grids, self._weights, strict=True
        ):
            projected = project(own)
            steps = _powers(grid)
            score = steps.T @ (projected.T @ residual)
            size = np.einsum("ig,ij,jg->g", steps, own.T @ projected, steps)
            gain = -score - 0.5 * size[:, None]
            peak = gain.max(axis=0)
            logs.append(peak + np.log(weights @ np.exp(gain - peak)))
            gains.append(gain)
        return np.array(logs), gains

    def _odds(self, logs: Column) -> Column:
        """Return the probability of each member and, last, of nothing."""
        whole = np.vstack((logs + log(self._share), np.zeros(logs.shape[1])))
        whole[-1] = log(NOTHING)
        whole = np.exp(whole - whole.max(axis=0))
        return np.asarray(whole / whole.sum(axis=0))

    def _advantage(self, logs: Column) -> float:
        """Return the true one's mean advantage over its best rival."""
        world = np.arange(WORLDS)
        rivals = np.vstack((logs, np.zeros(WORLDS)))
        true = logs[self._which, world]
        rivals[self._which, world] = -np.inf
        return float(np.mean(true - rivals.max(axis=0)))


def _columns(signature: Signature | None, size: int) -> Column:
    """Return linear and curved part of *signature*, (size, 2)."""
    if signature is None:
        return np.zeros((size, 2))
    return np.column_stack((signature.linear, signature.curved))


def _powers(strengths: Column) -> Column:
    """Return strengths and their squares, (2, n)."""
    return np.vstack((strengths, strengths**2))


def _ordered(odds: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(
        ((name, p) for name, p in odds.items() if name), key=lambda o: -o[1]
    )


MENU: Final = tuple(f"m{number:02d}" for number in range(1, 16))

EVERY: Final = 10
"""Of the simulation's samples at 100 Hz one in so many is kept."""

READ_S: Final = 2.0
"""Between two readings of a predicted thermocouple."""


def candidate_drive(
    name: str,
    config: Config,
    present: Mapping[int, int],
    couples: Mapping[str, Sequence[str]],
) -> tuple[Recording, str]:
    """Return the menu drive *name* as *config* predicts it, and what it is.

    Args:
        name: of a drive of the simulated car.
        config: the model.
        present: role number to timeout [us] of what this car's bus has.
        couples: thermocouples by corner.

    Raises:
        UsageError: no such drive.
    """
    simulated = simulate(load_drive(name), sensors="none", seed=0)
    events = samples_of(simulated, present)
    inputs, corners = inputs_of(config, present, Packed(events))
    start_s = float(events.time_us[0]) * 1e-6
    empty = Drive(name, start_s, corners, inputs, {})
    drive = replace(
        empty,
        measured={
            corner: _predicted(config, empty, corner, nodes)
            for corner, nodes in couples.items()
        },
    )
    thin = Packed(thinned(events))
    description = simulated.drive.drive.description.partition(": ")[2]
    return Recording(drive, present, thin, inputs), description


def samples_of(
    drive: SimulatedDrive,
    present: Mapping[int, int],
    *,
    temperatures: bool = False,
) -> Events:
    """Return what a simulated car's sensors say, in order of time.

    Roles of *present* only; thermocouples where *temperatures* are wanted.
    """
    bus = np.asarray(drive.bus_on)[::EVERY]
    time_s = drive.time_s[::EVERY][bus]
    parts = [
        (time_s, ROLE_INDEX[name], np.asarray(values)[::EVERY][bus])
        for name, values in drive.roles.items()
        if ROLE_INDEX[name] in present
    ]
    # a bus may sleep where the drive goes on
    parts.append((drive.slow_time_s, TICK, np.zeros(len(drive.slow_time_s))))
    if temperatures:
        on = np.interp(drive.slow_time_s, drive.time_s, drive.logger_on) > 0.5
        parts += [
            (drive.slow_time_s[on], ROLE_INDEX[name], values[on])
            for name, values in drive.temperatures.items()
            if ROLE_INDEX[name] in present
        ]
    stamps = np.concatenate(
        [np.rint(time * 1e6).astype(np.int64) for time, _, _ in parts]
    )
    order = np.argsort(stamps, kind="stable")
    roles = np.concatenate(
        [np.full(len(time), role, np.int32) for time, role, _ in parts]
    )
    values = np.concatenate([value for _, _, value in parts])
    return Events(stamps[order], roles[order], values[order])


def _predicted(
    config: Config, drive: Drive, corner: str, nodes: Sequence[str]
) -> dict[str, Thermocouple]:
    model = model_of(config, corner)
    result = march([compiled_model(model)], drive, corner)
    own = {node.name for node in model.network.nodes}
    every = round(READ_S / GRID_S)
    return {
        node: Thermocouple(drive.time_s[::every], shown[::every, 0])
        for node in nodes
        if node in own
        for lag_s in [model.lag_s.get(node, 0.0)]
        for shown in [lagged(result[node], lag_s, GRID_S)]
    }
