"""How the catalogue's effects compare to the reality's, which has others.

Each effect of the brake corner alone, at strength 1 in both: what it shifts
in the reality against what it shifts in the estimator's network, over a whole
drive with known heat. The forms differ on purpose; the direction must not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from physics import NODES, nodes_of
from side_by_side import Outcome, Table
from structures import example_car, known_heat

from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import effect_class, effect_names
from bstm_daemon.simulation import Effects, load_drive, simulate

if TYPE_CHECKING:
    from structures import Nodes

DRIVES = {
    "wet_disc": "m08",
    "pad_pyrolysis": "soak",
    "fluid_latent_heat": "soak",
}
"""Where an effect needs rain or a very hot brake; the others on ``rich``."""

QUICK = ("gap_conduction", "disc_hat", "pad_wear")


def run(*, full: bool) -> Outcome:
    """Switch each effect on in both and compare the shifts."""
    plain: dict[str, tuple[Nodes, Nodes]] = {}
    rows = []
    for name in effect_names():
        if not _of_the_corner(name) or not (full or name in QUICK):
            continue
        drive = DRIVES.get(name, "rich")
        if drive not in plain:
            plain[drive] = _both(drive, None)
        rows.append((name, drive, *_compared(plain[drive], name, drive)))
    return Outcome(
        "Effects",
        "Shift of the front left brake's temperatures by each effect alone, "
        "strength 1 and typical parameters against the reality at strength "
        "1, known heat. Largest shift at the node that the reality shifts "
        "most; cosine of the shifts of disc, pad front, pad back and fluid "
        "over the whole drive, each at 1 Hz.",
        tables=[
            Table(
                "Reality against catalogue",
                (
                    *("effect", "drive", "node", "reality, K"),
                    *("catalogue, K", "cosine"),
                ),
                tuple(rows),
            )
        ],
    )


def _of_the_corner(name: str) -> bool:
    """Whether the reality has it, and as a path of heat."""
    known = hasattr(Effects(), name)
    return known and (
        effect_class(name).kind == "thermal" or name == "residual_drag"
    )


def _both(drive: str, name: str | None) -> tuple[Nodes, Nodes]:
    """Return the truth and the estimate with the effect *name*."""
    strength = {} if name is None else {name: 1.0}
    driven = simulate(load_drive(drive), preset=Effects(**strength))
    car = example_car("thesis")
    entries = [] if name is None else [EffectConfig(name=name)]
    car = car.model_copy(update={"effect": entries})
    return nodes_of(driven), known_heat(car, driven)


def _compared(
    plain: tuple[Nodes, Nodes], name: str, drive: str
) -> tuple[str, ...]:
    there = _both(drive, name)
    real, mine = (
        {node: one[node] - base[node] for node in NODES}
        for one, base in zip(there, plain, strict=True)
    )
    both = min(len(real["disc"]), len(mine["disc"]))
    a, b = (
        np.concatenate([one[node][:both] for node in NODES])
        for one in (real, mine)
    )
    cosine = float(a @ b / np.sqrt((a @ a) * (b @ b)))
    node = max(NODES, key=lambda n: float(np.abs(real[n]).max()))
    peaks = [one[node][np.abs(one[node]).argmax()] for one in (real, mine)]
    return (
        node,
        f"{peaks[0]:+.1f}",
        f"{peaks[1]:+.1f}",
        f"{cosine:.2f}",
    )
