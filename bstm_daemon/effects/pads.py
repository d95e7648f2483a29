"""The lining's nodes in a network, from the face to the back."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bstm_daemon.thermal.network import Network


def pad_nodes(network: Network) -> list[str]:
    """Return the names of the lining's nodes in their order.

    A pad builder must add ``pad_front`` and ``pad_back``; what begins with
    ``pad_`` between them is lining too.
    """
    names = [node.name for node in network.nodes]
    first, last = names.index("pad_front"), names.index("pad_back")
    return [n for n in names[first : last + 1] if n.startswith("pad_")]
