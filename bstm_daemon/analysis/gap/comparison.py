"""Model less measurement over recordings, whitened, with effects on trial.

What the thermocouples of one node show, in all corners that are alike, is one
series: their models err alike, so that counting them apart would count one
error several times.
"""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    HEAT_SCALE,
    is_change,
    path_of,
    strength_of,
    trials,
)
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.learned import known_covariance
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
    model_of,
)
from bstm_daemon.analysis.matching.problem import Series, series_of
from bstm_daemon.analysis.matching.thermocouples import lagged
from bstm_daemon.analysis.matching.tunables import TUNABLES, Target
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import LogError
from bstm_daemon.estimator.corner_model import compiled_model, corner_model
from bstm_daemon.model.effects.catalogue import edited_inputs, effect_class
from bstm_daemon.model.effects.composed import NAME as COMPOSED
from bstm_daemon.model.effects.composed import (
    PREFIX,
    bounded,
    is_composed,
    read,
)
from bstm_daemon.model.effects.effect import STRENGTH
from bstm_daemon.model.effects.model import CornerModel, corrections_by_role
from bstm_daemon.model.thermal.program import Program
from bstm_daemon.roles import ROLE_INDEX

POINT_S: Final = 10.0
MOST_POINTS: Final = 300
"""Of one node over one drive, and the least time between two."""

HEAT_SCALE_PRIOR: Final = 0.05
"""Standard deviation of its logarithm: what friction varies by from day to
day, and a pressure sensor's offset and gain."""


class Form(EffectConfig):
    """Values that an effect of this name has in another form."""

    def of(self, effect: EffectConfig) -> EffectConfig:
        """Return *effect* in this form, its other values kept."""
        return effect.model_copy(
            update={"parameters": effect.parameters | self.parameters}
        )


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """A configuration, and what a corner is by it."""

    config: Config
    model: CornerModel
    program: Program

    @classmethod
    def of(cls, config: Config, corner: str) -> "Lane":
        """Return the lane of *corner* by *config*."""
        model = model_of(config, corner)
        return cls(config, model, compiled_model(model))


