"""The bridge to an MQTT broker: one retained message a brake, once a second.

paho keeps a message until the broker has confirmed it, and tries again with
longer and longer pauses. Topics and fields are in ``docs/connected.md``.
"""

import json
import socket
import ssl
import threading
import time
from collections.abc import Iterable
from typing import Any, Final
from urllib.parse import urlsplit

import structlog
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode

from bstm_daemon.config.section import Section, Text
from bstm_daemon.errors import FileAccessError, UsageError
from bstm_daemon.feed.reader import Record
from bstm_daemon.feed.vss import UNITS, WHEELS, branches

PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
BACK_OFF_S: Final = (0.25, 60.0)
"""Pause before the first and, doubled each time, later attempts: never longer
than the broker was away."""

MOST_KEPT: Final = 3000
"""Unconfirmed messages, those of ten minutes; later ones are given up."""

KEEP_ALIVE_S: Final = 15
END_S: Final = 2.0
"""Time for the last messages at the end."""

HERE: Final = ("localhost", "127.0.0.1", "::1")
_WILD: Final = str.maketrans("/+#", "___")


class MqttFile(Section):
    """The file of the bridge: broker and credentials.

    ``ca_file`` is the authority of the broker's certificate where the system
    does not know it; ``cert_file`` and ``key_file`` are our own.
    """

    broker: Text | None = None
    username: Text | None = None
    password: Text | None = None
    ca_file: Text | None = None
    cert_file: Text | None = None
    key_file: Text | None = None


def new_client(url: str, credentials: MqttFile) -> Client:
    """Return a client of the broker at *url*, which connects in a while.

    Raises:
        UsageError: no ``mqtt://`` or ``mqtts://`` address, or one that holds
            a password, or would send one in clear over a network.
        FileAccessError: a certificate can not be read.
    """
    parts = urlsplit(url)
    host = parts.hostname
    if parts.scheme not in PORTS or not host or parts.path not in {"", "/"}:
        msg = f"--broker {url}: must be mqtts://HOST[:PORT] or mqtt://..."
        raise UsageError(msg)
    if parts.username or parts.password:
        msg = "--broker: username and password belong into --credentials FILE"
        raise UsageError(msg)
    is_encrypted = parts.scheme == "mqtts"
    if credentials.password and not is_encrypted and host not in HERE:
        msg = f"--broker {url}: a password needs mqtts://"
        raise UsageError(msg)
    client = Client(CallbackAPIVersion.VERSION2)  # the broker names it
    if credentials.username is not None:
        client.username_pw_set(credentials.username, credentials.password)
    if is_encrypted:
        client.tls_set_context(_tls(credentials))
    client.max_queued_messages_set(MOST_KEPT)
    # any number is slept for, though paho's hint says a whole one
    client.reconnect_delay_set(*BACK_OFF_S)  # type: ignore[arg-type]
    try:
        port = parts.port or PORTS[parts.scheme]
    except ValueError as error:
        msg = f"--broker {url}: {error}"
        raise UsageError(msg) from error
    client.connect_async(host, port, KEEP_ALIVE_S)
    return client


def _tls(credentials: MqttFile) -> ssl.SSLContext:
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


