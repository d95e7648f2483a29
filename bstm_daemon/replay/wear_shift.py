"""How far worn linings and discs move the temperatures of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.start import PUBLISHED_NODES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from bstm_daemon.estimator.blocks import Block
    from bstm_daemon.estimator.estimator import Floats, Ints


class WearShift(NamedTuple):
    """Largest difference that following the wear made [K], and where."""

    kelvin: float
    corner: str
    node: str
    time_us: int


class WearComparison:
    """The estimate, and what following the wear changes in it.

    Where the model follows, a second estimator of the same car takes the same
    samples with linings and discs as configured. So the difference is exact,
    for one more estimate without a forecast.
    """

    def __init__(
        self,
        estimator: Estimator,
        present: Mapping[int, int],
        *,
        history_known: bool = False,
        initial_k: float | None = None,
    ) -> None:
        """Compare *estimator*; the others are its arguments."""
        self._estimator = estimator
        self.beside: list[Estimator] = []
        """The second one, where the model follows the wear."""
        self.shift: WearShift | None = None
        """The largest so far; None where the model does not follow."""
        config = estimator.config
        if config.wear.model_follows:
            still = config.wear.model_copy(update={"model_follows": False})
            self.beside = [
                Estimator(
                    config.model_copy(update={"wear": still}),
                    present,
                    history_known=history_known,
                    initial_k=initial_k,
                )
            ]

    def blocks(
        self, times_us: Ints, roles: Ints, values: Floats
    ) -> Iterator[Block]:
        """Yield the estimator's blocks of the samples, compared."""
        samples = times_us, roles, values
        compared = [one.blocks(*samples) for one in self.beside]
        for block, *configured in zip(
            self._estimator.blocks(*samples), *compared, strict=True
        ):
            for other in configured:
                self._compare(block, other)
            yield block

    def _compare(self, block: Block, configured: Block) -> None:
        for group, worn, still in zip(
            block.layout.groups, block.outputs, configured.outputs, strict=True
        ):
            moved = np.subtract(worn, still).reshape(
                len(block.times_us), len(group.corners), group.size
            )
            names = [n for n in PUBLISHED_NODES if n in group.state_names]
            moved = moved[:, :, [group.state_names.index(n) for n in names]]
            sizes = np.nan_to_num(np.abs(moved))
            i, corner, node = np.unravel_index(sizes.argmax(), sizes.shape)
            if self.shift is None or sizes.max() > abs(self.shift.kelvin):
                self.shift = WearShift(
                    float(moved[i, corner, node]),
                    group.corners[corner],
                    names[node],
                    block.times_us[i],
                )
