"""The bridge to an MQTT broker: one retained message a brake, once a second.

A message that the broker has not confirmed is sent again; while there is no
broker the newest ones wait. Topics and fields are in ``docs/connected.md``.
"""

from __future__ import annotations

import json
import socket
import ssl
import threading
import time
from collections import deque
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import urlsplit

import structlog
from paho.mqtt.client import Client, MQTTv311
from paho.mqtt.enums import CallbackAPIVersion

from bstm_daemon import __version__
from bstm_daemon.config.section import Section, Text, require
from bstm_daemon.errors import FileAccessError, UsageError
from bstm_daemon.feed.vss import TEMPERATURES, WHEELS, branches

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bstm_daemon.feed.reader import Record

SCHEMES: Final = {"mqtt": 1883, "mqtts": 8883}

BACK_OFF_S: Final = (0.25, 60.0)
"""Pause before the first and, doubled each time, later attempts: never longer
than the broker was away."""

MOST_WAITING: Final = 3000
"""Messages kept while there is no broker, ten minutes; older ones are lost."""

UNCONFIRMED: Final = 20
"""Messages sent before the broker confirms the first of them."""

KEEP_ALIVE_S: Final = 15
END_S: Final = 2.0
"""Time for the last messages at the end."""

_WILD: Final = str.maketrans("/+#", "___")


class MqttFile(Section):
    """The file of the bridge: broker and credentials, nobody else's to read.

    ``ca_file`` is that of the broker's certificate where the system's own
    authorities do not know it; ``cert_file`` and ``key_file`` are ours.
    """

    broker: Text | None = None
    username: Text | None = None
    password: Text | None = None
    ca_file: Text | None = None
    cert_file: Text | None = None
    key_file: Text | None = None

    def _check(self) -> None:
        require(
            self.password is None or self.username is not None,
            "'password' needs 'username'",
        )
        require(
            self.key_file is None or self.cert_file is not None,
            "'key_file' needs 'cert_file'",
        )


class Broker(NamedTuple):
    """Where the broker is."""

    host: str
    port: int
    is_encrypted: bool

    @classmethod
    def of(cls, url: str, credentials: MqttFile) -> Broker:
        """Return the broker at *url*.

        Raises:
            UsageError: it is no ``mqtt://`` or ``mqtts://`` address, holds a
                password, or would send one in clear over a network.
        """
        parts = urlsplit(url)
        try:
            port = parts.port or SCHEMES[parts.scheme]
        except (KeyError, ValueError) as error:
            msg = f"--broker {url}: must be mqtts://HOST[:PORT] or mqtt://..."
            raise UsageError(msg) from error
        if not parts.hostname or parts.path not in {"", "/"}:
            msg = f"--broker {url}: needs a host and nothing behind the port"
            raise UsageError(msg)
        if parts.username or parts.password:
            msg = (
                "--broker: every user of the computer sees the command line, "
                "put 'username' and 'password' into --credentials FILE"
            )
            raise UsageError(msg)
        broker = cls(parts.hostname, port, parts.scheme == "mqtts")
        if credentials.password and not (
            broker.is_encrypted or is_loopback(broker.host)
        ):
            msg = f"--broker {url}: a password needs mqtts://"
            raise UsageError(msg)
        return broker


