"""Defects of DBC files in the wild: refused with the place, or left out."""

import codecs
import os
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.signals.dbc import (
    LoadedDbc,
    UnusableSignalError,
    _layout_defect,
    raw_signal,
    read_dbc,
)
from bstm_daemon.bus.signals.dbc_survey import MessageOutline
from bstm_daemon.bus.signals.dbc_text import (
    Statement,
    decode_dbc,
    edited,
    guess_encoding,
    statements_of,
)
from bstm_daemon.errors import ConfigError

REAL = os.environ.get("BSTM_REAL_DATA")

HEAD = 'VERSION ""\n\nBU_: X\n\n'
GOOD = """BO_ 100 BRAKE: 8 X
 SG_ pressure : 0|16@1+ (0.1,0) [0|250] "bar" X
 SG_ pressed : 16|1@1+ (1,0) [0|1] "" X

"""
WHOLE = HEAD + GOOD
"""Its messages begin in line 5."""


def signals_of(loaded: LoadedDbc) -> dict[str, list[str]]:
    return {
        message.name: [signal.name for signal in message.signals]
        for message in loaded.database.messages
    }


def lenient(path: Path, encoding: str = "cp1252") -> LoadedDbc:
    return read_dbc(path, strict=False, encoding=encoding)


CASES = {
    "VAL_ of an unknown message": (
        WHOLE + 'VAL_ 2147483648 state 0 "off" 1 "on" ;\n',
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: VAL_ of signal 'state': there is no message with id"],
    ),
    "VAL_ of an unknown signal": (
        WHOLE + 'VAL_ 100 state 0 "off" 1 "on" ;\n',
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: message 'BRAKE': VAL_ of signal 'state': there is no such"],
    ),
    "SIG_VALTYPE_ of an unknown message": (
        WHOLE + "SIG_VALTYPE_ 101 level : 1;\n",
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: SIG_VALTYPE_ of signal 'level'"],
    ),
    "comment without its kind": (
        WHOLE + 'CM_ 100 "of which?";\nCM_ BO_ 100 "fine";\n',
        {"BRAKE": ["pressure", "pressed"]},
        ['line 9: cannot be read: CM_ 100 "of which?";'],
    ),
    "message name twice": (
        WHOLE
        + 'BO_ 101 BRAKE: 8 X\n SG_ other : 0|8@1+ (1,0) [0|0] "" X\n'
        + 'VAL_ 101 other 0 "no" ;\n',
        {"BRAKE": ["pressure", "pressed"]},
        [
            "has the name of the message in line 5, which counts: dropped",
        ],
    ),
    "signal name twice": (
        HEAD + GOOD.replace("pressed", "pressure"),
        {"BRAKE": ["pressure"]},
        ["line 7: message 'BRAKE': signal 'pressure' is declared in line 6"],
    ),
    "signal outside its message": (
        WHOLE.replace("16|1@", "64|1@"),
        {"BRAKE": ["pressure", "pressed"]},
        ["line 7: message 'BRAKE': signals do not fit in its 8 bytes: pre"],
    ),
    "signals overlap": (
        WHOLE.replace("16|1@", "15|1@"),
        {"BRAKE": ["pressure", "pressed"]},
        ["line 6: message 'BRAKE': signals overlap: pressure and pressed"],
    ),
    "signal without bits": (
        WHOLE.replace("16|1@", "16|0@"),
        {"BRAKE": ["pressure"]},
        ["line 7: message 'BRAKE': signal 'pressed' has no bits"],
    ),
    "signal of too many bits": (
        WHOLE.replace("16|1@", "16|514@"),
        {"BRAKE": ["pressure"]},
        ["'pressed' has 514 bits, more than 512: dropped"],
    ),
    "signal beyond any message": (
        WHOLE.replace("16|1@", "32760|1@"),
        {"BRAKE": ["pressure"]},
        ["'pressed' begins at bit 32760, beyond 4095 bytes: dropped"],
    ),
    "signal beyond its own message": (
        WHOLE.replace("16|1@", "32759|1@"),
        {"BRAKE": ["pressure", "pressed"]},
        ["signals do not fit in its 8 bytes: pressed"],
    ),
    "more overlaps than are listed": (
        HEAD
        + "BO_ 100 BRAKE: 8 X\n"
        + "".join(
            f' SG_ {name} : 0|8@1+ (1,0) [0|1] "" X\n' for name in "abcde"
        ),
        {"BRAKE": [*"abcde"]},
        ["b and c; b and d and 4 more"],
    ),
    "message of too many bytes": (
        WHOLE + 'BO_ 101 BIG: 4096 X\n SG_ b : 0|8@1+ (1,0) [0|0] "" X\n',
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: message 'BIG': has 4096 bytes, more than 4095: dropped"],
    ),
    "values of no number": (
        WHOLE + 'VAL_ "100" pressed 0 "off" 1 "on" 2 "between the two";\n',
        {"BRAKE": ["pressure", "pressed"]},
        [
            'the... (form: VAL_ id signal value "text" ... ;): dropped',
        ],
    ),
    "message without bytes": (
        WHOLE.replace("BRAKE: 8", "BRAKE: 0"),
        {"BRAKE": ["pressure", "pressed"]},
        ["signals do not fit in its 0 bytes: pressure; pressed"],
    ),
    "id too large": (
        WHOLE + 'BO_ 5000 BIG: 8 X\n SG_ b : 0|8@1+ (1,0) [0|0] "" X\n',
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: message 'BIG': its id 5000 has more than 11 bits"],
    ),
    "missing semicolons": (
        WHOLE
        + 'CM_ BO_ 100 "one"\nCM_ SG_ 100 pressed "two"\n'
        + 'VAL_ 100 pressed 0 "off"\n',
        {"BRAKE": ["pressure", "pressed"]},
        [
            "line 9: the semicolon is missing",
            "line 10: the semicolon is missing",
            "line 11: the semicolon is missing",
        ],
    ),
    "missing receiver and sender": (
        WHOLE.replace('"" X\n', '""\n').replace("BRAKE: 8 X", "BRAKE: 8"),
        {"BRAKE": ["pressure", "pressed"]},
        [
            "line 5: the sender is missing",
            "line 7: message 'BRAKE': the receiver is missing",
        ],
    ),
    "missing quote": (
        'VERSION ""\nCM_ "never closed;\n' + GOOD,
        {"BRAKE": ["pressure", "pressed"]},
        ['line 2: cannot be read: CM_ "never closed;'],
    ),
    "unreadable message": (
        HEAD + 'BO_ ten TEN: 8 X\n SG_ t : 0|8@1+ (1,0) [0|0] "" X\n' + GOOD,
        {"BRAKE": ["pressure", "pressed"]},
        ["line 5: cannot be read: BO_ ten TEN: 8 X"],
    ),
    "stray lines": (
        HEAD + GOOD.replace("\n\n", "\nhello, world\n") + "\n",
        {"BRAKE": ["pressure", "pressed"]},
        ["line 8: message 'BRAKE': cannot be read: hello, world"],
    ),
    "stray lines farther down": (
        HEAD + GOOD.replace("\n\n", "\n\n\nhello,\nworld\n") + "\n",
        {"BRAKE": ["pressure", "pressed"]},
        ["line 10: message 'BRAKE': cannot be read: hello, world: dropped"],
    ),
    "letter outside ASCII in a name": (
        HEAD + GOOD.replace("pressed", "gedr\u00fcckt"),
        {"BRAKE": ["pressure"]},
        ["line 7: message 'BRAKE': cannot be read: SG_ gedr\u00fcckt"],
    ),
    "signal before any message": (
        HEAD + ' SG_ s : 0|8@1+ (1,0) [0|0] "" X\n' + GOOD,
        {"BRAKE": ["pressure", "pressed"]},
        ["line 5: a signal before the first message"],
    ),
    "no multiplexer": (
        WHOLE.replace("pressed :", "pressed m1 :"),
        {"BRAKE": ["pressure"]},
        ["signal 'pressed' is multiplexed (m1), but no multiplexer is"],
    ),
    "two multiplexers, nobody says whose": (
        HEAD
        + "BO_ 100 MUX: 8 X\n"
        + ' SG_ one M : 0|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ two M : 8|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m1 : 16|8@1+ (1,0) [0|0] "" X\n',
        {"MUX": ["one", "two"]},
        ["'leaf' is multiplexed (m1), but no SG_MUL_VAL_ names which of one"],
    ),
    "multiplexer that is not there": (
        HEAD
        + "BO_ 100 MUX: 8 X\n"
        + ' SG_ one m0M : 0|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m1M : 16|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ free : 24|8@1+ (1,0) [0|0] "" X\n'
        + "SG_MUL_VAL_ 100 leaf three 1-1;\n",
        {"MUX": ["free"]},
        [
            "line 6: message 'MUX': signal 'one'",
            "line 7: message 'MUX': signal 'leaf'",
            "SG_MUL_VAL_ of signal 'leaf': no signal is the multiplexer",
        ],
    ),
    "attribute nobody defined": (
        WHOLE + 'BA_ "Cycle" BO_ 100 20;\n',
        {"BRAKE": ["pressure", "pressed"]},
        ["line 9: the attributes (BA_...) cannot be read"],
    ),
    "mark m without a number": (
        HEAD
        + "BO_ 100 MUX: 8 X\n"
        + ' SG_ code m : 0|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m1 : 8|8@1+ (1,0) [0|0] "" X\n',
        {"MUX": ["code", "leaf"]},
        ["line 6: message 'MUX': signal 'code' has the mark 'm'"],
    ),
}


