"""Estimates of a whole log as named columns, and the files made of them.

A :class:`ResultsBuilder` makes rows of an estimator's blocks and hands them
in stretches to sinks: tables on disk, a :class:`Collector` in memory, the
figures and curves of a report. No sink has to hold them all.
"""

from bstm_daemon.replay.results.builder import ResultsBuilder
from bstm_daemon.replay.results.files import WRITERS, csv_file, require_format
from bstm_daemon.replay.results.rows import (
    Chosen,
    Collector,
    ElapsedTime,
    Part,
    Results,
    Sink,
    is_one_of_few,
)

__all__ = [
    "WRITERS",
    "Chosen",
    "Collector",
    "ElapsedTime",
    "Part",
    "Results",
    "ResultsBuilder",
    "Sink",
    "csv_file",
    "is_one_of_few",
    "require_format",
]
