"""The signature of every candidate: what it would change in the residuals.

A finite strength is simulated, not a derivative: many effects begin at a
threshold. Between and beyond the strengths simulated, a parabola through 0.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    LARGEST,
    either_sign,
    forms_of,
    is_change,
    largest,
    path_of,
    strength_of,
)
from bstm_daemon.analysis.gap.changes import STEP as STEP_OF_CHANGE
from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.unnamed import (
    SILENT_K,
    Unnamed,
    unnamed_heats,
    unnamed_readings,
)
from bstm_daemon.analysis.statistics.levenberg_marquardt import STEP
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.effects.catalogue import (
    effect_class,
    effect_names,
    effects_of,
)

NETWORK_STRENGTHS: Final[tuple[float, ...]] = (0.5, 1.5)
HEAT_STRENGTHS: Final[tuple[float, ...]] = (1.0,)
CHANGE_STRENGTHS: Final[tuple[float, ...]] = (-0.5, 0.5)
"""Strengths simulated; the heat needs a pass over all samples for each."""

OF_LITTLE: Final = 2.0
"""The second one of a change of a path that the model has: there may be
little of it, which says nothing of much."""

AT_ONCE: Final = 16
"""Changes marched side by side: more take memory, not less time."""

NO_FORM: Final[Mapping[str, float]] = MappingProxyType({})
"""That of an effect whose values are typical, or as the model has them."""


@dataclass(frozen=True, slots=True, eq=False)
class Signature:
    """Change of the residuals [K] with the strength a: ``a s1 + a^2 s2``.

    ``linear`` and ``curved`` (n,) are whitened; ``kelvin`` (n,) is the change
    at strength 1. Of a change since the match no sign is the typical one:
    ``even``. ``near`` is the strength that it is simulated about, ``most`` the
    largest that it can have, ``form_cost`` what choosing among the forms of
    the effect takes off the logarithm of its evidence.
    """

    name: str
    linear: Column
    curved: Column
    kelvin: Column
    either_sign: bool
    even: bool = False
    near: float = 1.0
    most: float = LARGEST
    form_cost: float = 0.0

    @property
    def column(self) -> Column:
        """The change for each unit of strength, (n,), near where it is."""
        return self.at(self.near) / self.near

    def at(self, strength: float) -> Column:
        """Return the change at *strength*, (n,)."""
        return np.asarray(strength * self.linear + strength**2 * self.curved)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Everything around the configured values, whitened.

    ``residual`` (n,), ``jacobian`` (n, p), signatures, the candidates that
    these drives do not excite, and heats and readings without a name.
    """

    residual: Column
    jacobian: Column
    signatures: tuple[Signature, ...]
    silent: tuple[str, ...]
    unknown: tuple[Unnamed, ...]
    readings: tuple[Unnamed, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """The same in kelvin, as simulated.

    ``base_k`` (n,) and ``jacobian_k`` (n, p); ``terms_k`` by effect the
    linear and the curved one, (2, n); heats without a name in kelvin;
    ``near`` what strengths are simulated about, where that is not 1.
    ``forms_k`` are the terms of the other forms of effects, in their order,
    ``form_costs`` what choosing one has cost.
    """

    base_k: Column
    jacobian_k: Column
    terms_k: Mapping[str, Column]
    silent: tuple[str, ...]
    unknown_k: tuple[Unnamed, ...]
    near: Mapping[str, float] = field(default_factory=dict)
    forms_k: Mapping[str, tuple[Column, ...]] = field(default_factory=dict)
    form_costs: Mapping[str, float] = field(default_factory=dict)

    def columns_k(self) -> Column:
        """Return all that could explain the residuals, (n, p + k)."""
        return np.column_stack(
            [
                self.jacobian_k,
                *(terms.sum(axis=0) for terms in self.terms_k.values()),
                *(one.change for one in self.unknown_k),
            ]
        )

    def without(self, names: Collection[str]) -> "Sensed":
        """Return it without the candidates *names*."""
        return replace(
            self,
            terms_k={n: k for n, k in self.terms_k.items() if n not in names},
            forms_k={n: k for n, k in self.forms_k.items() if n not in names},
        )

    def whitened(self, layout: Layout) -> Linearised:
        """Return it with unit covariance by the noise of *layout*."""
        return Linearised(
            layout.whiten(self.base_k),
            layout.whiten(self.jacobian_k),
            tuple(
                replace(
                    whitened_signature(
                        layout, name, terms, self.near.get(name, 1.0)
                    ),
                    form_cost=self.form_costs.get(name, 0.0),
                )
                for name, terms in self.terms_k.items()
            ),
            self.silent,
            *(
                tuple(
                    replace(one, change=layout.whiten(one.change))
                    for one in unnamed
                )
                for unnamed in (
                    self.unknown_k,
                    unnamed_readings(layout, self.base_k),
                )
            ),
        )


def candidates(config: Config) -> list[str]:
    """Return the effects that *config* does not have yet."""
    present = {one.name for one in effects_of(config) if strength_of(one)}
    return [name for name in effect_names() if name not in present]


def sensed(
    comparison: Comparison,
    names: Sequence[str],
    progress: Callable[[float], None] | None = None,
) -> Sensed:
    """Return residuals and sensitivities in kelvin at its start."""
    base, jacobian = _sensitivities_k(comparison, comparison.start)
    found, silent, forms = {}, [], {}
    values = _of_values_k(comparison, base)
    names = [*names, *comparison.trials]
    for number, name in enumerate(names):
        terms = (
            _parabola_k(*values[name])
            if name in values
            else _terms_k(comparison, name, base)
        )
        if terms is None:
            silent.append(name)
        else:
            found[name] = terms
            # those of a change are simulated where it is large
            forms[name] = tuple(
                np.zeros_like(terms) if other is None else other
                for form in (() if is_change(name) else forms_of(name))
                for other in [_terms_k(comparison, name, base, form=form)]
            )
        if progress is not None:
            progress((number + 1) / len(names))
    return Sensed(
        base,
        jacobian,
        found,
        tuple(silent),
        unnamed_heats(comparison, base),
        forms_k={name: terms for name, terms in forms.items() if terms},
    )


def of_large_change(
    comparison: Comparison, base_k: Column, name: str, strength: float
) -> list[tuple[Mapping[str, float], Column]]:
    """Return each form of the change *name*, and its terms, simulated there.

    A parabola through small changes says little of large ones; and of what
    the model has little of, its form matters once there is much. None where
    its bound leaves no room for more. Residuals without it are *base_k* (n,).
    """
    found: list[tuple[Mapping[str, float], Column]] = []
    for form in (NO_FORM, *forms_of(name, comparison.keys)):
        strengths = (0.5 * strength, strength)
        terms = _terms_k(comparison, name, base_k, strengths, form)
        if terms is None:
            return found
        found.append((form, terms))
    return found


def sensitivities(
    comparison: Comparison, x: Column, effects: Sequence[EffectConfig] = ()
) -> tuple[Column, Column]:
    """Return residuals [K] (n,) and the whitened jacobian (n, p) at *x*."""
    apart, jacobian = _sensitivities_k(comparison, x, effects)
    return apart, comparison.whiten(jacobian)


def signature_of(
    comparison: Comparison,
    name: str,
    base: Column,
    strengths: tuple[float, ...] = (),
) -> Signature | None:
    """Return what *name* changes in the residuals *base* [K], (n,).

    Simulated at *strengths*, or the usual ones. None where it changes nothing
    or does not fit the structure.
    """
    terms = _terms_k(comparison, name, base, strengths)
    if terms is None:
        return None
    return whitened_signature(comparison, name, terms)


def whitened_signature(
    layout: Layout, name: str, terms: Column, near: float = 1.0
) -> Signature:
    """Return the signature of *name* by its *terms* [K], (2, n).

    A change is not as large as it can be unless it is simulated *near* there:
    far from where it is, the parabola turns back.
    """
    simulated = not is_change(name) or near != 1.0
    return Signature(
        name,
        layout.whiten(terms[0]),
        layout.whiten(terms[1]),
        terms.sum(axis=0),
        either_sign(name),
        is_change(name),
        near,
        most=largest(name) if simulated else LARGEST,
    )


def _sensitivities_k(
    comparison: Comparison, x: Column, effects: Sequence[EffectConfig] = ()
) -> tuple[Column, Column]:
    steps = np.where(x + STEP <= comparison.upper, STEP, -STEP)
    points = np.vstack((x, x + np.diag(steps)))
    apart = comparison.residuals_k(points, effects)
    return apart[:, 0], (apart[:, 1:] - apart[:, :1]) / steps


def _of_values_k(
    comparison: Comparison, base: Column
) -> dict[str, tuple[tuple[float, ...], Column]]:
    """Return strengths of changes of values, and what each does, (2, n) [K].

    They are marched at once.
    """
    start, trials = comparison.start, comparison.trials
    own = {
        name: _change_strengths(comparison, name)
        for name, one in trials.items()
        if not one.effects
    }
    points = [
        comparison.placed(start, {name: strength})[0]
        for name, strengths in own.items()
        for strength in strengths
    ]
    changes: list[Column] = []
    for first in range(0, len(points), AT_ONCE):
        some = np.array(points[first : first + AT_ONCE])
        apart = comparison.residuals_k(some, each_settles=True)
        changes += list((apart - base[:, None]).T)
    step = len(CHANGE_STRENGTHS)
    return {
        name: (strengths, np.array(changes[i * step : (i + 1) * step]))
        for i, (name, strengths) in enumerate(own.items())
    }


def _change_strengths(comparison: Comparison, name: str) -> tuple[float, ...]:
    """Return the strengths at which the change *name* is simulated at first.

    That of a path no further than the effect can go.
    """
    if not path_of(name):
        return CHANGE_STRENGTHS
    direction = comparison.trials[name].direction
    moved = direction > 0.0
    room = (comparison.upper - comparison.start)[moved] / direction[moved]
    less, more = CHANGE_STRENGTHS
    return less, max(more, min(OF_LITTLE, float(room.min())))


def _terms_k(
    comparison: Comparison,
    name: str,
    base: Column,
    strengths: tuple[float, ...] = (),
    form: Mapping[str, float] = NO_FORM,
) -> Column | None:
    trial = comparison.trials.get(name)
    scaled = not strengths and trial is not None and bool(trial.effects)
    strengths = strengths or _strengths(name)
    changes = []
    for strength in strengths[-1:] if scaled else strengths:
        x, effects = comparison.placed(
            comparison.start, {name: strength}, {name: form}
        )
        try:
            apart = comparison.residuals_k(x[None], effects)
        except ConfigError:
            # it does not fit this structure
            return None
        changes.append(apart[:, 0] - base)
    if scaled:
        # a pass for each would double the time of the search: the heat is
        # nearly linear in the effect's strength, of which a is the logarithm
        factor = np.expm1(STEP_OF_CHANGE * np.array(strengths))
        changes = [changes[0] * one / factor[-1] for one in factor]
    return _parabola_k(strengths, changes)


def _parabola_k(
    strengths: Sequence[float], changes: Sequence[Column] | Column
) -> Column | None:
    """Return the terms through *changes* [K] and 0, None where they are."""
    if max(float(np.abs(one).max()) for one in changes) < SILENT_K:
        return None
    a = np.array(strengths)
    matrix = np.column_stack((a, a**2))[:, : len(a)]
    terms = np.linalg.lstsq(matrix, np.array(changes), rcond=None)[0]
    curved = terms[1] if len(a) > 1 else 0.0 * terms[0]
    return np.array((terms[0], curved))


def _strengths(name: str) -> tuple[float, ...]:
    """Return the strengths at which *name* is simulated at first."""
    if is_change(name):
        return CHANGE_STRENGTHS
    on_heat = effect_class(name).kind == "heat"
    return HEAT_STRENGTHS if on_heat else NETWORK_STRENGTHS