@pytest.mark.parametrize("keyword", ["CM_", "EV_", "SGTYPE_"])
def test_a_missing_quote_takes_no_statement_after_it(keyword: str) -> None:
    text = f'{keyword} "open\n{GOOD}'

    found = statements_of(text)

    assert [one.keyword for one in found] == [keyword, "BO_", "SG_", "SG_"]


@pytest.mark.parametrize("name", CASES)
def test_lenient_loads_the_rest_and_names_the_defect(
    tmp_path: Path, name: str
) -> None:
    text, remaining, expected = CASES[name]
    path = tmp_path / "car.dbc"
    path.write_text(text, encoding="cp1252")

    loaded = lenient(path)

    warnings = [str(one) for one in loaded.warnings]
    assert signals_of(loaded) == remaining
    assert len(warnings) == len(expected)
    assert all(
        part in line for part, line in zip(expected, warnings, strict=True)
    )


@pytest.mark.parametrize("name", CASES)
def test_strict_refuses_with_every_defect(tmp_path: Path, name: str) -> None:
    text, _, expected = CASES[name]
    path = tmp_path / "car.dbc"
    path.write_text(text, encoding="cp1252")

    with pytest.raises(ConfigError) as caught:
        read_dbc(path, strict=True, encoding="cp1252")

    assert len(caught.value.problems) == len(expected)
    assert all(
        line.startswith(f"{path}: ") and part in line and "strict = fa" in line
        for part, line in zip(expected, caught.value.problems, strict=True)
    )