class Comparison(Layout):
    """Residuals of a target on recordings.

    ``keys`` are the tunables, :data:`HEAT_SCALE` last, ``covariance`` (p, p)
    what is known of their logarithms, ``trials`` which changes of a matched
    target are asked for, ``form_k`` (n,) or 0 what is added to residuals,
    ``forms`` the values of effects whose form is not the typical one,
    ``sizes`` those of composed terms at strength 1.
    """

    def __init__(
        self,
        target: Target,
        recordings: Sequence[Recording],
        keys: Sequence[str],
        noise: Mapping[str, SensorNoise],
    ) -> None:
        """Take what is compared.

        Raises:
            LogError: the corners of *target* have no thermocouple.
        """
        self.target = target
        self.recordings = tuple(recordings)
        self.keys = (*keys, HEAT_SCALE)
        self.start = np.log(
            [*(target.value(TUNABLES[key]) for key in keys), 1.0]
        )
        bounds = [target.tunable(key).bounds() for key in keys]
        self.lower, self.upper = np.array([*bounds, (-0.7, 0.7)]).T
        self.covariance = np.zeros((len(self.keys), len(self.keys)))
        self.covariance[:-1, :-1] = known_covariance(target, keys)
        self.covariance[-1, -1] = HEAT_SCALE_PRIOR**2
        self.precision = np.linalg.inv(self.covariance)
        self.matched = target.config.matched_of(target.corners[0]) is not None
        self.form_k: Column | float = 0.0
        self.forms: dict[str, Mapping[str, float]] = {}
        self.trials = trials(target.config, self.keys) if self.matched else {}
        self.sizes: dict[str, float] = {}
        super().__init__(
            self._found_series(),
            noise,
            np.sqrt(np.diag(self.covariance)),
            [one.name for one in recordings],
        )

    def config(
        self, x: Column, effects: Sequence[EffectConfig] = ()
    ) -> Config:
        """Return the configuration at the tunables *x* with *effects*."""
        values = dict(
            zip(self.keys[:-1], np.exp(x[:-1]).tolist(), strict=True)
        )
        changed = self.target.changed(values).config
        return with_effects(changed, effects)

    def is_on_heat(self, name: str) -> bool:
        """Whether the candidate *name* is of what heats the brakes."""
        if is_change(name):
            return bool(self.trials[name].effects)
        return not is_composed(name) and effect_class(name).kind == "heat"

    def placed(
        self,
        x: Column,
        strengths: Mapping[str, float],
        forms: Mapping[str, Mapping[str, float]] | None = None,
    ) -> tuple[Column, list[EffectConfig]]:
        """Return *x* with the changes among *strengths*, and the effects.

        In *forms*, or in those that were found to fit best.
        """
        forms = self.forms if forms is None else forms
        effects: list[EffectConfig] = []
        terms = {}
        there = {
            text: size * strength_of(one)
            for one in self.target.config.effect
            if one.name == COMPOSED
            for text, size in one.parameters.items()
            if text != STRENGTH.name
        }
        for name, a in strengths.items():
            if is_composed(name):
                text = name.removeprefix(PREFIX)
                terms[text] = read(text, a * self.sizes[name]).within().size
                continue
            form = forms.get(name, {})
            if not is_change(name):
                parameters = {**form, "strength": a}
                effects.append(EffectConfig(name=name, parameters=parameters))
                continue
            x = x + a * self.trials[name].direction
            effects += self.trials[name].effects_at(a)
            if form:
                of = path_of(name)
                effects.append(Form(name=of, parameters=dict(form)))
        if terms:
            effects.append(
                EffectConfig(name=COMPOSED, parameters=bounded(there | terms))
            )
        return np.clip(x, self.lower, self.upper), effects

    def residuals_k(
        self,
        points: Column,
        effects: Sequence[EffectConfig] = (),
        *,
        each_settles: bool = False,
    ) -> Column:
        """Return model less measurement [K] at *points* (k, p), (n, k).

        The brake power is formed anew where *effects* act on it. What is not
        measured begins as it settles at the first point or, with
        *each_settles*, at each.
        """
        configs = [self.config(x, effects) for x in points]
        drives = self.drives(effects)
        scales = np.exp(points[:, -1])
        # all drives of a corner share them
        lanes = {
            corner: [Lane.of(config, corner) for config in configs]
            for corner in dict.fromkeys(corner for _, corner in self.pairs)
        }
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            jobs = {
                (number, corner): pool.submit(
                    self._shown,
                    *(drives[number], (number, corner), lanes[corner]),
                    *(scales, each_settles),
                )
                for number, corner in self.pairs
            }
            found = {pair: job.result() for pair, job in jobs.items()}
        return self.less_measured(configs[0], found)

    @property
    def pairs(self) -> list[tuple[int, str]]:
        """Number of each drive and corner that has a thermocouple."""
        return sorted(
            {(one.drive, c) for one in self.series for c, _ in one.couples}
        )

    def less_measured(
        self,
        config: Config,
        found: Mapping[tuple[int, str], Mapping[str, Column]],
    ) -> Column:
        """Return the residuals [K] (n, k) of what models show.

        *found* is :meth:`sampled` by pair; *config* says how its
        thermocouples read.
        """
        gains = {
            c: thermocouple_corrections(config, c) for c in self.target.corners
        }
        parts = []
        for one in self.series:
            corners = {corner for corner, _ in one.couples}
            model = np.mean(
                [found[one.drive, c][one.node] for c in corners], axis=0
            )
            gain, offset = np.mean(
                [gains[c].get(name, (1.0, 0.0)) for c, name in one.couples],
                axis=0,
            )
            # correct the model, not the measurement: scaling the noisy reading
            # would bias the gain
            parts.append((model - offset) / gain - one.measured_k[:, None])
        return np.asarray(
            np.concatenate(parts) + np.reshape(self.form_k, (-1, 1))
        )

    def drives(self, effects: Sequence[EffectConfig] = ()) -> list[Drive]:
        """Return the drives, heated with *effects* where these act on it."""
        if not any(heats(one, self.target.config) for one in effects):
            return [one.drive for one in self.recordings]
        config = with_effects(self.target.config, effects)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(
                pool.map(lambda one: one.heated_by(config), self.recordings)
            )

    def _shown(
        self,
        drive: Drive,
        pair: tuple[int, str],
        lanes: list[Lane],
        scales: Column,
        each_settles: bool,  # noqa: FBT001
    ) -> dict[str, Column]:
        """March the corner of *pair* over *drive*, see :meth:`sampled`."""
        corner = pair[1]
        found: dict[str, Column] = {}
        # lanes share their inputs, so each scale is a march of its own
        for scale in dict.fromkeys(scales.tolist()):
            places = np.flatnonzero(scales == scale)
            own = drive.with_power_times(scale)
            model = lanes[places[0]].model
            variants = [lanes[i].program for i in places]
            settle = variants[: None if each_settles else 1]
            begin = [initial_temperatures(p, own, corner) for p in settle]
            result = march(
                *(variants, own, corner, begin if each_settles else begin[0]),
                nodes=[one.node for one in self.series],
            )
            sampled = self.sampled(lanes[0].config, pair[0], model, result)
            for node, values in sampled.items():
                whole = (len(values), len(lanes))
                found.setdefault(node, np.empty(whole))[:, places] = values
        return found

    def sampled(
        self,
        config: Config,
        number: int,
        model: CornerModel,
        result: Mapping[str, Column],
    ) -> dict[str, Column]:
        """Return what thermocouples show of a march, by node, (n, k).

        At the points of the series of drive *number*; *result* is (steps, k)
        [K] by state of *model*.
        """
        late_s, late_share = edited_inputs(config).clock_late
        return {
            one.node: at_steps(
                lagged(
                    result[one.node],
                    model.lag_s.get(one.node, 0.0),
                    GRID_S,
                ),
                one.steps - (late_s + late_share * one.time_s) / GRID_S,
            )
            for one in self.series
            if one.drive == number
        }

    def _found_series(self) -> tuple[Series, ...]:
        corner = self.target.corner
        nodes = {
            node.name
            for node in corner_model(self.target.config, corner).network.nodes
        }
        found = []
        for index, recording in enumerate(self.recordings):
            drive = recording.drive
            by_node: dict[str, list[tuple[str, str]]] = {}
            for name in self.target.corners:
                for couple, node in drive.couples(name, nodes):
                    by_node.setdefault(node, []).append((name, couple))
            found += [
                one
                for node, couples in by_node.items()
                if (
                    one := series_of(
                        *(drive, index, node, couples),
                        point_s=POINT_S,
                        most_points=MOST_POINTS,
                    )
                )
            ]
        if not found:
            names = ", ".join(one.name for one in self.recordings)
            msg = (
                f"{names}: no measured temperature of "
                f"{', '.join(self.target.corners)}"
            )
            raise LogError(msg)
        return tuple(found)


