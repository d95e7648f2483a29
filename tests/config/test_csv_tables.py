"""Tables of CFD and test benches in the place of a configuration's own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bstm_daemon.analysis.identify.writing import Change, write_changed
from bstm_daemon.config.csv_tables import (
    CAPACITY_20C_J_KGK,
    csv_names,
    put_csv_tables,
)
from bstm_daemon.config.limits import CSV_BYTES
from bstm_daemon.config.reading import load_config, read_draft
from bstm_daemon.config.sections import DiscConfig
from bstm_daemon.config.thermal import CoolingConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.exchange.fmu_model import corner_fmu
from bstm_daemon.exchange.fmu_network import network_header
from bstm_daemon.fleet.lake import hash_of_config
from bstm_daemon.model.thermal.properties import (
    REFERENCE_K,
    disc_heat_capacity,
)

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).parents[2]
EXAMPLE = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
EXAMPLE = EXAMPLE.replace("../dbc", (ROOT / "dbc").as_posix())
S = re.compile(r"^speed_ms = .*\ns_per_s = .*\n", re.MULTILINE)
PAD = re.compile(r"^heat_capacity_j_kgk = 1050.0", re.MULTILINE)
CFD = "speed_km_h,coefficient_w_m2k\n0,5\n90,40\n180,70\n"
BENCH = "# pad\nTemperature [°C];Heat capacity [kJ/(kg K)]\n20;1,0\n420;1,3\n"


def car(
    folder: Path, cooling: str = "", pad: str = "", form: str = "conductance"
) -> Path:
    """Write the example with other lines for its tables."""
    text = EXAMPLE.replace('form = "rate"', f'form = "{form}"')
    if cooling:
        text = S.sub(f"{cooling}\n", text, count=1)
    if pad:
        text = PAD.sub(f"heat_capacity_j_kgk = {pad}", text, count=1)
    path = folder / "car.toml"
    path.write_text(text, "utf-8")
    return path


def numbers_of(config: Config, corner: int = 0) -> list[float]:
    return list(compile_corner(config, config.corner[corner]).floats)


def problem_of(path: Path) -> str:
    with pytest.raises(ConfigError) as found:
        load_config(path)
    (problem,) = found.value.problems
    return problem


def test_a_file_gives_the_model_of_the_same_inline_table(
    tmp_path: Path,
) -> None:
    """The same numbers, so the same bits of Python, C and the FMU."""
    (tmp_path / "s.csv").write_text(
        "speed_m_s\ts_per_s\n"
        + "".join(f"{v}\t{1e-4 * (1 + v)}\n" for v in range(7)),
        "utf-8",
    )
    (tmp_path / "cp.csv").write_text(BENCH, "utf-8")
    by_file = load_config(
        car(tmp_path, 'csv = "s.csv"', '{csv = "cp.csv"}', "rate")
    )
    inline = load_config(
        car(
            tmp_path,
            f"speed_ms = {[float(v) for v in range(7)]}\n"
            f"s_per_s = {[1e-4 * (1 + v) for v in range(7)]}",
            "{temperature_c = [20.0, 420.0], value = [1000.0, 1300.0]}",
            "rate",
        )
    )

    assert by_file.cooling == inline.cooling
    assert numbers_of(by_file) == numbers_of(inline)
    headers = [network_header(corner_fmu(c, "FL")) for c in (by_file, inline)]
    assert headers[0] == headers[1]


def test_a_coefficient_is_the_conductance_of_each_disc(tmp_path: Path) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    path = car(tmp_path, 'csv = "cfd.csv"')

    config = load_config(path)

    for corner in config.disc_corners()[:2]:
        disc = corner.disc
        assert disc is not None
        cooling = config.cooling_of(corner)
        assert cooling.speed_ms == [0.0, 25.0, 50.0]
        network = compile_corner(config, corner).network
        link = network.link("disc_convection")
        at_speed = link.factors[0].table
        assert at_speed is not None
        for speed_ms, h in ((0.0, 5.0), (25.0, 40.0), (50.0, 70.0)):
            assert link.conductance_w_k * at_speed(speed_ms) == pytest.approx(
                h * disc.total_area_m2, rel=1e-12
            )
    # the rear discs have tables of their own, which stay
    assert config.corner[2].cooling["s_per_s"][0] == pytest.approx(3.59e-4)


def test_a_corner_has_a_conductance_of_its_own_material(
    tmp_path: Path,
) -> None:
    (tmp_path / "hot.csv").write_text(
        "conductance_w_k,speed_mph\n2,0\n6,100\n", "utf-8"
    )
    (tmp_path / "cp.csv").write_text(
        "temperature_k,heat_capacity_j_kgk\n273.15,400\n673.15,600\n", "utf-8"
    )
    text = car(tmp_path).read_text("utf-8")
    text = text.replace(
        'material = "grey-iron-smooth"\n',
        'material = "own"\nheat_capacity_j_kgk = {csv = "cp.csv"}\n',
        1,
    ).replace(
        "[corner.disc]",
        '[corner.cooling]\ncsv = "hot.csv"\n\n[corner.disc]',
        1,
    )
    (tmp_path / "car.toml").write_text(text, "utf-8")

    config = load_config(tmp_path / "car.toml")

    disc = config.corner[0].disc
    assert disc is not None
    assert disc.heat_capacity_j_kgk is not None
    assert disc.heat_capacity_j_kgk.temperature_c == [0.0, 400.0]
    cooling = config.cooling_of(config.corner[0])
    mass_kg = (
        disc.mass_kg
        * config.thermal_of(config.corner[0]).disc_mass_correction_factor
    )
    assert cooling.speed_ms == [0.0, 44.704]
    assert [s * mass_kg * 410.0 for s in cooling.s_per_s] == pytest.approx(
        [2.0, 6.0]
    )


@pytest.mark.parametrize("material", CAPACITY_20C_J_KGK)
def test_capacities_at_20_degc_are_those_of_the_model(material: str) -> None:
    disc = DiscConfig.model_validate(
        {
            "mass_kg": 7.0,
            "swept_area_m2": 0.08,
            "total_area_m2": 0.14,
            "material": material,
        }
    )

    at_20c = disc_heat_capacity(disc)(REFERENCE_K)
    assert at_20c == CAPACITY_20C_J_KGK[material]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "speed_mm_s,s_per_s\n0,1\n1,2\n",
            (
                "t.csv line 1: needs one column of speed_m_s, speed_km_h, "
                "speed_mph, has speed_mm_s, s_per_s"
            ),
        ),
        (
            "speed_m_s,speed_km_h,s_per_s\n0,0,1\n1,3.6,2\n",
            "t.csv line 1: needs one column of speed_m_s, ",
        ),
        (
            "speed_m_s,h\n0,1\n1,2\n",
            (
                "t.csv line 1: needs one column of s_per_s, "
                "coefficient_w_m2k, conductance_w_k, has speed_m_s, h"
            ),
        ),
        (
            "\nspeed_m_s,s_per_s\n0,1e-3\n# x\n1,many\n",
            "t.csv line 5 column s_per_s: 'many' is no number",
        ),
        (
            "speed_m_s,s_per_s\n0,1e-3\n1\n",
            "t.csv line 3 column s_per_s: '' is no number",
        ),
        (
            "speed_m_s,s_per_s\n0,1e-3\n1,inf\n",
            "t.csv line 3 column s_per_s: 'inf' is no number",
        ),
        (
            "speed_m_s,s_per_s\n0,1e-3\n1_0,1\n",
            "t.csv line 3 column speed_m_s: '1_0' is no number",
        ),
        (
            "speed_m_s,s_per_s\n5,1e-3\n5,1e-3\n",
            "t.csv line 3 column speed_m_s: '5' must be above the row before",
        ),
        (
            "speed_m_s,s_per_s\n0,1e-3\n5,-1e-3\n",
            "t.csv line 3 column s_per_s: '-1e-3' must not be negative",
        ),
        ("speed_m_s,s_per_s\n0,1\n", "t.csv: needs a head and 2 to 1000 rows"),
        ("", "t.csv: needs a head and 2 to 1000 rows"),
        ("x" * (CSV_BYTES + 1), "t.csv: is longer than 1 MiB"),
        ("\udcff", "t.csv: 'utf-8' codec can't decode byte 0xff"),
        (
            'speed_m_s,s_per_s\n"0","1"x\n1,2\n',
            "t.csv line 2 column s_per_s: '1\"x' is no number",
        ),
        (None, "t.csv: No such file or directory"),
        (
            "speed_km_h,s_per_s\n30,1e-3\n90,2e-3\n",
            "t.csv: begins at 8.33 m/s, needs a row at or below blend_end",
        ),
    ],
)
def test_a_file_that_can_not_be_used_is_named_with_line_and_column(
    tmp_path: Path, text: str | None, reason: str
) -> None:
    if text is not None:
        (tmp_path / "t.csv").write_bytes(text.encode(errors="surrogateescape"))

    problem = problem_of(car(tmp_path, 'csv = "t.csv"', form="rate"))

    assert problem.startswith(f"{tmp_path}/car.toml: [cooling] csv: {reason}")


def test_a_coefficient_is_no_rate(tmp_path: Path) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")

    problem = problem_of(car(tmp_path, 'csv = "cfd.csv"', form="rate"))

    assert 'csv: coefficient_w_m2k needs form = "conductance"' in problem


@pytest.mark.parametrize("pad", ['{csv = "none.csv"}', "{csv = 3}"])
def test_all_unusable_files_are_listed(tmp_path: Path, pad: str) -> None:
    path = car(tmp_path, 'csv = "t.csv"', pad)

    for read in (load_config, read_draft):
        with pytest.raises(ConfigError) as found:
            read(path)
        pads, cooling = found.value.problems
        assert "[[corner]] FL pad.heat_capacity_j_kgk.csv: " in pads
        assert "[cooling] csv: t.csv: No such file" in cooling


@pytest.mark.parametrize("part", ["cooling = 3", "cooling = [1]", "disc = 3"])
def test_parts_that_are_no_tables_are_problems_of_their_own(
    tmp_path: Path, part: str
) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    text = car(tmp_path, 'csv = "cfd.csv"').read_text("utf-8")
    if part.startswith("disc"):
        text = re.sub(r"\[corner.disc\](.*\n)*?(?=\[)", "", text, count=1)
    text = text.replace('name = "FL"\n', f'name = "FL"\n{part}\n', 1)
    (tmp_path / "car.toml").write_text(text, "utf-8")

    with pytest.raises(ConfigError, match="FL"):
        load_config(tmp_path / "car.toml")


def test_a_file_beside_points_is_refused(tmp_path: Path) -> None:
    path = car(tmp_path, 'csv = "t.csv"\nspeed_ms = [0.0, 1.0]')

    assert "must be the name of a file, and the only table" in problem_of(path)


def test_a_coefficient_hides_no_problem_of_the_disc(tmp_path: Path) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    path = car(tmp_path, 'csv = "cfd.csv"')
    text = path.read_text("utf-8").replace("mass_kg = 7.5\n", "", 1)
    path.write_text(text, "utf-8")

    assert "[[corner]] FL disc.mass_kg: missing" in problem_of(path)


VALUES = st.one_of(
    st.sampled_from(["cfd.csv", "cp.csv", "own", "conductance", "\0", ".", 0]),
    st.floats(),
    st.lists(st.floats(), max_size=2),
)
TABLES = st.dictionaries(
    st.sampled_from(["csv", "form", "material", "mass_kg", "blend_end_ms"]),
    VALUES | st.dictionaries(st.just("csv"), VALUES),
)
CORNERS = st.dictionaries(
    st.sampled_from(["name", "disc", "pad", "cooling", "thermal"]),
    VALUES
    | TABLES
    | st.dictionaries(
        st.sampled_from(["heat_capacity_j_kgk", "conductivity_w_mk"]), TABLES
    ),
)


@settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.dictionaries(
        st.sampled_from(["cooling", "thermal", "corner"]),
        VALUES | TABLES | st.lists(CORNERS | VALUES, max_size=2),
    )
)
def test_whatever_stands_there_is_taken_or_worded(
    tmp_path: Path, document: dict[str, Any]
) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    (tmp_path / "cp.csv").write_text(BENCH, "utf-8")
    problems: list[str] = []
    try:
        put_csv_tables(document, tmp_path)
    except ConfigError as error:
        problems = error.problems
    assert all("csv" in problem for problem in problems)
    assert csv_names(document) == []


def test_a_section_by_itself_reads_no_file() -> None:
    with pytest.raises(ValueError, match="is read with a configuration file"):
        CoolingConfig(csv="cfd.csv")


def test_a_changed_copy_needs_no_file(tmp_path: Path) -> None:
    """What was matched stays, whatever becomes of the CSV file."""
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    (tmp_path / "cp.csv").write_text(BENCH, "utf-8")
    path = car(tmp_path, 'csv = "cfd.csv"', '{csv = "cp.csv"}')
    before = load_config(path)
    (tmp_path / "there").mkdir()
    new = tmp_path / "there" / "new.toml"

    write_changed(path, new, [Change("vehicle", "drag_area_m2", 0.8)], "test")

    for name in ("cfd.csv", "cp.csv"):
        (tmp_path / name).unlink()
    after = load_config(new)
    assert after.vehicle.drag_area_m2 == 0.8
    assert after.corner == before.corner
    assert after.cooling == before.cooling
    for corner in range(4):
        assert numbers_of(after, corner) == numbers_of(before, corner)
    assert "# tables of cp.csv, cfd.csv\n" in new.read_text("utf-8")


def test_a_changed_file_is_another_configuration_for_the_fleet(
    tmp_path: Path,
) -> None:
    (tmp_path / "cfd.csv").write_text(CFD, "utf-8")
    path = car(tmp_path, 'csv = "cfd.csv"')
    before = hash_of_config(path)

    (tmp_path / "cfd.csv").write_text(CFD.replace("70", "71"), "utf-8")

    assert hash_of_config(path) != before
