"""The sections that only the live service reads, and protected inputs."""

from typing import Annotated, Final, Literal

from pydantic import Field

from bstm_daemon.config.section import Positive, Section, Text, require

DataId = Annotated[int, Field(ge=0, le=0xFFFF)]

PUBLISHED_IDS: Final = 20
"""Ids from ``[publish] id_base`` on that belong to the daemon."""


class PublishConfig(Section):
    """``[publish]``: frames out; nothing is sent unless ``enabled``."""

    enabled: bool = False
    """send frames; without it the daemon only listens"""
    bus: str | None = None
    """a `[[bus]]`; without it the first"""
    id_base: Annotated[int, Field(ge=0, le=0x800 - PUBLISHED_IDS)] = 0x5B0
    """first of the daemon's 20 standard ids; default 0x5B0"""
    requests: bool = False
    """also send advice and requests to other controllers"""


class E2eConfig(Section):
    """``[[e2e]]``: end-to-end protection of a received message.

    Profile 2: ``data_ids``, one per counter value, CRC in byte 0, counter in
    the low nibble of byte 1. Profile 5: ``data_ids`` has one entry, the CRC
    lies at ``offset_bytes``, the counter behind it (AUTOSAR PRS E2E).
    ``max_delta`` is how far the counter may move on from frame to frame.
    """

    message: Text
    """DBC message that is protected"""
    profile: Literal[2, 5]
    """profile of AUTOSAR E2E"""
    data_ids: list[DataId]
    """profile 2: DataIDList, 16 of 0 to 255; profile 5: one DataID"""
    bus: str | None = None
    """a `[[bus]]`; without it the first"""
    offset_bytes: Annotated[int, Field(ge=0, le=61)] = 0
    """profile 5: where the CRC begins"""
    max_delta: Annotated[int, Field(ge=1, le=14)] = 3
    """MaxDeltaCounter, largest step of the counter; 1 = no frame may be
    lost"""

    def _check(self) -> None:
        needed = 16 if self.profile == 2 else 1
        require(
            len(self.data_ids) == needed,
            f"'data_ids' of profile {self.profile} are {needed}, "
            f"{len(self.data_ids)} given",
        )
        if self.profile == 2:
            require(
                max(self.data_ids) <= 0xFF,
                "'data_ids' of profile 2 are bytes, 0 to 255",
            )
            require(
                self.offset_bytes == 0,
                "'offset_bytes' is for profile 5; profile 2 begins at 0",
            )


class StateConfig(Section):
    """``[state]``: the file that carries the brakes over a restart."""

    file: Text | None = None
    """path; without it `<vehicle id>.state` in `$STATE_DIRECTORY`, else in
    `$XDG_STATE_HOME/bstm` (`~/.local/state/bstm`)"""
    interval_s: Annotated[float, Field(ge=0.1, le=3600)] = 10.0
    """saved so often while a node moves by more than 1 K/min"""
    idle_interval_s: Annotated[float, Field(ge=0.1, le=86400)] = 300.0
    """saved so often otherwise"""
    trust_wall_clock: bool = False
    """over a power cut the brakes cool by the wall clock if it is synchronised
    (NTP, PTP); `true`: always, as a battery keeps it"""


class DaemonConfig(Section):
    """``[daemon]``: the loop of the live service."""

    drain_s: Annotated[float, Field(ge=0.001, le=0.1)] = 0.1
    """the buses are read so often"""
    reopen_s: Annotated[float, Field(ge=0.05, le=60)] = 1.0
    """a missing interface is looked for so often"""
    receive_buffer_bytes: Annotated[int, Field(ge=4096, le=10**8)] = 2**22
    """kernel buffer for each bus; at most `net.core.rmem_max`, the result is
    logged"""


class RecordConfig(Section):
    """``[record]``: a ring of the wanted frames, candump ``.log.gz``.

    Kept aside is what lies around a risk, a disagreement or a request.
    """

    enabled: bool = False
    """record"""
    folder: Text | None = None
    """path; without it `record` beside the state file"""
    segment_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    """time in one file"""
    ring_bytes: Annotated[int, Field(ge=2**16)] = 64 * 2**20
    """size of the ring"""
    kept_bytes: Annotated[int, Field(ge=2**16)] = 256 * 2**20
    """size of all that is kept aside"""
    before_s: Positive = 600.0
    """what is kept aside reaches back so far"""
    after_s: Positive = 600.0
    """and goes on so long"""


class FeedConfig(Section):
    """``[feed]``: publications as JSON lines, for the service's group."""

    socket: Text | None = None
    """path of the socket, such as `/run/bstm/feed.sock`; without it no feed"""


class MetricsConfig(Section):
    """``[metrics]``: a text file for node_exporter's textfile collector."""

    enabled: bool = False
    """write it"""
    file: Text | None = None
    """path; without it `bstm.prom` in `$RUNTIME_DIRECTORY`, if that is set"""
    interval_s: Annotated[float, Field(ge=0.5, le=3600)] = 10.0
    """written so often"""
