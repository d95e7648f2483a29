"""Reads a configuration file into the inputs of the estimator."""

from pathlib import Path

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
        if config.publish.enabled:
            id_base = config.publish.id_base
            if taken := signal_map.taken_ids(config.publishing_bus, id_base):
                raise ConfigError(taken)
    if not quiet:
        log_defects(signal_map)
    return config, signal_map
