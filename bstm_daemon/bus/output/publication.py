"""Publication of an estimate: encodes the frames that are due.

Nothing here sends, reads a clock or knows a socket: :class:`Publication`
turns an :class:`~bstm_daemon.estimate.Estimate` into bytes. Its only state
are the counters of the end-to-end protection, which a restart takes over.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from bstm_daemon.bus.output.e2e import COUNTER_COUNT, protect
from bstm_daemon.bus.output.layout import (
    ADVICE_SIGNALS,
    Frame,
    own_ids,
    published_frames,
)
from bstm_daemon.estimate import Estimate


class OutputFrame(NamedTuple):
    """A frame ready to send."""

    can_id: int
    extended: bool
    data: bytes
    name: str


class Publication:
    """The frames of one car; see ``docs/frames.md``."""

    def __init__(
        self,
        corners: Iterable[str],
        id_base: int,
        counters: Mapping[str, int] | None = None,
        *,
        requests: bool = False,
    ) -> None:
        """Publish frames from *id_base* on.

        Args:
            corners: names of all corners; one without an estimate is sent
                as not available.
            id_base: the first id.
            counters: the counter last sent by frame name, as
                :attr:`counters` gives it; a frame that it does not name
                starts anew, names that are not ours are ignored.
            requests: whether ``BSTM_Advice`` is sent; the id is ours anyway.

        Raises:
            ConfigError: the ids do not fit into 11 bits.
            ValueError: an unknown corner.
        """
        names = frozenset(corners)
        self._id_base = id_base
        self._frames = tuple(
            frame
            for frame in published_frames(names)
            if requests or frame.signals is not ADVICE_SIGNALS
        )
        self._by_name = {frame.name: frame for frame in self._frames}
        self.ids = own_ids(id_base, names)
        self._counters: dict[str, int] = {}
        self.continue_from(counters or {})

    def continue_from(self, counters: Mapping[str, int]) -> None:
        """Continue after *counters*, as :attr:`counters` gave them."""
        self._counters = {
            frame.name: counters.get(frame.name, -1) % COUNTER_COUNT
            for frame in self._frames
        }

    @property
    def counters(self) -> dict[str, int]:
        """The counter (0..15) last sent by frame name, for the state file."""
        return dict(self._counters)

    def take_back(self, names: Iterable[str]) -> None:
        """Count a frame of each of *names* as never sent."""
        for name in names:
            self._counters[name] = (self._counters[name] - 1) % COUNTER_COUNT

    def numbered(self, frame: OutputFrame) -> OutputFrame:
        """Return *frame*, which was taken back, with the next counter."""
        layout = self._by_name[frame.name]
        return frame._replace(data=self._protected(frame.data, layout))

    def due(self, time_us: int) -> tuple[str, ...]:
        """Return the names of the frames due at grid time *time_us*."""
        return tuple(
            frame.name for frame in self._frames if frame.is_due(time_us)
        )

    def encode(self, estimate: Estimate) -> list[OutputFrame]:
        """Return the frames due at the time of *estimate*, lowest id first.

        Never raises for a value: NaN is sent as not available, an infinity
        as an error, what is out of range as the end of the range.
        """
        return [
            self._output(frame, estimate)
            for frame in self._frames
            if frame.is_due(estimate.time_us)
        ]

    def encode_all(self, estimate: Estimate) -> list[OutputFrame]:
        """Return every frame once, due or not, lowest id first."""
        return [self._output(frame, estimate) for frame in self._frames]

    def _output(self, frame: Frame, estimate: Estimate) -> OutputFrame:
        return OutputFrame(
            can_id=self._id_base + frame.id_offset,
            extended=False,
            data=self._protected(frame.pack(estimate), frame),
            name=frame.name,
        )

    def _protected(self, data: bytes | bytearray, frame: Frame) -> bytes:
        counter = (self._counters[frame.name] + 1) % COUNTER_COUNT
        self._counters[frame.name] = counter
        return protect(data, counter, frame.data_ids)
