"""``docs/effects.md`` says of every effect what its class says."""

from __future__ import annotations

from pathlib import Path

from bstm_daemon.model.effects.catalogue import (
    STRUCTURES,
    effect_class,
    effect_names,
)

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "effects.md"


def effect_numbers() -> dict[int, str]:
    """Number to name of all effects, rising."""
    return dict(
        sorted((effect_class(name).number, name) for name in effect_names())
    )


def twins_of(name: str) -> tuple[str, ...]:
    """Return the effects that data may take for *name*, by number.

    A twin that one of the two names is one of both.
    """
    own = set(effect_class(name).twins)
    return tuple(
        other
        for other in effect_numbers().values()
        if other in own or name in effect_class(other).twins
    )


def effect_row(name: str) -> str:
    """Return the row of one effect as it has to stand in the document."""
    cls = effect_class(name)
    shipped = " E" if name in STRUCTURES["extended"] else ""
    sign = " ±" if cls.either_sign else ""
    where = " car" if cls.whole_car else ""
    twins = ", ".join(f"`{twin}`" for twin in twins_of(name)) or "-"
    return (
        f"| `{name}`{shipped}{sign}{where} | "
        f"{cls.description} | {cls.signature} | {twins} |"
    )


def parameter_row(name: str) -> str:
    """Return the row of one effect's own parameters.

    Units are not stated: a parameter's name ends with its unit.
    """
    own = "; ".join(
        f"`{p.name}` {p.typical:g} ({p.lower:g}..{p.upper:g}): {p.meaning}"
        for p in effect_class(name).own_parameters
    )
    return f"| `{name}` | {own} |"


def test_the_document_is_the_catalogue() -> None:
    """All rows, by kind in the order of their numbers, and no others."""
    names = tuple(effect_numbers().values())
    expected = []
    for kind in ("heat", "thermal", "measurement"):
        expected.append(f"### {kind.capitalize()}")
        expected += [
            effect_row(name)
            for name in names
            if effect_class(name).kind == kind
        ]
    expected += [
        parameter_row(name)
        for name in names
        if effect_class(name).own_parameters
    ]
    text = DOCUMENT.read_text("utf-8").partition("\n## The catalogue")[2]
    found = [
        line for line in text.splitlines() if line.startswith(("| `", "### "))
    ]

    assert found == expected


def test_the_catalogue_is_whole() -> None:
    """Each number once."""
    assert list(effect_numbers()) == list(range(1, 46))


def test_twins_are_effects_and_mutual() -> None:
    """A twin is in the catalogue and is another; one of a pair names both."""
    names = set(effect_numbers().values())
    for name in names:
        assert set(effect_class(name).twins) <= names - {name}
        for twin in effect_class(name).twins:
            assert name not in effect_class(twin).twins


def test_units_are_those_that_names_end_with() -> None:
    """A share or an exponent has none."""
    units = {
        **{f"_{unit}": unit for unit in ("m", "m2", "s", "kg")},
        "_k": "K",
        "_c": "degC",
        "_j": "J",
        "_nm": "Nm",
        "_w": "W",
        "_pa": "Pa",
        "_w_k": "W/K",
        "_w_m2k": "W/m2K",
        "_j_k": "J/K",
        "_ms": "m/s",
        "_j_kgk": "J/kgK",
        "_per_s": "1/s",
        "_per_k": "1/K",
        "_ms2": "m/s2",
        "_s_h": "s/h",
        "_s_m": "s/m",
        "_ws_mk": "Ws/mK",
    }
    ends = sorted(units, key=len, reverse=True)
    for name in effect_numbers().values():
        for p in effect_class(name).own_parameters:
            end = next((one for one in ends if p.name.endswith(one)), "")
            assert p.unit == units.get(end, "1"), f"{name}: {p.name}"
