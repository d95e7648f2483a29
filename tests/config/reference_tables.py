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
    "`[accuracy]`": sections.AccuracyConfig,
    "`[[matched]]`": estimates.MatchedConfig,
    "`[[priors]]`": estimates.PriorsConfig,
    "`[heat]`": sections.HeatConfig,
    "`[fluid]`": estimates.FluidConfig,
    "`[forecast]`": estimates.ForecastConfig,
    "`[[effect]]`": sections.EffectConfig,
    "`[[change]]`": estimates.ChangeConfig,
    "`[publish]`": service.PublishConfig,
    "`[[e2e]]`": sections.E2eConfig,
    "`[wear]`": sections.WearConfig,
    "`[advice]`": sections.AdviceConfig,
    "`[state]`": sections.StateConfig,
    "`[daemon]`": sections.DaemonConfig,
    "`[record]`": sections.RecordConfig,
    "`[metrics]`": sections.MetricsConfig,
    "`[feed]`": service.FeedConfig,
}

ROW = re.compile(r"^\| `(\w+)` \| ([^|]+) \|.*\|$", re.MULTILINE)
SIGNS = (
    ("a list, each entry ", "list of "),
    ("a text, not empty|a text", "text"),
    ("a whole number", "whole,"),
    (r"a number (?=greater|from|\S+ or more)", ""),
    (r"greater than (\S+) and at most", r"> \1 to"),
    ("greater than", ">"),
    ("true or false", "boolean"),
    (r"(\S+) or more", r"≥ \1"),
    (r"from (?=\S+ to )", ""),
)
COMMAND = re.compile(r"^\| `bstm (\S+)` \|[^|]*\| ([^|]*) \|$", re.MULTILINE)
COMMAND_HEAD = "| command | does | more |\n|---|---|---|\n"
HEAD = "| key | unit | allowed | default | meaning |\n|---|---|---|---|---|\n"


def with_tables(text: str) -> str:
    """Return the reference *text* with its generated tables anew.

    The unit of a key stays as it stands there, of a new one it is a dash; so
    does the page of a command.
    """
    begin = text.index(COMMAND_HEAD) + len(COMMAND_HEAD)
    end = text.index("\n\n", begin) + 1
    pages = dict(COMMAND.findall(text[begin:end]))
    text = text[:begin] + command_rows(pages) + text[end:]
    for heading, model in SECTIONS.items():
        place = re.compile(
            rf"(### {re.escape(heading)}\n(?:(?!\n###? ).)*?)"
            rf"{re.escape(HEAD)}((?:\|[^\n]*\n)+)",
            re.DOTALL,
        )
        found = place.search(text)
        assert found is not None, heading
        units = dict(ROW.findall(found[2]))
        rows = "".join(row(model, key, units) for key in model.model_fields)
        text = text[: found.end(1)] + HEAD + rows + text[found.end() :]
    return text


def command_rows(pages: dict[str, str]) -> str:
    """Return a row for each command, from its line in ``bstm --help``."""
    return "".join(
        f"| `bstm {name}` | {summary} | {pages.get(name, '')} |\n"
        for name, summary in COMMANDS.items()
    )


def row(model: type[Section], key: str, units: dict[str, str]) -> str:
    """Return the row of *key*."""
    field = model.model_fields[key]
    default = "required"
    if not field.is_required():
        value = field.get_default(call_default_factory=True)
        default = "" if value is None else f"`{json.dumps(value)}`"
    cells = units.get(key, "-"), short(allowed(model, key)), default
    text = meanings(model)[key].replace("|", r"\|")
    return f"| `{key}` | {' | '.join(cells)} | {text} |\n"


def short(text: str) -> str:
    """Return what a key may be as signs: ``> 0 to 2`` for a number."""
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
