"""The bridge against a real broker (mosquitto), that also dies and refuses."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from bstm_daemon.cli.main import main
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import FileAccessError, UsageError
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed import mqtt
from bstm_daemon.feed.mqtt import Bridge, MqttFile, new_client, run_bridge
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.feed.server import FeedServer

MOSQUITTO = shutil.which(
    "mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin"
)
LIMIT_S = 60.0
TOPIC = "bstm/example-vehicle/Vehicle/Chassis/Axle/Row1/Wheel/Left/Brake"
STATUS = "bstm/example-vehicle/status"

Make = Callable[[int], Estimate]


def wait_for(condition: Callable[[], Any], what: str) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, what
        time.sleep(0.005)


class Mosquitto:
    """A broker of its own, that keeps sessions over a kill."""

    def __init__(self, folder: Path, *more: str) -> None:
        if MOSQUITTO is None:
            pytest.skip("mosquitto is not installed: no broker to publish to")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._file = folder / "mosquitto.conf"
        self._folder = folder
        self.configure(*more)
        self._process: subprocess.Popen[bytes] | None = None

    def configure(self, *more: str) -> None:
        lines = [
            f"listener {self.port} 127.0.0.1",
            "allow_anonymous true",
            "user root",
            "max_queued_messages 0",
            "max_inflight_messages 0",
            "persistence true",
            f"persistence_location {self._folder}/",
            *more,
        ]
        self._file.write_text("\n".join(lines) + "\n")

    def start(self) -> None:
        assert MOSQUITTO is not None
        self._process = subprocess.Popen(
            [MOSQUITTO, "-c", self._file], stderr=subprocess.DEVNULL
        )
        wait_for(self._answers, "the broker does not start")

    def _save(self) -> None:
        """Let the broker write its sessions down, as it does at times."""
        assert self._process is not None
        database = self._folder / "mosquitto.db"
        database.unlink(missing_ok=True)
        self._process.send_signal(signal.SIGUSR1)
        wait_for(database.exists, "the broker does not save")

    def _answers(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def stop(self, *, kill: bool = False) -> None:
        if self._process is not None:
            if kill:
                self._save()
                self._process.kill()
            else:
                self._process.terminate()
            self._process.wait()
            self._process = None


class Subscriber:
    """Takes every message, over restarts of the broker too."""

    def __init__(self, port: int, **login: str) -> None:
        self.heard: list[tuple[str, Any, bool]] = []
        self.client = Client(
            CallbackAPIVersion.VERSION2, "subscriber", clean_session=False
        )
        if login:
            self.client.username_pw_set(**login)
        self.client.reconnect_delay_set(0.05, 0.1)  # type: ignore[arg-type]
        self.client.on_connect = lambda client, *_: client.subscribe("#", 1)
        ready = threading.Event()
        self.client.on_subscribe = lambda *_: ready.set()
        self.client.on_message = lambda _, __, one: self.heard.append(
            (one.topic, one.payload.decode(), one.retain)
        )
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        assert ready.wait(LIMIT_S)

    def of(self, topic: str) -> list[Any]:
        return [payload for name, payload, _ in [*self.heard] if name == topic]

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path)
    made.start()
    yield made
    made.stop()


class Feed:
    """Records that the test adds, one by one, until it ends them."""

    def __init__(self, config: Config, make: Make) -> None:
        self._writer = RecordWriter(config)
        self._make = make
        self._items: list[Any] = []
        self._news = threading.Condition()
        self.count = 0

    def add(self, *, silence: bool = False) -> None:
        record = None
        if not silence:
            record = json.loads(self._writer.line(self._make(self.count)))
            self.count += 1
        with self._news:
            self._items.append(record)
            self._news.notify()

    def end(self) -> None:
        with self._news:
            self._items.append(StopIteration)
            self._news.notify()

    def __iter__(self) -> Iterator[Any]:
        """Yield what was added, as it comes."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._items)
                item = self._items.pop(0)
            if item is StopIteration:
                return
            yield item


@pytest.fixture
def feed(config: Config, estimate: Make) -> Feed:
    return Feed(config, estimate)