def test_a_multiplexer_marked_m_works_as_one(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(CASES["mark m without a number"][0])

    loaded = lenient(path)
    code, leaf = loaded.database.messages[0].signals

    assert [one.signals for one in loaded.warnings] == [("code",)]
    assert code.is_multiplexer
    assert (leaf.multiplexer_signal, leaf.multiplexer_ids) == ("code", [1])


def test_two_messages_of_one_id_are_said_and_both_kept(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(WHOLE + "BO_ 100 OTHER: 8 X\n")

    loaded = read_dbc(path, strict=True, encoding="cp1252")

    assert list(signals_of(loaded)) == ["BRAKE", "OTHER"]
    (warning,) = loaded.warnings
    assert str(warning).startswith(
        "line 9: message 'OTHER': has the id 0x64 of message 'BRAKE' in line "
        "5: roles can be read from one of them"
    )
    assert warning.same_id


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        WHOLE.replace("\n", "\r\n"),
        WHOLE.replace("\n", "\r"),
        WHOLE + "// a remark // twice\n",
        WHOLE + 'CM_ "http://example.org\nBO_ 1 in a text: it stays";\n',
        'VERSION ""\nNS_ :\n\tCM_\n\tBO_\n\nBS_:\n\nBU_: X\n' + GOOD,
        HEAD + GOOD.replace("BRAKE: 8", "BRAKE: 64").replace("16|1@", "80|1@"),
        WHOLE
        + "BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n"
        + ' SG_ loose : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n',
    ],
    ids=[
        *("no version", "CRLF", "CR", "remark", "long text", "NS_"),
        *("long message", "signals of no message"),
    ],
)
@pytest.mark.parametrize("strict", [True, False])
def test_what_is_odd_but_readable_is_no_defect(
    tmp_path: Path, text: str, *, strict: bool
) -> None:
    path = tmp_path / "car.dbc"
    path.write_bytes(text.encode())

    loaded = read_dbc(path, strict=strict, encoding="cp1252")

    assert signals_of(loaded) == {"BRAKE": ["pressure", "pressed"]}
    assert loaded.warnings == ()