class Bridge:
    """Publishes the records of one vehicle."""

    def __init__(
        self, client: Client, vehicle: str, discovery: str | None = None
    ) -> None:
        """Connect *client*.

        Args:
            client: not connected.
            vehicle: of the records, part of every topic.
            discovery: first part of Home Assistant's discovery topics; None
                for no discovery.
        """
        self._client = client
        self.vehicle = vehicle
        self._name = vehicle.translate(_WILD)
        self._discovery = discovery
        self._status = "online"
        self._log = structlog.get_logger()
        self.confirmed = self.given_up = self._kept = 0
        self._publishing = threading.Lock()
        self._newest: dict[str, str] = {}
        self._records = 0
        self._answered = False
        client.will_set(self.topic("status"), "offline", qos=1, retain=True)
        client.on_socket_open = _send_at_once
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.loop_start()

    @property
    def unconfirmed(self) -> int:
        """Messages that the broker has not confirmed yet."""
        return self._kept - self.confirmed

    def topic(self, branch: str) -> str:
        """Return the topic of a VSS *branch*, or of ``status``."""
        return f"bstm/{self._name}/{branch.replace('.', '/')}"

    def publish(self, record: Record) -> None:
        """Publish *record*, one message a branch."""
        with self._publishing:
            self._records += 1
            self._newest = {
                self.topic(branch): json.dumps(values)
                for branch, values in branches(record).items()
            }
            for topic, payload in self._newest.items():
                self._send(topic, payload)

    def report(self, status: str) -> None:
        """Publish *status* (online, silent) if it is another one."""
        if status != self._status:
            self._status = status
            self._send(self.topic("status"), status)

    def close(self) -> None:
        """Say goodbye; wait a little for what is not confirmed."""
        self.report("offline")
        end_s = time.monotonic() + END_S
        while time.monotonic() < end_s and self.unconfirmed:
            time.sleep(0.02)
        self._client.disconnect()
        self._client.loop_stop()

    def _send(self, topic: str, payload: str) -> None:
        sent = self._client.publish(topic, payload, qos=1, retain=True)
        if sent.rc == MQTTErrorCode.MQTT_ERR_QUEUE_SIZE:
            self.given_up += 1
        else:
            self._kept += 1

    def _on_publish(self, *_: Any) -> None:
        if self.unconfirmed == 1:
            self._retain_newest()
        self.confirmed += 1

    def _retain_newest(self) -> None:
        """Publish the last record again if an older one may have come later.

        What waited for the broker's answer is sent after what came while it
        answered.
        """
        overtaken = self._answered and self._records > 1
        self._answered, self._records = False, 0
        # a record that is being published is newer
        if overtaken and self._publishing.acquire(blocking=False):
            for topic, payload in self._newest.items():
                self._send(topic, payload)
            self._publishing.release()

    def _on_connect(
        self, _client: Client, _data: Any, _flags: Any, code: Any, _more: Any
    ) -> None:
        self._log.info("broker_answered", reason=str(code))
        if code.is_failure:
            return
        self._answered = True
        # the last will said offline
        self._send(self.topic("status"), self._status)
        if self._discovery is not None:
            for corner in WHEELS:
                self._announce(corner)

    def _on_disconnect(
        self, _client: Client, _data: Any, _flags: Any, code: Any, _more: Any
    ) -> None:
        self._log.info("broker_lost", reason=str(code))

    def _announce(self, corner: str) -> None:
        """Describe the sensors of *corner* to Home Assistant."""
        for leaf, unit in UNITS.items():
            name = f"bstm_{self._name}_{corner}_{leaf}"
            key = "".join(c if c.isalnum() else "_" for c in name)
            sensor = {
                "name": f"{corner} {leaf}",
                "unique_id": key,
                "state_topic": self.topic(WHEELS[corner]),
                "value_template": f"{{{{ value_json.{leaf} }}}}",
                "unit_of_measurement": unit,
                "availability_topic": self.topic("status"),
                "payload_available": "online",
                "expire_after": 30,
                "device": {
                    "identifiers": [f"bstm_{self._name}"],
                    "name": self.vehicle,
                },
            }
            topic = f"{self._discovery}/sensor/{key}/config"
            self._send(topic, json.dumps(sensor))


def _send_at_once(_client: Client, _data: Any, connection: Any) -> None:
    """Let no small message wait for the confirmation of the one before."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def run_bridge(
    feed: Iterable[Record | None],
    url: str,
    credentials: MqttFile,
    interval_s: float = 1.0,
    discovery: str | None = None,
) -> None:
    """Publish *feed* to its end; None in it is silence.

    Args:
        feed: the records, of one vehicle.
        url: the broker.
        credentials: user, password, certificates.
        interval_s: least time between two records that are published.
        discovery: as of :class:`Bridge`.

    Raises:
        UsageError: see :func:`new_client`.
        FileAccessError: a certificate can not be read.
    """
    client = new_client(url, credentials)  # wrong options end it here
    bridge: Bridge | None = None
    published_s = float("-inf")
    try:
        for record in feed:
            if record is None:
                if bridge is not None:
                    bridge.report("silent")
                continue
            if bridge is not None and record["vehicle"] != bridge.vehicle:
                bridge.close()
                bridge, published_s = None, float("-inf")
                client = new_client(url, credentials)
            if bridge is None:
                bridge = Bridge(client, record["vehicle"], discovery)
            bridge.report("online")
            # half a publication of jitter
            due_s = published_s + interval_s - 0.05
            if not published_s <= record["time_s"] < due_s:
                published_s = record["time_s"]
                bridge.publish(record)
    finally:
        if bridge is not None:
            bridge.close()
