"""Reads a configuration file into the inputs of the estimator."""

from pathlib import Path

from bstm_daemon.bus.output.layout import BLOCK_IDS
from bstm_daemon.bus.signals.signal_map import SignalMap, log_defects
from bstm_daemon.bus.tables.table_plan import compile_sources
from bstm_daemon.config.reading import load_config, naming_file
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.effects.catalogue import problems_of


def load_vehicle(
    path: Path, *, quiet: bool = False
) -> tuple[Config, SignalMap]:
    """Load the configuration *path* and compile its extraction plan.

    What is overlooked in the DBC files is logged unless *quiet*.

    Raises:
        ConfigError: with every problem of file, DBC and effects.
        FileAccessError: the file is missing or unreadable.
    """
    config = load_config(path)
    with naming_file(path):
        wrong = problems_of(config.effect)
        if wrong:
            raise ConfigError(wrong)
        signal_map = compile_sources(
            config.bus,
            config.signals,
            config.table,
            path.parent,
            config.vehicle.wheel_radius_m,
            e2e=config.e2e,
        )
        collisions = _own_ids_on_the_bus(config, signal_map)
        if collisions:
            raise ConfigError(collisions)
    if not quiet:
        log_defects(signal_map)
    return config, signal_map


def _own_ids_on_the_bus(config: Config, signal_map: SignalMap) -> list[str]:
    """Return a problem for each id that is both published and read."""
    if not config.publish.enabled:
        return []
    names = [bus.name for bus in config.bus]
    bus = names.index(config.publish.bus or names[0])
    base = config.publish.id_base
    own = range(base, base + BLOCK_IDS)
    taken = sorted(
        can_id
        for can_id, extended in signal_map.wanted(bus)
        if can_id in own and not extended
    )
    return [
        f"[publish] id_base = 0x{base:X}: the id "
        f"0x{can_id:X} would be ours, but this configuration reads it"
        for can_id in taken
    ]
