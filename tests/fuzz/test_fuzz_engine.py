"""A part of the engine's fuzzing, and that it notices what it is there for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("engine_fuzz.py")

DEFECTS = {
    "an exception escapes": (
        "frame = engine_fuzz.Engine.frame\n"
        "def broken(self, bus, can_id, extended, data, *rest, **flags):\n"
        "    if len(data) > 8:\n"
        "        raise IndexError('no room')\n"
        "    frame(self, bus, can_id, extended, data, *rest, **flags)\n"
        "engine_fuzz.Engine.frame = broken\n"
    ),
    "too hot and not said": (
        "from bstm_daemon.estimator import estimator, validity\n"
        "estimator.HIGHEST_K = validity.HIGHEST_K = 1e9\n"
        "blocks = estimator.Estimator.blocks\n"
        "def broken(self, *samples):\n"
        "    for batch, _ in self.batches:\n"
        "        batch.state[2] = 2500.0\n"
        "    return blocks(self, *samples)\n"
        "estimator.Estimator.blocks = broken\n"
    ),
    "memory is kept": (
        "frame = engine_fuzz.Engine.frame\n"
        "kept = []\n"
        "def broken(self, *frame_, **flags):\n"
        "    kept.append(bytes(2000))\n"
        "    frame(self, *frame_, **flags)\n"
        "engine_fuzz.Engine.frame = broken\n"
    ),
    "a state is not checked": (
        "from bstm_daemon.estimator import state\n"
        "def broken(model, document, *where):\n"
        "    return model.model_construct(**document)\n"
        "state.checked = broken\n"
    ),
    "a wrong configuration is not worded": (
        "load = engine_fuzz.load_config\n"
        "def broken(path):\n"
        "    try:\n"
        "        return load(path)\n"
        "    except engine_fuzz.BstmError as error:\n"
        "        raise KeyError from error\n"
        "engine_fuzz.load_config = broken\n"
    ),
}

WORDS = {
    "an exception escapes": "IndexError: no room",
    "too hot and not said": "K with validity ",
    "memory is kept": "Defect: memory: ",
    "a state is not checked": "Error: ",
    "a wrong configuration is not worded": "KeyError",
}

COUNTS = {
    "an exception escapes": {"frames": 2000},
    "too hot and not said": {"frames": 2000},
    "memory is kept": {"frames": 20_000},
    "a state is not checked": {"states": 300},
    "a wrong configuration is not worded": {"configurations": 20},
}


def fuzz(
    folder: Path, *arguments: str, counts: dict[str, int]
) -> subprocess.CompletedProcess[str]:
    every = dict.fromkeys(("frames", "states", "configurations"), 0) | counts
    options = [
        text
        for name, count in every.items()
        for text in (f"--{name}", str(count))
    ]
    return subprocess.run(
        [
            *(sys.executable, "-W", "error", *arguments, *options),
            *("--out", str(folder)),
        ],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
        cwd=SCRIPT.parent,
    )


@pytest.mark.slow
def test_twenty_thousand_frames_pass(tmp_path: Path) -> None:
    """The first of the ten million of .ci/full."""
    counts = {"frames": 20_000, "states": 200, "configurations": 20}

    done = fuzz(tmp_path, str(SCRIPT), counts=counts)

    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("20220 passed\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_found_and_its_input_kept(
    tmp_path: Path, defect: str
) -> None:
    code = (
        "import sys, engine_fuzz\n"
        f"{DEFECTS[defect]}sys.exit(engine_fuzz.main())\n"
    )

    done = fuzz(tmp_path, "-c", code, counts=COUNTS[defect])

    assert done.returncode == 1, done.stdout + done.stderr
    (kept,) = tmp_path.iterdir()
    assert kept.name in done.stdout
    assert WORDS[defect] in done.stdout
    assert kept.stat().st_size > 100