@pytest.mark.parametrize(
    ("written", "encoding", "warned"),
    [
        ("cp1252", "cp1252", ""),
        ("utf-8", "utf-8", ""),
        ("utf-8-sig", "cp1252", ""),
        ("utf-16", "cp1252", ""),
        ("utf-32", "cp1252", ""),
        ("cp437", "cp437", ""),
        (
            *("utf-8", "cp1252"),
            "read as 'cp1252': set encoding = \"utf-8\" in its [[bus]]",
        ),
        ("cp1252", "utf-8", "are not in the encoding 'utf-8'"),
    ],
)
def test_texts_in_several_encodings(
    tmp_path: Path, written: str, encoding: str, warned: str
) -> None:
    """A wrong encoding spoils texts, never values: no reason to refuse."""
    path = tmp_path / "car.dbc"
    path.write_bytes(WHOLE.replace('"bar"', '"\u00b0C"').encode(written))

    loaded = read_dbc(path, strict=True, encoding=encoding)

    unit = loaded.database.messages[0].signals[0].unit
    assert (unit == "\u00b0C") == (warned == "")
    assert [warned in str(one) for one in loaded.warnings] == [True] * bool(
        warned
    )
    assert all("line 6: " in str(one) for one in loaded.warnings)


def test_a_byte_order_mark_goes_before_the_encoding() -> None:
    text = codecs.BOM_UTF32_BE + WHOLE.encode("utf-32-be")

    assert decode_dbc(text, "cp1252") == (WHOLE, [])


def test_a_comment_that_is_too_long_is_left_out(tmp_path: Path) -> None:
    """It takes time to read, and no value is in it."""
    path = tmp_path / "car.dbc"
    comment = f'CM_ BO_ 100 "{"x" * 65522}";'
    path.write_text(WHOLE + comment + "\n")

    (warning,) = read_dbc(path, strict=True, encoding="cp1252").warnings

    assert str(warning) == "line 9: a comment of 65537 characters: left out"
    path.write_text(WHOLE + comment.replace("xx", "x", 1) + "\n")
    assert lenient(path).warnings == ()


def test_the_encoding_of_bytes_is_guessed() -> None:
    assert guess_encoding("\u00b0C".encode()) == "utf-8"
    assert guess_encoding("\u00b0C".encode("cp1252")) == "cp1252"


LINES = st.sampled_from(
    [
        *WHOLE.splitlines(),
        *(line for text, _, _ in CASES.values() for line in text.splitlines()),
        '"',
        ";",
        "",
    ]
)


@given(st.lists(LINES, max_size=30))
def test_statements_lie_where_they_say(lines: list[str]) -> None:
    """Statements are in order and apart; without them keeps the lines."""
    text = "\n".join(lines)

    found = statements_of(text)

    ends = [0, *(one.end for one in found)]
    assert all(one.start >= end for one, end in zip(found, ends, strict=False))
    assert all(
        one.text.startswith(one.keyword)
        and text.count("\n", 0, one.start) + 1 == one.line
        for one in found
    )
    blank = edited(text, [one.dropped() for one in found])
    assert blank.count("\n") == text.count("\n")


@given(lines=st.lists(LINES, max_size=30))
def test_any_mixture_of_lines_loads_or_is_a_problem(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str]
) -> None:
    """What loads leniently without a warning loads strictly as well."""
    path = tmp_path_factory.getbasetemp() / "mixture.dbc"
    path.write_text("\n".join(lines), encoding="cp1252")
    try:
        loaded = lenient(path)
    except ConfigError as error:
        problem = error.problems[0]
    else:
        problem = ""
    assert "not a DBC" in problem or not problem
    if problem:
        return
    if not loaded.warnings:
        strict = read_dbc(path, strict=True, encoding="cp1252")
        assert signals_of(strict) == signals_of(loaded)
    for message in loaded.database.messages:
        for signal in message.signals:
            with suppress(UnusableSignalError):
                assert raw_signal(message, signal.name).length


