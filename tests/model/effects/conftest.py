"""A corner with and without an effect, marched on one drive."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import compile_network
from bstm_daemon.native.loader import load_kernel

from ...energy_ledger import Ledger, read_ledger  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

INPUTS = (
    *("speed_ms", "brake_on", "ambient_k", "brake_power_w", "pressure_pa"),
    "wetness",
)
DT_S = 0.25


class Corner:
    """One corner that can be driven phase by phase."""

    def __init__(
        self, spec: CornerSpec, kernel: Kernel | None, model: CornerModel
    ) -> None:
        """Build *model* at ambient temperature."""
        self.spec = spec
        self.program = compile_network(model.network)
        self.batch = Batch([self.program], 283.15, kernel=kernel)
        self.start = self.batch.state[:]

    def drive(
        self,
        seconds: float,
        power_w: float = 0.0,
        speed_ms: float = 10.0,
        wetness: float = 0.0,
        pressure_pa: float | None = None,
    ) -> Corner:
        """Drive on; the brake is on while there is power or pressure."""
        if pressure_pa is None:
            pressure_pa = 0.75e6 if power_w else 0.0
        row = (
            *(speed_ms, float(pressure_pa > 0.0), 283.15, power_w),
            *(pressure_pa, wetness),
        )
        steps = round(seconds / DT_S)
        self.batch.march(array("d", row * steps), steps, DT_S)
        return self

    def warm(self, **temperatures_k: float) -> Corner:
        """Put nodes at temperatures; the ledger starts anew from there."""
        for name, temperature in temperatures_k.items():
            index = self.program.state_names.index(name)
            self.batch.state[index] = temperature
        self.start = self.batch.state[:]
        return self

    def __getitem__(self, name: str) -> float:
        """Return a node [K] or a memory."""
        return self.batch.state[self.program.state_names.index(name)]

    def nodes(self) -> dict[str, float]:
        """Return all temperatures [K]."""
        count = len(self.program.network.nodes)
        names = self.program.state_names[:count]
        return dict(zip(names, self.batch.state, strict=False))

    def ledger(self) -> Ledger:
        """Return the energies since the start."""
        return read_ledger(
            self.program, self.batch.ledger, self.start, self.batch.state
        )


@pytest.fixture(scope="session")
def corner(make_spec: Callable[..., CornerSpec]) -> Callable[..., Corner]:
    """Return the maker of corners: (effect or None, parameters)."""
    kernel = load_kernel()

    def make(
        name: str | None,
        *,
        from_pressure: bool = True,
        thermal: dict[str, Any] | None = None,
        **parameters: float,
    ) -> Corner:
        spec = make_spec(thermal=thermal or {})
        model = CornerModel(spec, build_corner(spec, INPUTS), from_pressure)
        if name is not None:
            model = effect_class(name)(parameters).apply(model)
        return Corner(spec, kernel, model)

    return make
