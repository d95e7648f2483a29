"""Roles: the names users write, their quantities, and their documentation."""

import re
from pathlib import Path

import pytest

from bstm_daemon.roles import (
    CORNERS,
    GROUND_LAG_S,
    MEASURED_NODES,
    ROLE_INDEX,
    ROLES,
    Role,
)
from bstm_daemon.units import UNITS

PACKAGE = Path(__file__).parents[1] / "bstm_daemon"
REFERENCE = Path(__file__).parents[1] / "docs" / "reference.md"
ROLE_ROW = re.compile(
    r"^\| `(\w[\w<>]*)` \| ([a-z ]+)(?:, (\d+) s)? \|[^|]*\|$", re.MULTILINE
)
USUAL_TIMEOUT_S = 0.5
UNIT_ROW = re.compile(r"^- ([a-z ]+): (`.*)$", re.MULTILINE)


def expand(name: str) -> list[str]:
    """Return the roles that a documented name stands for."""
    names = [
        name.replace("<corner>", corner.lower())
        for corner in (CORNERS if "<corner>" in name else ("",))
    ]
    return [
        each.replace("<node>", node)
        for each in names
        for node in (MEASURED_NODES if "<node>" in name else ("",))
    ]


def test_names_are_unique() -> None:
    """A role name stands for one role number."""
    assert len(ROLE_INDEX) == len(ROLES)


def test_index_is_the_position() -> None:
    """ROLE_INDEX and ROLES agree; sample streams depend on it."""
    assert all(ROLES[i].name == name for name, i in ROLE_INDEX.items())


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name)
def test_quantities_have_units(role: Role) -> None:
    """Each role can be given in some unit, and ages in a positive time."""
    quantities = {unit.quantity for unit in UNITS.values()}

    assert role.quantities
    assert set(role.quantities) <= quantities
    assert role.timeout_s > 0


def test_reference_lists_every_role() -> None:
    """Name, quantities and timeout in the reference are those of the code."""
    documented = {
        role: (kinds, float(timeout_s or USUAL_TIMEOUT_S))
        for name, kinds, timeout_s in ROLE_ROW.findall(
            REFERENCE.read_text(encoding="utf-8").partition("## Roles")[2]
        )
        for role in expand(name)
    }
    expected = {
        role.name: (
            " or ".join(kind.replace("_", " ") for kind in role.quantities),
            role.timeout_s,
        )
        for role in ROLES
    }

    assert expected == documented


def test_reference_lists_every_unit() -> None:
    """The units of each quantity in the reference are those of the code."""
    text = REFERENCE.read_text(encoding="utf-8").partition("## Units")[2]
    documented = {
        unit: kind.replace(" ", "_")
        for kind, units in UNIT_ROW.findall(text)
        for unit in re.findall(r"`([^`]+)`", units)
    }

    assert {name: unit.quantity for name, unit in UNITS.items()} == documented


@pytest.mark.parametrize("role", GROUND_LAG_S)
def test_a_redundant_role_is_named_in_two_files(role: str) -> None:
    """The table of roles and the rules of names: all else follows."""
    named_in = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*")
        if path.suffix in {".py", ".c", ".h", ".toml"}
        and PACKAGE / "simulation" not in path.parents
        and role in path.read_text(encoding="utf-8").lower()
    }

    assert named_in == {"roles.py", "analysis/setup/_data/names.toml"}
