"""What an error says of names."""

import pytest

from bstm_daemon.errors import hint

MANY = [f"{number:02}" for number in range(14, -1, -1)]


@pytest.mark.parametrize(
    ("name", "known", "elsewhere", "said"),
    [
        ("presure", ["pressed", "pressure"], "", "did you mean 'pressure'?"),
        ("zzz", ["pressure", "brake"], "", "known are brake, pressure"),
        ("zzz", [], "", "there are none"),
        ("zzz", MANY, "see there", "see there"),
        (
            *("zzz", MANY, ""),
            f"known are {', '.join(sorted(MANY)[:12])} and 3 more",
        ),
    ],
)
def test_a_hint_is_what_was_meant_or_what_there_is(
    name: str, known: list[str], elsewhere: str, said: str
) -> None:
    """The nearest name, else all, else some or who lists them."""
    assert hint(name, known, elsewhere) == said
