"""Version, changelog, bill of materials and the table of threats."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SECURITY = (ROOT / "docs" / "SECURITY.md").read_text(encoding="utf-8")


def test_the_version_has_a_dated_section() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## \[(.+?)\](.*)$", text, re.MULTILINE)

    assert sections[0] == ("Unreleased", "")
    assert sections[1][0] == PROJECT["project"]["version"]
    assert re.fullmatch(r" - \d{4}-\d\d-\d\d", sections[1][1])


def test_a_tag_of_a_version_is_that_of_the_project() -> None:
    """Where git and tags are: neither an archive nor a shallow clone has."""
    done = subprocess.run(
        ["git", "tag", "--points-at", "HEAD", "v*"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )

    assert done.stdout.split() in ([], [f"v{PROJECT['project']['version']}"])


def test_the_container_runs_the_service_and_not_as_root() -> None:
    """.ci/container builds it; here is what can be read of it."""
    text = (ROOT / "systemd" / "Containerfile").read_text(encoding="utf-8")
    lines = [one for one in text.splitlines() if not one.startswith("#")]
    steps = [
        one.split(maxsplit=1)
        for one in "\n".join(lines).replace("\\\n", " ").splitlines()
        if one
    ]
    names = [name for name, _ in steps]
    last = dict(steps)

    assert set(names) == {
        *("ARG", "FROM", "COPY", "RUN", "ENV", "USER", "VOLUME"),
        *("ENTRYPOINT", "CMD"),
    }
    assert names[:2] == ["ARG", "FROM"]
    assert last["USER"] == "bstm"
    assert names.index("RUN") < names.index("USER") < names.index("ENTRYPOINT")
    command = [*json.loads(last["ENTRYPOINT"]), *json.loads(last["CMD"])]
    unit = (ROOT / "systemd" / "bstm.service").read_text(encoding="utf-8")
    assert f"ExecStart={' '.join(command)} $BSTM_OPTIONS" in unit


def test_one_wheel_serves_all_versions_of_python() -> None:
    options = PROJECT["tool"]["distutils"]["bdist_wheel"]

    assert options == {"py-limited-api": "cp311"}


def bill(*extras: str) -> str:
    return subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "sbom"), *extras],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def test_the_bill_lists_what_is_installed() -> None:
    pytest.importorskip("packaging")
    text = bill("report")
    components = json.loads(text)["components"]
    found = {one["name"]: one for one in components}

    for name in ("cantools", "numpy", "pydantic", "python-can", "plotly"):
        assert found[name]["version"] == version(name)
    assert {"bstm.dbc", "toyota_new_mc_pt_generated.dbc"} <= found.keys()
    assert re.fullmatch(r"[0-9.]+", found["plotly.js"]["version"])
    assert found["uPlot"]["version"] == "1.6.32"
    assert found["uPlot"]["licenses"] == [{"license": {"id": "MIT"}}]
    assert "pyarrow" not in found
    assert len({one["bom-ref"] for one in components}) == len(components)
    assert all(one["licenses"] for one in components)
    assert '"unknown"' not in text
    assert bill("report") == text


def test_a_bill_that_lists_less_than_is_installed_is_an_error() -> None:
    pytest.importorskip("packaging")

    done = subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "sbom"), "--exact"],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )

    assert done.returncode == 1
    assert re.match(r"not in the bill: .*'pytest'", done.stderr)


@pytest.mark.parametrize(
    "test", re.findall(r"`(tests/[\w/.]+::\w+)`", SECURITY)
)
def test_every_answer_to_a_threat_has_its_test(test: str) -> None:
    path, _, name = test.partition("::")

    assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8")


def test_the_document_names_what_the_program_is_not() -> None:
    words = " ".join(SECURITY.split())

    assert "not a safety function" in words
    assert "not qualified to ISO 26262" in words