def at_steps(values: Column, steps: Column) -> Column:
    """Return *values* (m, k) at fractional *steps* (n,), (n, k)."""
    steps = np.clip(steps, 0.0, len(values) - 1.0)
    first = np.minimum(steps.astype(np.intp), len(values) - 2)
    share = (steps - first)[:, None]
    return np.asarray(
        (1.0 - share) * values[first] + share * values[first + 1]
    )


def heats(effect: EffectConfig, config: Config) -> bool:
    """Whether *effect* changes what the pass over samples gives *config*."""
    if effect_class(effect.name).kind != "heat":
        return False
    on = with_effects(config, [effect])
    edited, plain = edited_inputs(on), edited_inputs(config)
    same_inputs = (
        edited.corrections == plain.corrections
        and edited.unpressed_share == plain.unpressed_share
        and edited.config.model_copy(update={"effect": []})
        == plain.config.model_copy(update={"effect": []})
    )
    return not same_inputs or any(
        corner_model(on, corner).friction
        != corner_model(config, corner).friction
        for corner in config.corner
    )


def with_effects(config: Config, effects: Sequence[EffectConfig]) -> Config:
    """Return *config* with *effects*, which replace their namesakes.

    A :class:`Form` replaces some of their values.
    """
    forms = {one.name: one for one in effects if isinstance(one, Form)}
    whole = [one for one in effects if not isinstance(one, Form)]
    names = {one.name for one in whole}
    kept = [
        forms[one.name].of(one) if one.name in forms else one
        for one in config.effect
        if one.name not in names
    ]
    return config.model_copy(update={"effect": [*kept, *whole]})


def thermocouple_corrections(
    config: Config, corner: str
) -> dict[str, tuple[float, float]]:
    """Return gain and offset by thermocouple of *corner*."""
    by_role = corrections_by_role(edited_inputs(config).corrections)
    prefix = f"temp_{corner.lower()}_"
    return {
        role.removeprefix(prefix): by_role[number]
        for role, number in ROLE_INDEX.items()
        if role.startswith(prefix) and number in by_role
    }
