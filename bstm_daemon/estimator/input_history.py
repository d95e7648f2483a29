"""Averaged inputs of the thermal models since a given time."""

from __future__ import annotations

from array import array


class InputHistory:
    """Means of step rows over a few steps each."""

    def __init__(self, width: int, steps: int) -> None:
        """Take rows of *width* numbers and keep the mean of each *steps*."""
        self._width = width
        self._limit = steps
        self._sums = [0.0] * width
        self._steps = 0
        self._rows: list[tuple[int, array[float]]] = []

    def add(self, rows: memoryview, steps: int) -> None:
        """Take *steps* rows, [steps, width] flat."""
        wide = self._width
        for step in range(steps):
            row = rows[step * wide : (step + 1) * wide]
            self._sums = [a + b for a, b in zip(self._sums, row, strict=True)]
            self._steps += 1
            if self._steps == self._limit:
                self._close()

    def closed(self) -> list[tuple[int, array[float]]]:
        """Return steps and their mean row, oldest first."""
        if self._steps:
            self._close()
        return self._rows

    def _close(self) -> None:
        means = array("d", [total / self._steps for total in self._sums])
        self._rows.append((self._steps, means))
        self._sums = [0.0] * self._width
        self._steps = 0
