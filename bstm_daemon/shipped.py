"""Where the files that come with the program are.

In a checkout they stand beside the package; an installation puts them under
``share/bstm-daemon`` of its prefix (``[tool.setuptools.data-files]``).
"""

from __future__ import annotations

import sys
from pathlib import Path

from bstm_daemon.errors import FileAccessError


def shipped_file(name: str) -> Path:
    """Return the path of a shipped file such as ``dbc/bstm.dbc``.

    Raises:
        FileAccessError: it is in neither place.
    """
    places = (
        Path(__file__).resolve().parents[1],
        Path(sys.prefix) / "share" / "bstm-daemon",
    )
    for place in places:
        if (place / name).is_file():
            return place / name
    looked = " nor ".join(str(place) for place in places)
    msg = f"{name}: a file of this program is neither in {looked}; reinstall"
    raise FileAccessError(msg)