def is_loopback(host: str) -> bool:
    """Return whether *host* is this computer."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Message(NamedTuple):
    """What is published, retained."""

    topic: str
    payload: str


class Bridge:
    """Publishes the records of a feed until it ends."""

    def __init__(
        self,
        url: str,
        credentials: MqttFile | None = None,
        *,
        prefix: str = "bstm",
        interval_s: float = 1.0,
        discovery: str | None = None,
    ) -> None:
        """Connect to nothing yet: the vehicle is in the first record.

        Args:
            url: the broker.
            credentials: user, password, certificates.
            prefix: first part of every topic.
            interval_s: least time between two records that are published.
            discovery: first part of Home Assistant's discovery topics; None
                for no discovery.

        Raises:
            UsageError: see :meth:`Broker.of`.
            FileAccessError: a certificate can not be read.
        """
        credentials = credentials or MqttFile()
        self._broker = Broker.of(url, credentials)
        self._credentials = credentials
        self._tls = _tls(credentials) if self._broker.is_encrypted else None
        self._prefix = prefix
        self._interval_s = interval_s
        self._discovery = discovery
        self._log = structlog.get_logger()
        self._waiting: deque[Message] = deque()
        self._news = threading.Condition()
        self._free = threading.Semaphore(UNCONFIRMED)
        self._sent = 0
        self._has_ended = False
        self._vehicle = ""
        self._record: Record = {}
        self._status = "online"
        self._client: Client | None = None
        self.confirmed = self.refused = 0
        """Messages that the broker took, and times that it did not take us."""
        self.lost = 0
        """Messages given up because too many were waiting."""

    @property
    def unconfirmed(self) -> int:
        """Messages that the broker has not confirmed yet."""
        with self._news:
            return len(self._waiting) + self._sent - self.confirmed

    def run(self, feed: Iterable[Record | None]) -> None:
        """Publish *feed* to its end; None in it is silence.

        Raises:
            UsageError: the feed changes to another vehicle.
        """
        published_s = float("-inf")
        try:
            for record in feed:
                if record is None:
                    self._report("silent")
                    continue
                self._record = record
                if self._client is None:
                    self._begin(record["vehicle"])
                elif record["vehicle"] != self._vehicle:
                    msg = "the feed is now of another vehicle: start again"
                    raise UsageError(msg)
                self._report("online")
                # half a publication of jitter
                due = published_s + self._interval_s - 0.05
                if not published_s <= record["time_s"] < due:
                    published_s = record["time_s"]
                    self._publish(record)
        finally:
            self._end()

    def topic(self, branch: str) -> str:
        """Return the topic of a VSS *branch*, or of ``status``."""
        vehicle = self._vehicle.translate(_WILD)
        return f"{self._prefix}/{vehicle}/{branch.replace('.', '/')}"

    def _begin(self, vehicle: str) -> None:
        self._vehicle = vehicle
        client = Client(
            CallbackAPIVersion.VERSION2,
            client_id=f"bstm-{vehicle.translate(_WILD)}",
            protocol=MQTTv311,
        )
        client.max_inflight_messages_set(UNCONFIRMED)
        # any number is slept for, though paho's hint says a whole one
        client.reconnect_delay_set(*BACK_OFF_S)  # type: ignore[arg-type]
        client.connect_timeout = 5.0
        client.will_set(self.topic("status"), "offline", qos=1, retain=True)
        if self._credentials.username is not None:
            client.username_pw_set(
                self._credentials.username, self._credentials.password
            )
        if self._tls is not None:
            client.tls_set_context(self._tls)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.on_socket_open = _send_at_once
        client.connect_async(
            self._broker.host, self._broker.port, KEEP_ALIVE_S
        )
        self._client = client
        threading.Thread(
            target=self._send, args=(client,), name="send", daemon=True
        ).start()
        client.loop_start()

    def _on_connect(
        self, _client: Client, _data: Any, _flags: Any, code: Any, _more: Any
    ) -> None:
        if code.is_failure:
            self.refused += 1
            self._log.warning("broker_refused", reason=str(code))
            return
        self._log.info("broker_connected", broker=self._broker.host)
        # before all that waits: the last will says offline
        self._put(
            [
                Message(self.topic("status"), self._status),
                *_discovery(self, self._discovery, self._record),
            ],
            first=True,
        )

    def _on_disconnect(
        self, _client: Client, _data: Any, _flags: Any, code: Any, _more: Any
    ) -> None:
        if not self._has_ended:
            self._log.warning("broker_lost", reason=str(code))

    def _on_publish(self, *_: Any) -> None:
        self.confirmed += 1
        self._free.release()

    def _report(self, status: str) -> None:
        if status != self._status and self._client is not None:
            self._status = status
            self._put([Message(self.topic("status"), status)])

    def _publish(self, record: Record) -> None:
        self._put(
            Message(self.topic(branch), json.dumps(values))
            for branch, values in branches(record).items()
        )

    def _put(
        self, messages: Iterable[Message], *, first: bool = False
    ) -> None:
        with self._news:
            if first:
                self._waiting.extendleft(reversed([*messages]))
            else:
                self._waiting.extend(messages)
            while len(self._waiting) > MOST_WAITING:
                self._waiting.popleft()
                self.lost += 1
            self._news.notify()

    def _send(self, client: Client) -> None:
        """Hand *client* what waits; what it has, it sends until confirmed."""
        while True:
            self._free.acquire()
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._has_ended)
                if not self._waiting:
                    return
                message = self._waiting.popleft()
                self._sent += 1
            client.publish(*message, qos=1, retain=True)

    def _end(self) -> None:
        if self._client is None:
            return
        self._status = "offline"
        self._put([Message(self.topic("status"), "offline")])
        self._has_ended = True
        end_s = time.monotonic() + END_S
        while time.monotonic() < end_s and self.unconfirmed:
            time.sleep(0.02)
        self._client.disconnect()
        self._client.loop_stop()


def _send_at_once(_client: Client, _data: Any, connection: Any) -> None:
    """Let no small message wait for the confirmation of the one before."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _tls(credentials: MqttFile) -> ssl.SSLContext:
    """Return what verifies the broker's certificate and shows ours.

    Raises:
        FileAccessError: a file is missing or no certificate.
    """
    try:
        context = ssl.create_default_context(cafile=credentials.ca_file)
        if credentials.cert_file is not None:
            context.load_cert_chain(
                credentials.cert_file, credentials.key_file
            )
    except OSError as error:
        msg = f"certificates of the bridge: {error}"
        raise FileAccessError(msg) from error
    return context


_UNITS: Final = {
    **dict.fromkeys(TEMPERATURES, "°C"),
    "BoilingMargin": "K",
    "VapourProbability": "%",
    "PadWear": "%",
    "RiskLevel": None,
}
"""Leaves that Home Assistant shows, with their units."""


def _discovery(
    bridge: Bridge, prefix: str | None, record: Record
) -> list[Message]:
    """Return the sensors of a record's corners for Home Assistant."""
    if prefix is None or not record:
        return []
    vehicle = record["vehicle"]
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in vehicle)
    found = []
    for corner in record["corners"]:
        for leaf, unit in _UNITS.items():
            key = f"bstm_{name}_{corner}_{leaf}"
            sensor = {
                "name": f"{corner} {leaf}",
                "unique_id": key,
                "state_topic": bridge.topic(WHEELS[corner]),
                "value_template": f"{{{{ value_json.{leaf} }}}}",
                "availability_topic": bridge.topic("status"),
                "payload_available": "online",
                "expire_after": 30,
                "device": {
                    "identifiers": [f"bstm_{name}"],
                    "name": vehicle,
                    "sw_version": __version__,
                },
                **({} if unit is None else {"unit_of_measurement": unit}),
            }
            topic = f"{prefix}/sensor/{key}/config"
            found.append(Message(topic, json.dumps(sensor)))
    return found
