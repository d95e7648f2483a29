"""Sends frames at once or not at all, and never beside another sender."""

from collections.abc import Iterable, Sequence
from typing import Final

from bstm_daemon.bus.live.link import Link, SendResult
from bstm_daemon.bus.output.publication import OutputFrame, Publication
from bstm_daemon.engine import Published

NO_ID: Final = -1


class Sender:
    """Sends what the engine publishes on one link.

    Nothing is queued: a frame that the driver does not take is lost and
    counted, the next publication has newer values. After a stall only the
    newest frame of each name goes out. The end-to-end counters count what
    goes out, so that a receiver sees no gap where nothing was lost on the bus.
    """

    def __init__(
        self,
        link: Link | None,
        own_ids: frozenset[int],
        publication: Publication,
    ) -> None:
        """Send what *publication* made on *link*; with None only listen."""
        self._link = link
        self._own_ids = own_ids
        self._publication = publication
        self.foreign_id = NO_ID
        """The first of our ids that another node sent; sending has ended."""
        self.sent = 0
        self.lost = 0

    @property
    def is_sending(self) -> bool:
        """Whether frames go out."""
        return self._link is not None and self.foreign_id == NO_ID

    def is_own(self, can_id: int, *, extended: bool) -> bool:
        """Whether a received frame has an id reserved for this service."""
        return not extended and can_id in self._own_ids

    def note_foreign(self, can_id: int) -> bool:
        """Stop sending because of *can_id*; return whether this is new."""
        is_first = self.foreign_id == NO_ID
        if is_first:
            self.foreign_id = can_id
        return is_first

    def publish(self, published: Sequence[Published]) -> None:
        """Send the newest frame of each name of *published*."""
        self.leave_out(published)
        if published and self.is_sending:
            newest = {item.frame.name: item.frame for item in published}
            self.send(map(self._publication.numbered, newest.values()))

    def leave_out(self, published: Sequence[Published]) -> None:
        """Do not send *published*, which is outdated."""
        self._publication.take_back(item.frame.name for item in published)

    def send(self, frames: Iterable[OutputFrame]) -> None:
        """Send *frames* unless sending has ended."""
        if self._link is None or not self.is_sending:
            return
        for frame in frames:
            result = self._link.send(frame.can_id, frame.extended, frame.data)
            if result is SendResult.OK:
                self.sent += 1
            else:
                self.lost += 1
                self._publication.take_back([frame.name])
