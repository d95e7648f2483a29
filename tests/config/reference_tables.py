"""The tables of docs/reference.md and the schema, from commands and models.

    python -m tests.config.reference_tables

writes both anew; a test holds that nothing changes.
"""

import json
import re
from pathlib import Path

from bstm_daemon.cli.main import COMMANDS
from bstm_daemon.config import estimates, sections, service, thermal
from bstm_daemon.config.schema import config_schema, meanings
from bstm_daemon.config.section import Section
from bstm_daemon.config.wording import allowed

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference.md"
SCHEMA = ROOT / "config" / "vehicle.schema.json"

SECTIONS: dict[str, type[Section]] = {
    "`[vehicle]`": sections.VehicleConfig,
    "`[[bus]]`": sections.BusConfig,
    "`[signals.<role>]`": sections.SignalConfig,
    "`[table]`": sections.TableConfig,
    "`[[corner]]`": sections.CornerConfig,
    "`[[corner]]` `disc`": sections.DiscConfig,
    "`[[corner]]` `pad`": sections.PadConfig,
    "`[thermal]`": thermal.ThermalConfig,
    "`[cooling]`": thermal.CoolingConfig,
    "`[accuracy]`": estimates.AccuracyConfig,
    "`[[matched]]`": estimates.MatchedConfig,
    "`[[priors]]`": estimates.PriorsConfig,
    "`[heat]`": sections.HeatConfig,
    "`[fluid]`": estimates.FluidConfig,
    "`[forecast]`": estimates.ForecastConfig,
    "`[[effect]]`": sections.EffectConfig,
    "`[[change]]`": estimates.ChangeConfig,
    "`[publish]`": service.PublishConfig,
    "`[[e2e]]`": service.E2eConfig,
    "`[wear]`": estimates.WearConfig,
    "`[advice]`": estimates.AdviceConfig,
    "`[state]`": service.StateConfig,
    "`[daemon]`": service.DaemonConfig,
    "`[record]`": service.RecordConfig,
    "`[metrics]`": service.MetricsConfig,
    "`[feed]`": service.FeedConfig,
}

WRITTEN = ("`[[matched]]`", "`[[priors]]`", "`[[change]]`")
"""Sections that commands write: their keys are described in the schema."""

SIGNS = (
    ("a table with temperature_c, value, csv", "a curve"),
    ("a table.*", "table"),
    (" such as 2024-05-31", ""),
    ("a list, each entry ", "list of "),
    ("a text, not empty|a text", "text"),
    ("a whole number", "whole"),
    (r"a number (?=greater|from|\S+ or more)", ""),
    (r"greater than (\S+) and at most (\S+)", r"> \1..\2"),
    ("greater than", ">"),
    ("a (?=number|date|curve)", ""),
    (r"(\S+) or more", r"≥ \1"),
    (r"from (\S+) to (\S+)", r"\1..\2"),
)
COMMAND = re.compile(r"^- \[`(\S+)`\]\((\S+)\): ", re.MULTILINE)
COMMAND_HEAD = "prints the arguments of a command.\n\n"
HEAD = "| key | value | meaning |\n|---|---|---|\n"


def with_tables(text: str) -> str:
    """Return the reference *text* with its generated tables anew.

    The page of a command stays as it stands there.
    """
    begin = text.index(COMMAND_HEAD) + len(COMMAND_HEAD)
    end = text.index("\n\n", begin) + 1
    pages = dict(COMMAND.findall(text[begin:end]))
    text = text[:begin] + command_rows(pages) + text[end:]
    for heading, model in SECTIONS.items():
        if heading in WRITTEN:
            assert f"\n### {heading}\n" in text
            assert all(f"`{key}`" in text for key in model.model_fields)
            continue
        place = re.compile(
            rf"(### {re.escape(heading)}\n(?:(?!\n###? ).)*?)"
            rf"{re.escape(HEAD)}(?:\|[^\n]*\n)+",
            re.DOTALL,
        )
        found = place.search(text)
        assert found is not None, heading
        rows = "".join(row(model, key) for key in model.model_fields)
        text = text[: found.end(1)] + HEAD + rows + text[found.end() :]
    return text


def command_rows(pages: dict[str, str]) -> str:
    """Return a row for each command, from its line in ``bstm --help``."""
    rows = []
    for name, summary in COMMANDS.items():
        shown = f"[`{name}`]({pages[name]})" if name in pages else f"`{name}`"
        rows.append(f"- {shown}: {summary}\n")
    return "".join(rows)


def row(model: type[Section], key: str) -> str:
    """Return the row of *key*."""
    text = meanings(model)[key].replace("|", r"\|")
    return f"| `{key}` | {value_of(model, key)} | {text} |\n"


def value_of(model: type[Section], key: str) -> str:
    """Return what *key* may be; its default is what stands as code."""
    field = model.model_fields[key]
    kind = short(allowed(model, key))
    if field.is_required():
        return f"{kind}, required"
    value = field.get_default(call_default_factory=True)
    if value in (None, "", [], {}):
        return kind
    default = json.dumps(value)
    if isinstance(value, bool):
        return f"`{default}`"
    if default in re.split(", | or ", kind):
        return re.sub(
            rf"(?<!\S){re.escape(default)}(?![^\s,])", f"`{default}`", kind
        )
    return f"{kind}, `{default}`"


def short(text: str) -> str:
    """Return what a key may be as signs: ``> 0..2`` for a number."""
    for pattern, sign in SIGNS:
        text = re.sub(pattern, sign, text)
    return text


def schema_text() -> str:
    """Return what ``bstm config schema`` prints."""
    return json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    old = REFERENCE.read_text(encoding="utf-8")
    REFERENCE.write_text(with_tables(old), encoding="utf-8")
    SCHEMA.write_text(schema_text(), encoding="utf-8")
