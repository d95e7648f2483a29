"""An identified value, its standard error, and why it is missing."""

from dataclasses import dataclass
from math import nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """A value beside the configured one.

    ``standard_error`` is nan where the value was held. ``caveat`` says why it
    is not identified, and is empty where it is.
    """

    value: float
    standard_error: float
    configured: float = nan
    caveat: str = ""

    @property
    def identified(self) -> bool:
        """Whether the drives settle it."""
        return not self.caveat
