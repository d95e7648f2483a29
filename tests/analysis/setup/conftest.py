"""A log of the simulated car, and DBC texts as small as can be."""

from collections.abc import Callable
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup.recording import Samples, Series

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def make_database() -> Callable[..., Database]:
    """Return a maker of a database with one message a list of signals."""

    def make(*messages: list[str]) -> Database:
        text = 'VERSION ""\nBU_: X\n'
        for number, signals in enumerate(messages):
            text += f"BO_ {100 + number} M{number}: 8 X\n"
            for place, signal in enumerate(signals):
                name, _, unit = signal.partition(" ")
                name, _, bits = name.partition(":")
                text += (
                    f" SG_ {name} : {8 * place}|{bits or 8}@1+ (1,0) [0|0] "
                    f'"{unit}" X\n'
                )
        database = cantools.database.load_string(text, "dbc", strict=False)
        assert isinstance(database, Database)
        return database

    return make


def samples(values: Series, rate_hz: float = 50.0) -> Samples:
    """Return *values* at *rate_hz* from time 0 on."""
    return Samples(np.arange(len(values)) / rate_hz, values)


@pytest.fixture(scope="session")
def series() -> Callable[..., Samples]:
    """Return the maker of samples."""
    return samples
