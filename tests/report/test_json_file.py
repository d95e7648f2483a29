"""Results as JSON files."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.errors import FileAccessError
from bstm_daemon.report.json_file import own_fields, picked, write_json


@dataclass(frozen=True, slots=True)
class Part:
    """A part with an array and a property."""

    error_k: float
    time_s: np.ndarray

    @property
    def rows(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class Result:
    """A result with a part."""

    name: str
    part: Part


RESULT = Result("fit", Part(float("nan"), np.array([0.5, np.inf, 2.0])))


def test_dataclasses_and_arrays_are_plain_and_unknown_is_null(
    tmp_path: Path,
) -> None:
    path = tmp_path / "result.json"

    write_json(path, {"result": RESULT, "ok": np.bool_(True), "n": (1, 2)})

    text = path.read_text(encoding="utf-8")
    assert text.endswith("}\n")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "result": {
            "name": "fit",
            "part": {"error_k": None, "time_s": [0.5, None, 2.0]},
        },
        "ok": True,
        "n": [1, 2],
    }


def test_no_rounding_error_of_a_float_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    values = [11.299999999999997, 0.1 + 0.2, 1e-7 / 3.0, 56156.112344490946]

    write_json(path, {"1.1234567890123": values, "n": 2**53 + 1}, None)

    assert path.read_text(encoding="utf-8") == (
        '{"1.1234567890123": [11.3, 0.3, 3.333333333e-08, 56156.11234], '
        '"n": 9007199254740993}\n'
    )


def test_fields_are_picked_by_name_by_another_and_deeper() -> None:
    assert own_fields(RESULT, "part") == {"name": "fit"}
    assert picked(RESULT, "name", rows="part.rows") == {
        "name": "fit",
        "rows": 3,
    }


def test_a_file_that_can_not_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="missing"):
        write_json(tmp_path / "missing" / "result.json", {})