WILD = {
    # messages, a signal that brakes are read from, a part of each warning
    "Model3CAN": (148, "ID3FEbrakeTemps BrakeTempFL3FE", [1722, 1732]),
    "ford_fusion_2018_pt": (14, "WheelSpeed_CG1 WhlFl_W_Meas", []),
    "hyundai_kia_generic": (146, "ESP12 CYL_PRES", [1656, 1657]),
    "tesla_model3_party": (21, "ESP_status ESP_driverBrakeApply", []),
    "volvo_v60_2015_pt": (41, "BrakePedal BrakePressure", []),
    "vw_mqb": (113, "ESP_05 ESP_Bremsdruck", [90, 1622]),
    "vw_pq": (86, "Bremse_5 BR5_Bremsdruck", [170, 193, 352, 394, 553, 778]),
}


@pytest.mark.skipif(
    REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
)
@pytest.mark.parametrize("name", WILD)
def test_a_public_file_loads_and_its_brake_signals_are_read(
    name: str,
) -> None:
    path = Path(str(REAL)) / "dbc-in-the-wild" / f"{name}.dbc"
    messages, wanted, lines = WILD[name]

    loaded = lenient(path)

    assert len(loaded.database.messages) == messages
    found = [one.line for one in loaded.warnings]
    assert found[: len(lines)] == lines
    assert bool(found) == bool(lines)
    message, signal = wanted.split()
    assert raw_signal(
        loaded.database.get_message_by_name(message), signal
    ).length


@pytest.mark.skipif(
    REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
)
@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("Model3CAN", "line 1722: message 'ID5D5RearDItemps': signals do not"),
        ("hyundai_kia_generic", "line 1656: cannot be read: CM_ 145"),
        ("vw_mqb", "line 90: message 'PLA_01': signals overlap: PLA_Bremsmo"),
        ("vw_pq", "line 170: message 'Slave_1': signals overlap"),
    ],
)
def test_strict_refuses_a_public_file_with_the_place(
    name: str, part: str
) -> None:
    path = Path(str(REAL)) / "dbc-in-the-wild" / f"{name}.dbc"

    with pytest.raises(ConfigError) as caught:
        read_dbc(path, strict=True, encoding="cp1252")

    assert part in caught.value.problems[0]


def test_a_comment_beyond_the_limit_is_left_out(tmp_path: Path) -> None:
    """No reason to refuse the file, as it changes no value."""
    path = tmp_path / "car.dbc"
    statement = 'CM_ BO_ 100 "{}";'
    for size, count in ((65_536, 0), (65_537, 1)):
        text = statement.format("x" * (size - len(statement) + 2))
        path.write_text(f"{WHOLE}{text}\n")
        loaded = read_dbc(path, strict=True, encoding="cp1252")

        assert signals_of(loaded) == {"BRAKE": ["pressure", "pressed"]}
        found = [(one.line, one.harmless) for one in loaded.warnings]
        assert found == [(9, True)] * count
        comment = loaded.database.messages[0].comment
        assert (comment is None) == bool(count)


def test_a_statement_that_is_no_such_is_told_its_form(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(f'{WHOLE} SG_ speed : 0|16@1 (1,0) [0|0] "" X\n')

    (warning,) = lenient(path).warnings

    form = (
        'SG_ name : start|bits@order+ (scale,offset) [min|max] "unit" receiver'
    )
    assert f"(form: {form})" in str(warning)


def test_a_defect_of_the_layout_is_placed_at_its_signal() -> None:
    """At its message where the signal is of another name, else nowhere."""
    message: Any = SimpleNamespace(name="BRAKE")
    statement = Statement("SG_", 0, 9, 7, "SG_ speed")
    outline = MessageOutline(100, "BRAKE", 5, {"speed": statement})

    lines = [
        _layout_defect(message, of, [name, "other"], "overlap").line
        for of, name in (
            (outline, "speed"),
            (outline, "long_name_of_speed"),
            (None, "speed"),
        )
    ]

    assert lines == [7, 5, 0]
    defect = _layout_defect(message, outline, ["speed", "other"], "overlap")
    assert str(defect) == "line 7: message 'BRAKE': overlap"
    assert defect.signals == ("speed", "other")
