"""Which of several readings of one quantity go together."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def components(
    roles: Sequence[str], agrees: Callable[[str, str], bool | None]
) -> list[tuple[str, ...]]:
    """Return groups of *roles* that agree with one another, largest first.

    A role joins a group by agreeing with any member; None from *agrees*
    (nothing can be said) joins nothing.
    """
    group_of = {role: {role} for role in roles}
    for one, other in combinations(roles, 2):
        if group_of[one] is not group_of[other] and agrees(one, other):
            merged = group_of[one] | group_of[other]
            for role in merged:
                group_of[role] = merged
    found: list[tuple[str, ...]] = []
    for role in roles:
        group = tuple(name for name in roles if name in group_of[role])
        if group not in found:
            found.append(group)
    return sorted(found, key=len, reverse=True)
