"""Builds the parts of the service from a configuration: car, buses, engine."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bstm_daemon.bus.live.link import Link, Wanted
from bstm_daemon.bus.live.socketcan import SocketcanLink
from bstm_daemon.bus.output.layout import own_ids
from bstm_daemon.bus.signals.signal_map import (
    SignalMap,
    compile_signal_map,
    log_defects,
)
from bstm_daemon.config.reading import load_config, naming_file
from bstm_daemon.config.sections import BusConfig, Config
from bstm_daemon.engine import Engine
from bstm_daemon.errors import BstmError, ConfigError, require_packages

SOCKETCAN: Final = "socketcan"

BUILD_LIMIT_US: Final = 60_000_000
"""A configuration that takes longer to build is refused."""


@dataclass(frozen=True, slots=True)
class BusOverride:
    """Another interface for the first bus, from the command line."""

    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    fd: bool | None = None

    def applied(self, config: Config) -> Config:
        """Return *config* with its first bus changed.

        Raises:
            ConfigError: there is no bus to change.
        """
        changes = {
            key: value
            for key in ("interface", "channel", "bitrate", "fd")
            if (value := getattr(self, key)) is not None
        }
        if not changes:
            return config
        first = config.bus[0].model_copy(update=changes)
        return config.model_copy(update={"bus": [first, *config.bus[1:]]})


@dataclass(frozen=True, slots=True)
class Monitor:
    """One car as configured, ready to run.

    ``publish_bus`` is the number of the bus that frames are sent on, None
    while the service only listens; ``own_ids`` are theirs.
    """

    path: Path
    config: Config
    signal_map: SignalMap
    engine: Engine
    publish_bus: int | None
    own_ids: frozenset[int]

    def links(self) -> list[Link]:
        """Return one link per bus, none opened.

        Raises:
            ConfigError: an interface that can not be.
        """
        return [
            _link(
                bus,
                self.wanted(number),
                self.config.daemon.receive_buffer_bytes,
            )
            for number, bus in enumerate(self.config.bus)
        ]

    def wanted(self, bus: int) -> Wanted:
        """Return the (id, extended) that bus number *bus* is read for.

        On the bus we send on, our own ids too: another sender of them must
        be noticed.
        """
        wanted = self.signal_map.wanted(bus)
        if bus == self.publish_bus:
            wanted |= {(can_id, False) for can_id in self.own_ids}
        return wanted


class MonitorBuild:
    """A monitor that is being built on a thread, so that the loop goes on."""

    def __init__(self, build: Callable[[], Monitor], now_us: int) -> None:
        """Begin to *build* at *now_us*.

        Raises:
            RuntimeError: there can be no more threads.
        """
        self._until_us = now_us + BUILD_LIMIT_US
        self._built: Monitor | Exception = ConfigError(["building it ended"])
        # a daemon thread: one that never ends does not keep the process
        self._thread = threading.Thread(
            target=self._run, args=(build,), name="build", daemon=True
        )
        self._thread.start()

    def outcome(self, now_us: int) -> Monitor | None:
        """Return the monitor, None while it is being built.

        Raises:
            Exception: whatever ended the building.
            ConfigError: it takes too long.
        """
        if self._thread.is_alive():
            if now_us < self._until_us:
                return None
            limit_s = BUILD_LIMIT_US // 1_000_000
            msg = f"takes longer than {limit_s} s to build, make it smaller"
            raise ConfigError([msg])
        if isinstance(self._built, Exception):
            raise self._built
        return self._built

    def _run(self, build: Callable[[], Monitor]) -> None:
        try:
            self._built = build()
        except Exception as error:  # noqa: BLE001  (raised by outcome)
            self._built = error


@contextmanager
def refusing(path: Path) -> Iterator[None]:
    """Let every failure inside be an error with a message for the user.

    A file can be wrong in ways that no check foresees: it must end neither a
    running service nor a start with a traceback.

    Raises:
        BstmError: as it was raised inside.
        ConfigError: anything else was.
    """
    try:
        yield
    except BstmError:
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__} {error}".split())
        problem = f"{path}: cannot be used: {reason}"
        raise ConfigError([problem]) from error


def build_monitor(
    path: Path, override: BusOverride, *, forecast: bool = True
) -> Monitor:
    """Read the configuration *path* and build everything it asks for.

    Raises:
        FileAccessError: it can not be read.
        ConfigError: a problem of it, of a DBC or of an effect, or that it
            can not be built for any other reason.
        MissingExtraError: it asks for metrics, prometheus-client is absent.
    """
    with refusing(path):
        return _build_monitor(path, override, forecast=forecast)


def _build_monitor(
    path: Path, override: BusOverride, *, forecast: bool
) -> Monitor:
    config = override.applied(load_config(path))
    if config.metrics.enabled:
        purpose = "[metrics] enabled = true"
        require_packages("prometheus-client", extra="metrics", purpose=purpose)
    with naming_file(path):
        if not config.bus:
            problem = "[[bus]]: none, a live service needs one"
            raise ConfigError([problem])
        signal_map = compile_signal_map(
            config.bus,
            config.signals,
            path.parent,
            config.vehicle.wheel_radius_m,
            e2e=config.e2e,
        )
        log_defects(signal_map)
        number: int | None = None
        ids: frozenset[int] = frozenset()
        if config.publish.enabled:
            number, id_base = config.publishing_bus, config.publish.id_base
            names = [corner.name for corner in config.corner]
            ids = frozenset(own_ids(id_base, names))
            if taken := signal_map.taken_ids(number, id_base):
                raise ConfigError(taken)
        engine = Engine(config, signal_map, forecast=forecast)
    return Monitor(path, config, signal_map, engine, number, ids)


def _link(bus: BusConfig, wanted: Wanted, buffer_bytes: int) -> Link:
    if bus.interface == SOCKETCAN:
        return SocketcanLink(bus, wanted, buffer_bytes)
    # python-can is loaded for other adapters only
    from bstm_daemon.bus.live.portable import PortableLink  # noqa: PLC0415

    return PortableLink(bus, wanted)