class Running:
    """A bridge at work on a thread, once a record has come."""

    def __init__(
        self, feed: Feed, url: str, login: MqttFile, **options: Any
    ) -> None:
        self._made: list[Bridge] = []
        self._feed = feed
        made = self._made

        class Kept(Bridge):
            def __init__(self, *args: Any) -> None:
                made.append(self)
                super().__init__(*args)

        def work() -> None:
            with mock.patch.object(mqtt, "Bridge", Kept):
                run_bridge(feed, url, login, **options)

        self._thread = threading.Thread(target=work, daemon=True)
        self._thread.start()

    @property
    def bridge(self) -> Bridge:
        wait_for(lambda: self._made, "no record has come")
        return self._made[-1]

    def end(self) -> None:
        self._feed.end()
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()


@pytest.fixture
def run(feed: Feed) -> Iterator[Callable[..., Running]]:
    made: list[Running] = []

    def start(
        port: int, login: MqttFile | None = None, **options: Any
    ) -> Running:
        url = f"mqtt://127.0.0.1:{port}"
        options = {"interval_s": 0.0, **options}
        made.append(Running(feed, url, login or MqttFile(), **options))
        return made[-1]

    yield start
    for one in made:
        one.end()


Run = Callable[..., Running]


def test_state_is_retained_with_time_and_validity(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    running = run(broker.port)
    feed.add()
    wait_for(lambda: running.bridge.confirmed >= 6, "not confirmed")

    late = Subscriber(broker.port)
    wait_for(lambda: len(late.heard) >= 6, "nothing is retained")
    late.close()

    assert {retain for _, _, retain in late.heard} == {True}
    found = {topic: payload for topic, payload, _ in late.heard}
    assert found.pop(STATUS) == "online"
    values = {topic: json.loads(payload) for topic, payload in found.items()}
    assert len(values) == 5
    assert values[TOPIC]["time_s"] == 1_700_000_000.0
    assert values[TOPIC]["Validity"] == "VALID"
    assert values[TOPIC]["DiscTemperature"] == 300.0
    rear = TOPIC.replace("Row1", "Row2")
    assert values[rear]["Validity"] == "INVALID"
    assert values[rear]["DiscTemperature"] is None


@pytest.mark.slow
def test_every_message_arrives_over_a_killed_broker(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    """1200 messages: 240 records on five topics."""
    subscriber = Subscriber(broker.port)
    running = run(broker.port)

    def states() -> int:
        """Different ones: what was not confirmed comes twice."""
        return len(
            {
                (topic, payload)
                for topic, payload, _ in [*subscriber.heard]
                if topic != STATUS
            }
        )

    for _ in range(100):
        feed.add()
    wait_for(lambda: states() == 500, "before the kill")
    broker.stop(kill=True)
    for _ in range(100):
        feed.add()
    wait_for(lambda: running.bridge.unconfirmed >= 500, "not kept")
    broker.start()
    back_s = time.monotonic()
    for _ in range(40):
        feed.add()
    newest = 300.0 + feed.count - 1
    wait_for(
        lambda: (
            json.loads(subscriber.of(TOPIC)[-1])["DiscTemperature"] == newest
        ),
        "the newest state",
    )
    right_s = time.monotonic() - back_s
    wait_for(lambda: states() == 1200, "some are missing")
    subscriber.close()

    print(f"{states()} messages, newest right after {right_s:.2f} s")  # noqa: T201
    # back-off included; the limit for the figure is 2 s on a quiet machine
    assert right_s < 10.0
    assert subscriber.of(STATUS)[-1] == "online"
    assert running.bridge.given_up == 0


def test_a_bridge_that_dies_is_offline_and_silence_is_said(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    subscriber = Subscriber(broker.port)
    running = run(broker.port)
    feed.add()
    wait_for(lambda: subscriber.of(STATUS) == ["online"], "online")
    feed.add(silence=True)
    feed.add(silence=True)
    wait_for(lambda: subscriber.of(STATUS)[1:] == ["silent"], "silent")
    feed.add()
    wait_for(lambda: subscriber.of(STATUS)[2:] == ["online"], "online")

    client = running.bridge._client
    assert client is not None
    # the process is killed: the socket closes without a DISCONNECT
    client._sock_close()
    wait_for(lambda: "offline" in subscriber.of(STATUS), "the last will")
    wait_for(lambda: subscriber.of(STATUS)[-1] == "online", "online again")
    subscriber.close()


def test_the_end_is_said_too(broker: Mosquitto, feed: Feed, run: Run) -> None:
    subscriber = Subscriber(broker.port)
    running = run(broker.port)
    feed.add()
    wait_for(lambda: subscriber.of(STATUS) == ["online"], "online")
    running.end()
    wait_for(lambda: subscriber.of(STATUS)[-1] == "offline", "offline")
    subscriber.close()
    feed.end()  # for the fixture


@pytest.mark.slow
def test_messages_for_an_absent_broker_are_bounded_and_the_next_is_right(
    tmp_path: Path, feed: Feed, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "MOST_KEPT", 50)
    broker = Mosquitto(tmp_path)
    running = run(broker.port)
    for _ in range(100):
        feed.add()
    wait_for(lambda: running.bridge.given_up == 500 - 50, "not bounded")
    assert running.bridge.unconfirmed == 50

    broker.start()
    subscriber = Subscriber(broker.port)
    wait_for(lambda: running.bridge.unconfirmed == 0, "not sent")
    feed.add()
    wait_for(
        lambda: (
            subscriber.of(TOPIC)
            and json.loads(subscriber.of(TOPIC)[-1])["DiscTemperature"]
            == 400.0
        ),
        "the newest",
    )
    running.end()
    feed.end()
    subscriber.close()
    broker.stop()


def test_a_broker_that_accepts_and_never_answers_holds_nothing_up(
    feed: Feed, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "MOST_KEPT", 50)
    monkeypatch.setattr(mqtt, "END_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as slow:
        running = run(slow.getsockname()[1])
        for _ in range(200):
            feed.add()
        wait_for(lambda: running.bridge.given_up == 1000 - 50, "held up")
        running.end()
    feed.end()


class Between:
    """Stands before a broker: it passes on once somebody has connected."""

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._onward = socket.create_connection(("127.0.0.1", port))
        self.port: int = self._server.getsockname()[1]

    def accept(self) -> socket.socket:
        """Return the client's end of its connection."""
        self._accepted = self._server.accept()[0]
        return self._accepted

    def pass_on(self, pause_s: float = 0.0) -> None:
        """Let 1 kB through every *pause_s*, and all that is answered."""
        for one in (
            (self._accepted, self._onward, pause_s),
            (self._onward, self._accepted, 0.0),
        ):
            threading.Thread(target=pump, args=one, daemon=True).start()

    def close(self) -> None:
        for one in (self._accepted, self._onward, self._server):
            one.close()


def pump(source: socket.socket, sink: socket.socket, pause_s: float) -> None:
    """Pass on what comes, 1 kB at a time."""
    with suppress(OSError):
        while data := source.recv(1024):
            sink.sendall(data)
            time.sleep(pause_s)


def retained_degc(broker: Mosquitto) -> float:
    """Return the disc's temperature in what *broker* retains."""
    subscriber = Subscriber(broker.port)
    wait_for(lambda: subscriber.of(TOPIC), "nothing is retained")
    found: float = json.loads(subscriber.of(TOPIC)[-1])["DiscTemperature"]
    subscriber.close()
    return found


@pytest.mark.slow
def test_a_slow_broker_gets_everything(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    """It takes 100 kB/s at most."""
    with closing(Between(broker.port)) as slow:
        running = run(slow.port)
        began_s = time.monotonic()
        for _ in range(60):
            feed.add()
        slow.accept()
        slow.pass_on(0.01)
        wait_for(lambda: running.bridge.confirmed >= 5 * 60, "not confirmed")
        took_s = time.monotonic() - began_s
        running.end()
    feed.end()

    assert took_s > 0.5  # it was slow
    assert running.bridge.given_up == 0
    assert retained_degc(broker) == 359.0


def test_the_newest_record_is_retained_though_one_overtook_another(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    """The second comes while the broker answers, which the first waits for."""
    with closing(Between(broker.port)) as slow:
        running = run(slow.port)
        feed.add()
        # so it has waited, and its connection is open
        assert slow.accept().recv(1024, socket.MSG_PEEK)
        feed.add()
        wait_for(lambda: running.bridge.unconfirmed == 10, "not published")
        slow.pass_on()
        wait_for(lambda: running.bridge.confirmed >= 10 + 1, "not confirmed")
        running.end()
    feed.end()

    assert retained_degc(broker) == 301.0


@pytest.mark.slow
def test_a_broker_that_refuses_is_asked_again_with_right_credentials(
    tmp_path: Path, feed: Feed, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "END_S", 0.05)
    passwords = tmp_path / "passwords"
    tool = shutil.which("mosquitto_passwd")
    broker = Mosquitto(tmp_path)
    assert tool is not None
    subprocess.run(
        [tool, "-b", "-c", passwords, "car", "right"],
        check=True,
        capture_output=True,
    )
    broker.configure("allow_anonymous false", f"password_file {passwords}")
    text = (tmp_path / "mosquitto.conf").read_text()
    text = text.replace("allow_anonymous true\n", "")
    (tmp_path / "mosquitto.conf").write_text(text)
    broker.start()
    wrong = run(broker.port, MqttFile(username="car", password="wrong"))  # noqa: S106
    feed.add()
    refusals = []
    wrong.bridge._log = mock.Mock(
        info=lambda _, reason: refusals.append(reason)
    )
    wait_for(
        lambda: refusals.count("Not authorized") >= 2, "it does not ask again"
    )
    assert wrong.bridge.confirmed == 0
    wrong.end()

    right = run(broker.port, MqttFile(username="car", password="right"))  # noqa: S106
    feed.add()
    subscriber = Subscriber(broker.port, username="car", password="right")  # noqa: S106
    wait_for(lambda: subscriber.of(TOPIC), "not published")
    right.end()
    feed.end()
    feed.end()
    subscriber.close()
    broker.stop()


# paho leaves the socket of a refused certificate to the garbage collection
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning")
def test_tls_needs_a_certificate_that_verifies(
    tmp_path: Path, feed: Feed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "END_S", 0.05)
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed: no certificate to show")
    own, key = tmp_path / "own.pem", tmp_path / "own.key"
    subprocess.run(
        [
            *(openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes"),
            *("-keyout", key, "-out", own, "-days", "2"),
            *("-subj", "/CN=localhost"),
            *("-addext", "subjectAltName=DNS:localhost"),
        ],
        check=True,
        capture_output=True,
    )
    broker = Mosquitto(tmp_path)
    broker.configure(f"certfile {own}", f"keyfile {key}")
    broker.start()
    url = f"mqtts://localhost:{broker.port}"

    stranger = Running(feed, url, MqttFile(), interval_s=0.0)
    feed.add()
    feed.add()
    wait_for(lambda: stranger.bridge.unconfirmed >= 5, "not kept")
    stranger.end()
    assert stranger.bridge.confirmed == 0

    monkeypatch.setattr(mqtt, "END_S", LIMIT_S)
    trusted = Running(feed, url, MqttFile(ca_file=str(own)))
    feed.add()
    wait_for(lambda: trusted.bridge.confirmed >= 6, "not published")
    trusted.end()
    broker.stop()


def test_discovery_announces_sensors_that_exist(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    subscriber = Subscriber(broker.port)
    run(broker.port, discovery="homeassistant")
    feed.add()
    key = "bstm_example_vehicle_FL_DiscTemperature"
    place = f"homeassistant/sensor/{key}/config"
    wait_for(lambda: subscriber.of(TOPIC), "no state")
    wait_for(lambda: len(subscriber.heard) == 5 + 1 + 4 * 6, "no sensors")
    subscriber.close()

    (payload,) = subscriber.of(place)
    sensor = json.loads(payload)
    assert sensor["unique_id"] == key
    assert sensor["state_topic"] == TOPIC
    assert sensor["availability_topic"] == STATUS
    leaf = sensor["value_template"].split(".")[1].split()[0]
    assert json.loads(subscriber.of(TOPIC)[-1])[leaf] == 300.0
    announced = [t for t, _, _ in subscriber.heard if t.endswith("config")]
    assert len(announced) == 4 * 6


def test_records_come_no_closer_than_the_interval(
    broker: Mosquitto, feed: Feed, run: Run
) -> None:
    """Ten records a second, of which one is published."""
    subscriber = Subscriber(broker.port)
    run(broker.port, interval_s=1.0)
    feed.add()
    # while it connects, what waits may be overtaken by what comes
    wait_for(lambda: len(subscriber.of(TOPIC)) == 1, "none")
    for _ in range(30):
        feed.add()

    def times() -> list[float]:
        # the newest may come twice, if the broker answered in between
        return list(
            dict.fromkeys(
                json.loads(one)["time_s"] for one in subscriber.of(TOPIC)
            )
        )

    wait_for(lambda: len(times()) == 4, "too few")
    assert times() == [1_700_000_000.0 + n for n in range(4)]
    subscriber.close()


def test_another_vehicle_has_topics_of_its_own(
    broker: Mosquitto, feed: Feed
) -> None:
    subscriber = Subscriber(broker.port)
    feed.add()
    feed.end()
    (record,) = feed
    run_bridge(
        [record, {**record, "vehicle": "an/other+car#"}],
        f"mqtt://127.0.0.1:{broker.port}",
        MqttFile(),
    )
    other = "bstm/an_other_car_/status"
    wait_for(lambda: subscriber.of(other)[-1:] == ["offline"], "not ended")
    assert subscriber.of(STATUS)[-1] == "offline"
    assert subscriber.of(TOPIC.replace("example-vehicle", "an_other_car_"))
    subscriber.close()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("http://broker", "mqtts://HOST"),
        ("mqtts://broker:port", "port"),
        ("mqtts://", "mqtts://HOST"),
        ("mqtts://broker/topic", "mqtts://HOST"),
        ("mqtts://car:secret@broker", "--credentials"),
        ("mqtt://broker", "needs mqtts"),
    ],
)
def test_addresses_that_are_refused(url: str, words: str) -> None:
    secret = MqttFile(username="car", password="secret")  # noqa: S106
    with pytest.raises(UsageError, match=words):
        new_client(url, secret)


def test_addresses_have_the_usual_ports() -> None:
    for url, port in (
        ("mqtts://broker", 8883),
        ("mqtt://127.0.0.1", 1883),
        ("mqtt://localhost:1884", 1884),
    ):
        assert new_client(url, MqttFile()).port == port


def test_a_missing_certificate_is_said() -> None:
    with pytest.raises(FileAccessError, match="certificates"):
        new_client("mqtts://broker", MqttFile(ca_file="/missing.pem"))


@pytest.mark.slow
def test_the_command_publishes_a_feed_until_it_is_stopped(
    broker: Mosquitto,
    config: Config,
    estimate: Make,
    socket_path: Path,
    tmp_path: Path,
) -> None:
    """As a process, with its options in the file."""
    file = tmp_path / "mqtt.toml"
    file.write_text(f'broker = "mqtt://localhost:{broker.port}"\n')
    file.chmod(0o600)
    section = config.feed.model_copy(update={"socket": str(socket_path)})
    server = FeedServer(pytest.fail)
    server.begin(config.model_copy(update={"feed": section}), tmp_path)
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "bstm_daemon.cli.main"),
            *("bridge", "mqtt", "--feed", socket_path, "--credentials", file),
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    subscriber = Subscriber(broker.port)

    def published() -> bool:
        server.publish(estimate(0), 0)
        return bool(subscriber.of(TOPIC))

    wait_for(published, "not published")
    process.terminate()
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0
    assert "broker_answered" in said
    wait_for(lambda: subscriber.of(STATUS)[-1] == "offline", "offline")
    subscriber.close()
    server.close()


def test_the_command_refuses_a_file_that_others_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mqtt.toml"
    file.write_text('username = "car"\n')
    file.chmod(0o644)
    arguments = ["bridge", "mqtt", "--credentials", str(file)]
    assert main(arguments) == 2
    assert "chmod o=" in capsys.readouterr().err
    file.chmod(0o600)
    assert main(arguments) == 2
    assert "needs --broker" in capsys.readouterr().err
    file.write_text('password = "x"\nbrokr = "y"\n')
    assert main(arguments) == 78
    assert "brokr" in capsys.readouterr().err
    file.unlink()
    assert main(arguments) == 74
